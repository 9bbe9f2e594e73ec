"""How a fault of the settings is said, and the value as it stands in the file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import date, time

from pydantic_core import PydanticCustomError

FAULTS = "faults"
"""The type of pydantic's error with which our own models complain: ``ctx["faults"]`` has keys and why."""

_MAX_SHOWN_LETTERS = 60


def complaint(*faults: tuple[Sequence[str | int], str]) -> PydanticCustomError:
    """What a model raises when keys of it do not fit: each key, from the model on, and why it does not."""
    return PydanticCustomError(FAULTS, "{text}", {"faults": faults, "text": "; ".join(f[1] for f in faults)})


def shown(value: object) -> str:
    """A value as it stands in the file, or nearly."""
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    if isinstance(value, date | time):
        return str(value)
    text = value if isinstance(value, str) else repr(value)
    cut = text if len(text) <= _MAX_SHOWN_LETTERS else f"{text[:_MAX_SHOWN_LETTERS]}…"
    if isinstance(value, bool):
        return cut.lower()
    return json.dumps(cut, ensure_ascii=False) if isinstance(value, str) else cut
