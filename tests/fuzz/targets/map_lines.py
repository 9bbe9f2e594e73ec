"""What comes on the stdin of ``altd map``."""

from __future__ import annotations

import argparse
import contextlib
import io
import math
import sys
from functools import cache
from pathlib import Path

from fuzz.folder import folder, one_line
from fuzz.spoil import SCRAPS, spoilt_bytes
from hypothesis import strategies as st
from support import evidence

from altd import commands
from altd.calibration.file import save_calibration
from altd.errors import BadInputError

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
    """Each line gives four finite numbers or a reason, or one line says what is none."""
    out, before = io.StringIO(), sys.stdin
    sys.stdin = io.TextIOWrapper(io.BytesIO(example), encoding="utf-8")
    options = argparse.Namespace(command="map", calibration=_calibration(), target="rear")
    try:
        with contextlib.redirect_stdout(out):
            assert commands.run(options) == 0
    except BadInputError as error:
        one_line(error)
    finally:
        sys.stdin = before
    for line in out.getvalue().splitlines():
        reason = line in ("invalid out_of_range", "invalid implausible")
        assert reason or all(math.isfinite(float(field)) for field in line.split()), line
