"""Names that no target can have, for something else is published under them."""

from __future__ import annotations

from altd.instruments.beam.quantities import QUANTITIES
from altd.status.checked_json import reserved_names
from altd.tables.columns import measurement_columns

_RESERVED = reserved_names(QUANTITIES)


def why_unusable(name: str) -> str:
    """Why a target cannot be called so, as the end of a sentence; empty: it can."""
    if name in _RESERVED:
        return "is a key of the measurement in JSON"
    columns = [column.name for column in measurement_columns(QUANTITIES, [name], of_scan=True)]
    twice = [column for column in columns if columns.count(column) > 1]
    return f"makes {twice[0]} of its own, which is a column of the measurement" if twice else ""
