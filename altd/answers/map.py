"""``altd map``: converts positions in the picture, px, to positions on a target, mm."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from altd.calibration.file import load_calibration, target_of
from altd.errors import BadInputError
from altd.measuring.calibration import TargetCalibration
from altd.reasons import Reason
from altd.tables import POINT_COLUMNS, TEXT_FORMATS, Add, Row, TextFormat

UNREADABLE = "unreadable"
_MAX_LINE_BYTES = 1000
"""Maximum length of a line: two numbers, and more."""
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_DECIMALS = 5


def _write_plain(row: Row) -> None:
    """Write a line ``x_mm y_mm sigma_x_mm sigma_y_mm`` or ``invalid REASON``: the usual output."""
    if row.get("reason") is not None:
        sys.stdout.write(f"invalid {row['reason']}\n")
    else:
        numbers = (row[name] for name in ("x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm"))
        sys.stdout.write(" ".join(f"{value:.{_DECIMALS}f}" for value in numbers) + "\n")


def answer(
    calibration: Path, name: str, form: TextFormat | None, report_error: Callable[[str], object]
) -> int:
    """Write a row for each line ``u v`` of standard input that is not blank; return the exit status.

    It is 2 if a line is not ``u v``; such a line has a row too, so that rows match lines, and is reported.
    Raises BadInputError when the calibration cannot be used.
    """
    target = target_of(load_calibration(calibration), calibration, name)
    if target.simulated:
        report_error(f"{calibration}: {name} was calibrated from SIMULATED frames")
    add: Add = _write_plain if form is None else TEXT_FORMATS[form](sys.stdout.write, POINT_COLUMNS).add
    status = 0
    for number, line in enumerate(_lines_of_input(), start=1):
        if not line.strip():
            continue
        row: Row = {"line": number, "origin": "simulated" if target.simulated else "camera"}
        place = _place(line)
        if place is None:
            got = line.decode(errors="backslashreplace").strip()
            report_error(f"stdin: line {number}: expected 'u v', got {got[:60]!r}")
            add({**row, "reason": UNREADABLE})
            status = 2
        else:
            add({**row, **_point(target, *place)})
    return status


def _point(target: TargetCalibration, u_px: float, v_px: float) -> Row:
    given: Row = {"u_px": u_px, "v_px": v_px}
    point = target.point(u_px, v_px)
    if point is None:
        return {**given, "reason": str(Reason.OUT_OF_RANGE)}
    if isinstance(target.cross_checked(point, u_px, v_px), str):
        return {**given, "reason": str(Reason.IMPLAUSIBLE)}
    sigma_x_mm, sigma_y_mm = (float(point.covariance_mm2[i, i]) ** 0.5 for i in range(2))
    return {
        **given,
        "x_mm": round(point.x_mm, _DECIMALS),
        "y_mm": round(point.y_mm, _DECIMALS),
        "sigma_x_mm": round(sigma_x_mm, _DECIMALS),
        "sigma_y_mm": round(sigma_y_mm, _DECIMALS),
    }


def _place(line: bytes) -> tuple[float, float] | None:
    """Parse two finite numbers with white space between them; ``float`` accepts more: 1_000, nan."""
    fields = line.split()
    if len(fields) != 2 or not all(_NUMBER.fullmatch(field) for field in fields):
        return None
    u_px, v_px = map(float, fields)
    return None if max(abs(u_px), abs(v_px)) == float("inf") else (u_px, v_px)


def _lines_of_input() -> Iterator[bytes]:
    """Yield the lines, each cut to its first ``_MAX_LINE_BYTES`` + 1 bytes."""
    try:
        while line := sys.stdin.buffer.readline(_MAX_LINE_BYTES + 1):
            yield line
            while len(line) > _MAX_LINE_BYTES and not line.endswith(b"\n"):
                line = sys.stdin.buffer.readline(_MAX_LINE_BYTES + 1)
    except OSError as error:  # closed, or a folder
        raise BadInputError("stdin", error.strerror or "cannot be read") from error
