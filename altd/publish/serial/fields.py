"""How one value is written in a telegram: a form has a widest text and a pattern."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import time
from enum import StrEnum
from typing import Any

CODE_SEPARATOR = "+"


class Mode(StrEnum):
    """Whether the numbers may be used; only ``A`` is a live value."""

    LIVE = "A"
    PLAYBACK = "P"
    SIMULATED = "S"
    INVALID = "V"


@dataclass(frozen=True, slots=True)
class Form:
    """One kind of field. A text that ``write`` makes and the pattern refuses does not fit the field."""

    widest: str
    """The longest text, as the page shows it."""
    pattern: re.Pattern[str]
    write: Callable[[Any], str]


def number(digits: int, decimals: int, *, signed: bool) -> Form:
    """A decimal number with a point, a fixed number of decimals and no sign on zero."""

    def write(value: float) -> str:
        return f"{round(value, decimals) + 0.0:.{decimals}f}"  # adding 0.0 makes -0.0 an unsigned zero

    return Form(
        widest=f"{'-' * signed}{'9' * digits}.{'9' * decimals}",
        pattern=re.compile(rf"{'-?' * signed}\d{{1,{digits}}}\.\d{{{decimals}}}", re.ASCII),
        write=write,
    )


def whole(largest: int) -> Form:
    """A whole number from zero up, without leading zeros needed."""
    return Form(
        widest=str(largest),
        pattern=re.compile(rf"\d{{1,{len(str(largest))}}}", re.ASCII),
        write=str,
    )


def _write_time(value: time) -> str:
    return f"{value:%H%M%S}.{value.microsecond // 1000:03d}"


UTC_TIME = Form("235959.999", re.compile(r"\d{6}\.\d{3}", re.ASCII), _write_time)
MODE = Form("A", re.compile("[APSV]"), str)
CODES = Form(
    f"code{CODE_SEPARATOR}code…",
    re.compile(rf"[a-z0-9_]+(\{CODE_SEPARATOR}[a-z0-9_]+)*"),
    CODE_SEPARATOR.join,
)
