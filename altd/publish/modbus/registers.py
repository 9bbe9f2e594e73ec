"""Register table: the only definition of the registers, and the conversion of measurements to them.

Addresses are those of the protocol data unit, counted from 0 (Modbus Application Protocol V1.1b3, 4.4).
A register is sent high byte first (ibid. 4.2). A 32-bit value takes two registers, high word first unless the
settings choose another ``WordOrder``. ``docs/modbus.md`` is generated from this file.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

from altd.publish.modbus import values
from altd.publish.modbus.values import Reading
from altd.status.unit import UnitView

MAP_VERSION = 1
"""Version of the table; counts changes of a register's meaning or address, not new registers in gaps."""

SIZE = 120
"""Number of registers in the table. A request reads up to 125 (V1.1b3, 6.3), so one reads the whole table."""

FLOATS, SCALED, TESTS, PLATE = 20, 60, 100, 108
"""First addresses of the blocks; the header begins at 0."""

PER_UNIT = 10_000
"""Counts per mm, degree or mm/m in the scaled block."""


class WordOrder(StrEnum):
    """Order of the bytes of a 32-bit value; A is the highest."""

    ABCD = "ABCD"
    CDAB = "CDAB"
    BADC = "BADC"
    DCBA = "DCBA"

    def arranged(self, words: tuple[int, int]) -> tuple[int, int]:
        """Return the registers of a value from its ``words``, high and low."""
        high, low = words
        if self in (WordOrder.BADC, WordOrder.DCBA):
            high, low = _swapped(high), _swapped(low)
        return (low, high) if self in (WordOrder.CDAB, WordOrder.DCBA) else (high, low)


def _swapped(word: int) -> int:
    return (word & 0xFF) << 8 | word >> 8


_FLOAT_MAX = sys.float_info.max
_FLOAT32_MAX = float.fromhex("0x1.fffffep127")


class Type(StrEnum):
    """Representation of a value in registers."""

    U16 = "u16"
    U32 = "u32"
    S32 = "s32"
    F32 = "f32"
    TEXT16 = "text16"
    TEXT32 = "text32"

    @property
    def words(self) -> int:
        """Number of registers of a value."""
        return _WORDS[self]

    @property
    def is_32_bit(self) -> bool:
        """Whether a value is a number of two registers, whose order the settings choose."""
        return self.words > 1 and not self.is_text

    @property
    def is_text(self) -> bool:
        """Whether a value is text, of up to 16 or 32 characters."""
        return self in (Type.TEXT16, Type.TEXT32)

    @property
    def unknown(self) -> tuple[int, ...]:
        """Registers for "not known", which no known value has: all ones, most negative, NaN, empty text."""
        return {
            Type.U16: (0xFFFF,),
            Type.U32: (0xFFFF, 0xFFFF),
            Type.S32: (0x8000, 0x0000),
            Type.F32: (0x7FC0, 0x0000),
        }.get(self, (0,) * self.words)

    def pack(self, value: float | str | None) -> tuple[int, ...]:
        """Return the registers of a value: integers are rounded, values out of range are clamped.

        Text is ASCII, two characters per register, the first in the high byte, padded with zeros. Characters
        outside ASCII are sent as question marks.
        """
        if isinstance(value, str):
            text = value.encode("ascii", "replace")[: 2 * self.words]
            return struct.unpack(f">{self.words}H", text.ljust(2 * self.words, b"\0"))
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


_WORDS = {Type.U16: 1, Type.U32: 2, Type.S32: 2, Type.F32: 2, Type.TEXT16: 8, Type.TEXT32: 16}


@dataclass(frozen=True, slots=True)
class Register:
    """A row of the table: address, meaning and source of a value."""

    address: int
    name: str
    type: Type
    unit: str
    meaning: str
    value: Reading
    is_ageing: bool = False
    """Whether the value depends on the time of reading, not on the measurement alone."""


def _scaled(value: Reading) -> Reading:
    def counts(view: UnitView) -> float | None:
        plain = value(view)
        if not isinstance(plain, (int, float)) or not math.isfinite(plain):
            return None
        return max(-_FLOAT_MAX, min(PER_UNIT * plain, _FLOAT_MAX))  # clamps a product that overflows, too

    return counts


HEADER = (
    Register(0, "status", Type.U16, "", "status word, see below; bit 0: valid", values.status),
    Register(2, "reason_unit", Type.U16, "", "reason of the whole unit, 0: none", values.reason(None)),
    Register(3, "reason_front", Type.U16, "", "reason of the front target, 0: none", values.reason("front")),
    Register(4, "reason_rear", Type.U16, "", "reason of the rear target, 0: none", values.reason("rear")),
    Register(
        5,
        "heartbeat",
        Type.U16,
        "",
        "+1 with every measurement; after 65534: 0",
        lambda view: view.published % 0xFFFF,
    ),
    Register(6, "age", Type.U16, "ms", "since the middle of the exposures", values.age_ms, True),
    Register(7, "exposures", Type.U16, "", "exposures averaged", values.exposures),
    Register(8, "sequence", Type.U32, "", "number of the last exposure averaged", values.sequence),
    Register(10, "utc", Type.U32, "s", "middle of the exposures, since 1970-01-01", values.utc_s),
    Register(12, "utc_ms", Type.U16, "ms", "its milliseconds, 0 to 999", values.utc_rest_ms),
    Register(14, "map_version", Type.U16, "", "version of this table", values.constant(MAP_VERSION)),
)


