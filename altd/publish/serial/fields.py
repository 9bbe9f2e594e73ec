"""Format of one value in a telegram: a form has a widest text and a pattern."""

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
    """One kind of field. A text from ``write`` that the pattern rejects does not fit the field."""

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


def integer(largest: int) -> Form:
    """A whole number from 0, with at most the digits of ``largest``; leading zeros are not needed."""
    return Form(
        widest=str(largest),
        pattern=re.compile(rf"\d{{1,{len(str(largest))}}}", re.ASCII),
        write=str,
    )


_CUT = "~"
"""Mark at the end of a text that was longer than its field."""
_RESERVED = r"$*,!\^~"


def text(most: int) -> Form:
    """A text of at most ``most`` characters, escaped as in NMEA 0183 and cut if it is longer.

    A character that is reserved there or is not printable ASCII becomes ``^`` and two hexadecimal digits for
    each of its bytes in UTF-8. ``~`` is reserved too, so at the end it can only be the mark of a cut.
    """

    def write(value: str) -> str:
        parts = [_escaped(sign) for sign in value]
        if sum(map(len, parts)) > most:
            while sum(map(len, parts)) >= most:
                parts.pop()
            parts.append(_CUT)
        return "".join(parts)

    return Form(
        widest="A" * most,
        pattern=re.compile(rf"(?=.{{0,{most}}}$)((?![{re.escape(_RESERVED)}])[ -~]|\^[0-9A-F]{{2}})*~?"),
        write=write,
    )


def _escaped(sign: str) -> str:
    if " " <= sign <= "~" and sign not in _RESERVED:
        return sign
    return "".join(f"^{byte:02X}" for byte in sign.encode())


def _write_time(value: time) -> str:
    return f"{value:%H%M%S}.{value.microsecond // 1000:03d}"


UTC_TIME = Form("235959.999", re.compile(r"\d{6}\.\d{3}", re.ASCII), _write_time)
MODE = Form("A", re.compile("[APSV]"), str)
CODES = Form(
    f"code{CODE_SEPARATOR}code…",
    re.compile(rf"[a-z0-9_]+(\{CODE_SEPARATOR}[a-z0-9_]+)*"),
    CODE_SEPARATOR.join,
)
