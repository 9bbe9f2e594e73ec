"""Lines on the stdin of ``altd map``."""

import contextlib
import io
import json
import math
import sys
from functools import cache
from pathlib import Path

from fuzz.folder import folder
from fuzz.spoil import SCRAPS, spoilt_bytes
from hypothesis import strategies as st
from support import evidence

from altd.answers.map import answer
from altd.calibration.file import save_calibration
from altd.tables import TextFormat

NAME = "map_lines"

_NUMBERS = b"1e308 -1e308\n", b"1_0 1_0\n", b"inf nan\n", "٣ ٣\n".encode()
SCRAPS_OF_LINES = (*SCRAPS, *_NUMBERS, b"x" * 100_000, b"\x0b\x1c")
EXAMPLES = spoilt_bytes(st.just(b"375 240\n100.5 80.25\n\n-1e3 4000\n700.0\t470.0\r\n"), SCRAPS_OF_LINES)


@cache
def _calibration() -> Path:
    path = folder(NAME) / "cal.json"
    save_calibration(evidence.calibration(), path)
    return path


def check(example: bytes) -> None:
    """Each line gives four finite numbers or a reason, and is complained of when it is no ``u v``."""
    rows, complaints, status = _answered(example, None)
    for row in rows:
        reason = row in ("invalid out_of_range", "invalid implausible", "invalid unreadable")
        assert reason or [math.isfinite(float(field)) for field in row.split()] == [True] * 4, row
    assert len(complaints) == rows.count("invalid unreadable")
    assert all(complaint.isprintable() for complaint in complaints)
    assert status == (2 if complaints else 0)
    objects, again, _ = _answered(example, "jsonl")
    assert [json.loads(line)["reason"] == "unreadable" for line in objects] == [
        row == "invalid unreadable" for row in rows
    ]
    assert again == complaints


def _answered(example: bytes, form: TextFormat | None) -> tuple[list[str], list[str], int]:
    """The rows, what was complained of, and the status."""
    out, complaints, before = io.StringIO(), list[str](), sys.stdin
    sys.stdin = io.TextIOWrapper(io.BytesIO(example), encoding="utf-8")
    try:
        with contextlib.redirect_stdout(out):
            status = answer(_calibration(), "rear", form, complaints.append)
    finally:
        sys.stdin = before
    return out.getvalue().splitlines(), complaints, status