@dataclass(frozen=True, slots=True)
class Point:
    """A value of a measurement: the only description of it, whatever registers contain it."""

    name: str
    unit: str
    meaning: str
    value: Reading
    is_ageing: bool = False

    def register(self, address: int, type_: Type, value: Reading | None = None) -> Register:
        """Return the row of its register at an address; ``value`` is the source in another unit."""
        return Register(
            address, self.name, type_, self.unit, self.meaning, value or self.value, self.is_ageing
        )


_AXES = (("x", "mm", "x_mm"), ("y", "mm", "y_mm"), ("yaw", "°", "yaw_deg"), ("pitch", "°", "pitch_deg"))
_COMBINED = "combined standard uncertainty"
_ABOUT_NOW = "standard deviation as a statement about the beam when answered"
_TO_THE_RIGHT = "beam at the reference plane, to the right as seen along the beam"
POINTS = (
    Point("x", "mm", _TO_THE_RIGHT, values.number("x_mm")),
    Point("y", "mm", "beam at the reference plane, up", values.number("y_mm")),
    Point("yaw", "°", "direction of the beam, horizontal", values.number("yaw_deg")),
    Point("pitch", "°", "direction of the beam, vertical", values.number("pitch_deg")),
    Point("yaw_slope", "mm/m", "yaw as a slope", values.number("yaw_mm_per_m")),
    Point("pitch_slope", "mm/m", "pitch as a slope", values.number("pitch_mm_per_m")),
    Point("roll", "°", "from an inclinometer; not known without one", values.number("roll_deg")),
    *(Point(f"sigma_{name}", unit, _COMBINED, values.sigma(key)) for name, unit, key in _AXES),
    Point("sigma_roll", "°", "standard deviation of roll", values.sigma("roll_deg")),
    *(
        Point(
            f"{target}_{axis}", "mm", f"spot on the {target} target", values.of_target(target, f"{axis}_mm")
        )
        for target in ("front", "rear")
        for axis in "xy"
    ),
    *(Point(f"sigma_now_{name}", unit, _ABOUT_NOW, values.sigma_now(key), True) for name, unit, key in _AXES),
    *(Point(f"rate_{name}", f"{unit}/s", "change per second", values.rate(key)) for name, unit, key in _AXES),
    *(
        Point(f"sigma_random_{name}", unit, "the part of sigma that scatters", values.sigma_random(key))
        for name, unit, key in _AXES
    ),
    Point("a", "mm", "place of the plate's origin, along x", values.number("a_mm")),
    Point("b", "mm", "place of the plate's origin, along y", values.number("b_mm")),
    Point("phi", "°", "turn of the plate, anticlockwise", values.number("phi_deg")),
    Point("sigma_a", "mm", _COMBINED, values.sigma("a_mm")),
    Point("sigma_b", "mm", _COMBINED, values.sigma("b_mm")),
    Point("sigma_phi", "°", _COMBINED, values.sigma("phi_deg")),
)


def in_pairs(first: int, names: str) -> Iterator[tuple[int, Point]]:
    """Yield the named points with their addresses: two registers each, from ``first`` on."""
    by_name = {point.name: point for point in POINTS}
    for row, name in enumerate(names.split()):
        yield first + 2 * row, by_name[name]


_OF_BEAM = (
    "x y yaw pitch yaw_slope pitch_slope roll sigma_x sigma_y sigma_yaw sigma_pitch front_x front_y rear_x "
    "rear_y sigma_now_x sigma_now_y sigma_now_yaw sigma_now_pitch"
)
FLOAT_BLOCK = tuple(point.register(at, Type.F32) for at, point in in_pairs(FLOATS, _OF_BEAM))
SCALED_BLOCK = tuple(
    point.register(at, Type.S32, _scaled(point.value)) for at, point in in_pairs(SCALED, _OF_BEAM)
)
TEST_BLOCK = (
    Register(TESTS, "test_f32", Type.F32, "", "always 123.456", values.constant(123.456)),
    Register(TESTS + 2, "test_u32", Type.U32, "", "always 0x12345678", values.constant(0x1234_5678)),
    Register(TESTS + 4, "test_s32", Type.S32, "", "always -123456789", values.constant(-123_456_789)),
    Register(TESTS + 6, "test_u16", Type.U16, "", "always 0xABCD", values.constant(0xABCD)),
)

