"""The register table: the one definition of what a controller reads, and how a measurement becomes registers.

Addresses are those of the protocol data unit, counted from 0 (Modbus Application Protocol V1.1b3, 4.4).
A 32-bit value takes two registers, high word first; a register is sent high byte first (ibid. 4.2):
byte order ABCD. ``docs/modbus.md`` is generated from this file.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum

from altd.publish.modbus.status import reason_code, status_word
from altd.records import Measurement

MAP_VERSION = 1
"""Counts up when a register changes its meaning or place; a new register in a gap leaves it."""

SIZE = 120
"""Registers in the image. A request reads at most 125 (V1.1b3, 6.3): one request reads all of it."""

FLOATS, SCALED, TESTS = 20, 60, 100
"""Where the blocks begin; the header begins at 0."""

PER_UNIT = 10_000
"""Counts per mm, degree or mm/m in the scaled block."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_FLOAT_MAX = sys.float_info.max
_FLOAT32_MAX = float.fromhex("0x1.fffffep127")


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one request is answered from: the board at one instant.

    ``age_s`` is None before the first measurement; ``published`` counts the measurements put up so far.
    """

    measurement: Measurement | None
    age_s: float | None
    published: int


class Type(StrEnum):
    """How a value lies in registers."""

    U16 = "u16"
    U32 = "u32"
    S32 = "s32"
    F32 = "f32"

    @property
    def words(self) -> int:
        """Registers that a value takes."""
        return 1 if self is Type.U16 else 2

    @property
    def unknown(self) -> tuple[int, ...]:
        """The registers that say "not known", which no value gives: all ones, most negative, NaN."""
        return {
            Type.U16: (0xFFFF,),
            Type.U32: (0xFFFF, 0xFFFF),
            Type.S32: (0x8000, 0x0000),
            Type.F32: (0x7FC0, 0x0000),
        }[self]

    def pack(self, value: float | None) -> tuple[int, ...]:
        """The registers of a value: integers are rounded, what is out of range is held at the range's end."""
        if value is None or not math.isfinite(value):
            return self.unknown
        layout, low, high = {
            Type.U16: (">H", 0, 0xFFFE),
            Type.U32: (">I", 0, 0xFFFF_FFFE),
            Type.S32: (">i", -0x7FFF_FFFF, 0x7FFF_FFFF),
            Type.F32: (">f", -_FLOAT32_MAX, _FLOAT32_MAX),
        }[self]
        held = min(max(value, low), high)
        packed = struct.pack(layout, held if self is Type.F32 else round(held))
        return struct.unpack(f">{self.words}H", packed)


@dataclass(frozen=True, slots=True)
class Register:
    """A row of the table: where a value lies, what it means, and where it comes from."""

    address: int
    name: str
    type: Type
    unit: str
    meaning: str
    value: Callable[[Snapshot], float | None]
    is_ageing: bool = False
    """The value depends on when it is read, not on the measurement alone."""


def _status(snapshot: Snapshot) -> int:
    return status_word(snapshot.measurement)


def _reason(target: str | None) -> Callable[[Snapshot], int]:
    return lambda snapshot: reason_code(snapshot.measurement, target)


def _of_measurement(field: str) -> Callable[[Snapshot], float | None]:
    return lambda snapshot: getattr(snapshot.measurement, field, None)


def _number(key: str) -> Callable[[Snapshot], float | None]:
    return lambda snapshot: snapshot.measurement.number(key) if snapshot.measurement else None


def _sigma(key: str) -> Callable[[Snapshot], float | None]:
    return lambda snapshot: snapshot.measurement.sigma(key) if snapshot.measurement else None


def _of_target(target: str, key: str) -> Callable[[Snapshot], float | None]:
    def coordinate(snapshot: Snapshot) -> float | None:
        values = (snapshot.measurement and snapshot.measurement.targets.get(target)) or {}
        return values[key].value if key in values else None

    return coordinate


def _sequence(snapshot: Snapshot) -> int | None:
    return snapshot.measurement.sequence % 0xFFFF_FFFF if snapshot.measurement else None


def _age_ms(snapshot: Snapshot) -> float | None:
    return None if snapshot.age_s is None else 1000.0 * snapshot.age_s


def _utc_ms(snapshot: Snapshot) -> int | None:
    """Milliseconds since 1970 in UTC; None when the time is not known."""
    time = snapshot.measurement and snapshot.measurement.time
    return (time - _EPOCH) // timedelta(milliseconds=1) if time else None


def _utc_s(snapshot: Snapshot) -> int | None:
    ms = _utc_ms(snapshot)
    return None if ms is None else ms // 1000


def _utc_rest_ms(snapshot: Snapshot) -> int | None:
    ms = _utc_ms(snapshot)
    return None if ms is None else ms % 1000


def _constant(value: float) -> Callable[[Snapshot], float]:
    return lambda _: value


def _scaled(value: Callable[[Snapshot], float | None]) -> Callable[[Snapshot], float | None]:
    def counts(snapshot: Snapshot) -> float | None:
        plain = value(snapshot)
        if plain is None or not math.isfinite(plain):
            return None
        return max(-_FLOAT_MAX, min(PER_UNIT * plain, _FLOAT_MAX))  # a product that overflows is held, too

    return counts


