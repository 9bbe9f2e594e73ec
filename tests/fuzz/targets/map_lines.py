"""What comes on the stdin of ``altd map``."""

from __future__ import annotations

import contextlib
import io
import math
import sys
from functools import cache
from pathlib import Path

from fuzz.folder import folder
from fuzz.spoil import SCRAPS, spoilt_bytes
from hypothesis import strategies as st
from support import evidence

from altd.calibration.file import save_calibration
from altd.cli import main

NAME = "map_lines"

SCRAPS_OF_LINES = (
    *SCRAPS,
    b"1e308 -1e308\n",
    b"1_0 1_0\n",
    b"inf nan\n",
    b"x" * 100_000,
    "٣ ٣\n".encode(),
    b"\x0b\x1c",
)
EXAMPLES = spoilt_bytes(st.just(b"375 240\n100.5 80.25\n\n-1e3 4000\n700.0\t470.0\r\n"), SCRAPS_OF_LINES)


@cache
def _calibration() -> Path:
    path = folder(NAME) / "cal.json"
    save_calibration(evidence.calibration(), path)
    return path


def check(example: bytes) -> None:
    """Each line gives four finite numbers or a reason; the first that is no position ends it in one line."""
    out, err, before = io.StringIO(), io.StringIO(), sys.stdin
    sys.stdin = io.TextIOWrapper(io.BytesIO(example), encoding="utf-8")
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(["map", "--calibration", str(_calibration()), "--target", "rear"])
    finally:
        sys.stdin = before
    for line in out.getvalue().splitlines():
        reason = line in ("invalid out_of_range", "invalid implausible")
        assert reason or all(math.isfinite(float(field)) for field in line.split()), line
    assert status == (2 if err.getvalue() else 0)
    assert len(err.getvalue().splitlines()) == status // 2, err.getvalue()
