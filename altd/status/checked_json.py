"""The measurement object with what it takes to check it: as it goes out by HTTP, by MQTT later."""

from __future__ import annotations

from typing import Any

from altd.files.documents import line_of
from altd.records import Measurement, Quantities
from altd.status.board import Board
from altd.status.measurement_json import as_object_now, keys_of
from altd.status.proof import Stamp, crc32

PROOF_KEYS = ("unit", "session", "message", "published", "clock_ms", "age_s", "crc32")
"""What stands behind the keys of the measurement, in this order."""


def proof_of(board: Board, stamp: Stamp) -> dict[str, Any]:
    """The keys before ``crc32``, of what is on the board at this moment."""
    identity, age_s = stamp.identity, board.age_s()
    return {
        "unit": _hexadecimal(identity.unit),
        "session": _hexadecimal(identity.session),
        "message": stamp.message,
        "published": board.published,
        "clock_ms": stamp.clock_ms,
        "age_s": None if age_s is None else round(age_s, 3),
    }


def checked_line(board: Board, measurement: Measurement, stamp: Stamp) -> str:
    """What the board reads now, as one line of JSON without the line end.

    The last member is ``crc32``: of all bytes before ``, "crc32":``, as they are sent.
    """
    line = line_of(as_object_now(measurement, board.age_s()) | proof_of(board, stamp)).removesuffix("}")
    return f'{line}, "crc32": "{_hexadecimal(crc32(line.encode("ascii")))}"}}'


def reserved_names(quantities: Quantities) -> frozenset[str]:
    """The keys of the measurement object in any of its forms, whose place no target may take."""
    return keys_of(quantities) | frozenset(PROOF_KEYS)


def _hexadecimal(number: int | None) -> str | None:
    return None if number is None else f"{number:08X}"
