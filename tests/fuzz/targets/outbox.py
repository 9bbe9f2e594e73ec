"""Messages between outbox and ingest, corrupted and with the right CRC again: refused, or what COPY takes."""

import json
from typing import Any

from fuzz.spoil import spoilt_document
from hypothesis import strategies as st

from altd.fleet.database import copied_lines
from altd.fleet.intake import Intake, RefusalReason
from altd.status.proof import sealed

_ROW = [5, 2, 1_795_161_600, 20, 19, 1, "front_dim", "front_spot_missing", [[10.0, 0.004, 9.9, 10.1], None]]
_BATCH = {
    "schema": 1,
    "serial": "ALT-7",
    "file": "0123456789abcdef",
    "stream": "fedcba9876543210",
    "oldest": 1,
    "first": 4,
    "last": 6,
    "newest": 6,
    "dropped": 0,
    "quantities": ["x_mm", "roll_deg"],
    "rows": [_ROW],
}

NAME = "outbox"
EXAMPLES = spoilt_document(st.just(_BATCH))


def check(example: Any) -> None:
    """Each line of an accepted batch has eleven columns, the last of them JSON of finite numbers."""
    try:
        payload = sealed(json.dumps(example)).encode()
    except (ValueError, RecursionError):
        return
    found = Intake("altd").check("altd/ALT-7/outbox", payload, 0.0)
    if isinstance(found, RefusalReason):
        return
    assert found.serial == "ALT-7"
    lines = copied_lines(found, 1, 1).split("\n")
    assert len(lines) == len(found.rows) + 1
    for line in lines[:-1]:
        columns = line.split("\t")
        assert len(columns) == 11
        assert "\\" not in line
        assert set(json.loads(columns[-1], parse_constant=_no_number)) <= set(found.quantities)


def _no_number(text: str) -> None:
    raise AssertionError(text)