_OF_PLATE = "a b phi sigma_a sigma_b sigma_phi"
PLATE_BLOCK = tuple(point.register(at, Type.F32) for at, point in in_pairs(PLATE, _OF_PLATE))
"""Values of a plate; not known for a beam, as the others for a plate, since an address has one meaning."""

REGISTERS = HEADER + FLOAT_BLOCK + SCALED_BLOCK + TEST_BLOCK + PLATE_BLOCK


@dataclass(frozen=True, slots=True)
class Table:
    """A block of registers: ``size`` of them from address ``first`` on, of which ``rows`` have a meaning."""

    rows: Sequence[Register] = REGISTERS
    first: int = 0
    size: int = SIZE

    def place(self, address: int, count: int) -> slice | None:
        """Return the slice of ``count`` registers in the block; None: not all of them are in it."""
        begin = address - self.first
        return slice(begin, begin + count) if begin >= 0 and begin + count <= self.size else None


MEASUREMENT = Table()

PER_PLACE, PLACES_AT_ONCE = 12, 8
"""Number of registers per place of a row, and of places per table."""
_ROW_HEAD_SIZE = 10


def row_head(first: int, name: str) -> tuple[Register, ...]:
    """Return the registers before the places: values of the round that are read together with them."""
    about, age = "number of the round's last exposure", "since the middle of the round"
    return (
        Register(first, f"{name}_status", Type.U16, "", "as `status`", values.status),
        Register(first + 1, f"{name}_targets", Type.U16, "", "number of targets", values.targets),
        Register(first + 2, f"{name}_age", Type.U16, "0.1 s", age, values.age_tenths, is_ageing=True),
        Register(first + 3, f"{name}_warnings", Type.U16, "", "bits, see below", values.row_warnings),
        Register(first + 4, f"{name}_sequence", Type.U32, "", about, values.sequence),
    )


def place_registers(first: int, number: int) -> tuple[Register, ...]:
    """Return the registers of a place, counted from 1 in beam order."""
    of = values.of_place
    floats = (
        ("dx", "mm", "displacement since the baseline, to the right", of(number, "dx_mm")),
        ("dy", "mm", "displacement since the baseline, up", of(number, "dy_mm")),
        ("sigma_dx", "mm", "combined standard uncertainty", of(number, "dx_mm", "sigma")),
        ("sigma_dy", "mm", "combined standard uncertainty", of(number, "dy_mm", "sigma")),
        ("significance", "", "displacement in standard deviations", of(number, "significance")),
    )
    name = f"place{number}"
    reason, warnings = values.reason_of_place(number), values.warnings_of_place(number)
    return (
        Register(first, f"{name}_reason", Type.U16, "", "why it was not measured, 0: it was", reason),
        Register(first + 1, f"{name}_warnings", Type.U16, "", "bits, see below", warnings),
        *(
            Register(first + 2 + 2 * row, f"{name}_{key}", Type.F32, unit, meaning, value)
            for row, (key, unit, meaning, value) in enumerate(floats)
        ),
    )


def _row_table(first: int, name: str, numbers: Sequence[int]) -> Table:
    rows = list(row_head(first, name))
    for place, number in enumerate(numbers):
        rows += place_registers(first + _ROW_HEAD_SIZE + PER_PLACE * place, number)
    return Table(rows, first, _ROW_HEAD_SIZE + PER_PLACE * len(numbers))


NEAR, FAR = _row_table(600, "near", range(1, 9)), _row_table(720, "far", range(9, 17))
"""Tables of a row of switched targets, the first eight and the others: one request reads a table.

Values beyond the row's targets, and with other instruments, are not known.
"""


def image(view: UnitView, table: Table = MEASUREMENT, order: WordOrder = WordOrder.ABCD) -> list[int]:
    """Return all registers of a table; gaps are 0."""
    words = [0] * table.size
    _fill(words, table.rows, view, table.first, order)
    return words


class RegisterImage:
    """Registers of a table, computed once per measurement; only ageing values are computed for each read."""

    def __init__(self, table: Table = MEASUREMENT, order: WordOrder = WordOrder.ABCD) -> None:
        self.table, self._order = table, order
        rows = table.rows
        self._ageing = tuple(row for row in rows if row.is_ageing)
        self._of: UnitView | None = None
        self._words: list[int] = []

    def at(self, view: UnitView) -> list[int]:
        """Return all registers of a view; the list is valid until the next call."""
        made_of, self._of = self._of, view
        is_same = made_of is not None and made_of.measurement is view.measurement
        if made_of is None or not is_same or made_of.published != view.published:
            self._words = image(view, self.table, self._order)
        else:
            _fill(self._words, self._ageing, view, self.table.first, self._order)
        return self._words


def _fill(words: list[int], rows: Sequence[Register], view: UnitView, first: int, order: WordOrder) -> None:
    for row in rows:
        place = row.address - first
        packed = row.type.pack(row.value(view))
        if order is not WordOrder.ABCD and row.type.is_32_bit:
            packed = order.arranged((packed[0], packed[1]))
        words[place : place + len(packed)] = packed