HEADER = (
    Register(0, "status", Type.U16, "", "status word, see below; bit 0: the numbers may be used", _status),
    Register(2, "reason_unit", Type.U16, "", "reason code of the whole unit, 0 none", _reason(None)),
    Register(3, "reason_front", Type.U16, "", "reason code of the front target, 0 none", _reason("front")),
    Register(4, "reason_rear", Type.U16, "", "reason code of the rear target, 0 none", _reason("rear")),
    Register(
        5,
        "heartbeat",
        Type.U16,
        "",
        "counts up with every measurement; 65534 is followed by 0",
        lambda snapshot: snapshot.published % 0xFFFF,
    ),
    Register(6, "age", Type.U16, "ms", "time since the middle of the measurement's exposures", _age_ms, True),
    Register(7, "exposures", Type.U16, "", "exposures averaged", _of_measurement("frames")),
    Register(8, "sequence", Type.U32, "", "number of the last exposure averaged", _sequence),
    Register(10, "utc", Type.U32, "s", "middle of the exposures, seconds since 1970-01-01 in UTC", _utc_s),
    Register(12, "utc_ms", Type.U16, "ms", "its milliseconds, 0 to 999", _utc_rest_ms),
    Register(14, "map_version", Type.U16, "", "version of this table", _constant(MAP_VERSION)),
)

_QUANTITIES: tuple[tuple[str, str, str, Callable[[Snapshot], float | None]], ...] = (
    ("x", "mm", "beam at the reference plane, to the right as seen along the beam", _number("x_mm")),
    ("y", "mm", "beam at the reference plane, up", _number("y_mm")),
    ("yaw", "°", "direction of the beam, horizontal", _number("yaw_deg")),
    ("pitch", "°", "direction of the beam, vertical", _number("pitch_deg")),
    ("yaw_slope", "mm/m", "yaw as a slope", _number("yaw_mm_per_m")),
    ("pitch_slope", "mm/m", "pitch as a slope", _number("pitch_mm_per_m")),
    ("roll", "°", "from an inclinometer; not known without one", _number("roll_deg")),
    ("sigma_x", "mm", "standard deviation of x", _sigma("x_mm")),
    ("sigma_y", "mm", "standard deviation of y", _sigma("y_mm")),
    ("sigma_yaw", "°", "standard deviation of yaw", _sigma("yaw_deg")),
    ("sigma_pitch", "°", "standard deviation of pitch", _sigma("pitch_deg")),
    ("front_x", "mm", "spot on the front target", _of_target("front", "x_mm")),
    ("front_y", "mm", "spot on the front target", _of_target("front", "y_mm")),
    ("rear_x", "mm", "spot on the rear target", _of_target("rear", "x_mm")),
    ("rear_y", "mm", "spot on the rear target", _of_target("rear", "y_mm")),
)

FLOAT_BLOCK = tuple(
    Register(FLOATS + 2 * row, name, Type.F32, unit, meaning, value)
    for row, (name, unit, meaning, value) in enumerate(_QUANTITIES)
)
SCALED_BLOCK = tuple(
    Register(SCALED + 2 * row, name, Type.S32, unit, meaning, _scaled(value))
    for row, (name, unit, meaning, value) in enumerate(_QUANTITIES)
)
TEST_BLOCK = (
    Register(TESTS, "test_f32", Type.F32, "", "always 123.456", _constant(123.456)),
    Register(TESTS + 2, "test_u32", Type.U32, "", "always 0x12345678", _constant(0x1234_5678)),
    Register(TESTS + 4, "test_s32", Type.S32, "", "always -123456789", _constant(-123_456_789)),
    Register(TESTS + 6, "test_u16", Type.U16, "", "always 0xABCD", _constant(0xABCD)),
)

REGISTERS = HEADER + FLOAT_BLOCK + SCALED_BLOCK + TEST_BLOCK


def image(snapshot: Snapshot) -> list[int]:
    """All registers, ``SIZE`` words; gaps are 0."""
    words = [0] * SIZE
    _fill(words, REGISTERS, snapshot)
    return words


class RegisterImage:
    """The image as it is read: made once a measurement; only what ages is made anew for each reading."""

    def __init__(self) -> None:
        self._of: Snapshot | None = None
        self._words: list[int] = []

    def at(self, snapshot: Snapshot) -> list[int]:
        """All registers of a snapshot; not to be changed, and true until the next call."""
        made_of, self._of = self._of, snapshot
        is_same = made_of is not None and made_of.measurement is snapshot.measurement
        if made_of is None or not is_same or made_of.published != snapshot.published:
            self._words = image(snapshot)
        else:
            _fill(self._words, _AGEING, snapshot)
        return self._words


_AGEING = tuple(row for row in REGISTERS if row.is_ageing)


def _fill(words: list[int], rows: Sequence[Register], snapshot: Snapshot) -> None:
    for row in rows:
        words[row.address : row.address + row.type.words] = row.type.pack(row.value(snapshot))
