"""Registers of the inclinometers, and reading them by Modbus RTU.

Balluff: user's guide of the BSI R11A0-XXR-CXP360-S75G (register table, error indicator, technical data).
WitMotion: the WIT standard Modbus protocol, and the maker's register header for the baud rate's codes. An
accuracy of 0.2° in either axis and at every temperature is assumed: no public statement was found.

``docs/decisions/0035-inclinometer.md`` explains why no library's client is used.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from types import MappingProxyType

from altd.ports import (
    InclinometerAccuracy,
    InclinometerDisturbedError,
    InclinometerTimeoutError,
    InclinometerWrongError,
)
from altd.serial_line.modbus_crc import register_after, with_crc

HOLDING, INPUT = 3, 4
"""Functions: read holding registers, read input registers (Modbus Application Protocol V1.1b3, 6.3, 6.4)."""


class Kind(StrEnum):
    """Number format of one or two registers, the high word first unless it ends in ``_swapped``."""

    U16 = "u16"
    S16 = "s16"
    U32 = "u32"
    S32 = "s32"
    F32 = "f32"
    U32_SWAPPED = "u32_swapped"
    S32_SWAPPED = "s32_swapped"
    F32_SWAPPED = "f32_swapped"

    @property
    def registers(self) -> int:
        """Number of registers."""
        return 1 if self in (Kind.U16, Kind.S16) else 2

    def raw(self, words: Sequence[int]) -> int:
        """All bits of the registers as one number without a sign."""
        raw = 0
        for word in reversed(words) if self.endswith("_swapped") else words:
            raw = raw << 16 | word
        return raw

    def number(self, raw: int) -> float:
        """Number of these bits: two's complement where it is signed, IEEE 754 where it is a float."""
        if self in (Kind.F32, Kind.F32_SWAPPED):
            (number,) = struct.unpack(">f", struct.pack(">I", raw))
            return float(number)
        bits = 16 * self.registers
        return raw - (1 << bits) if self.startswith("s") and raw >> (bits - 1) else raw


class Meaning(StrEnum):
    """Use of a register by the driver."""

    ROLL = "roll"
    PITCH = "pitch"
    TEMPERATURE = "temperature"
    LIVE = "live"
    """Read only for its last digits, which change while the sensor measures."""
    ADDRESS = "address"
    BAUD = "baud"
    AVERAGE = "average"
    """Number of its own readings that the sensor averages."""
    ZERO = "zero"
    """Setting of the sensor that would change the angle and therefore must be 0."""
    IDENTITY = "identity"
    """Constant by which the sensor is recognised, such as its type."""


SETTINGS = frozenset({Meaning.ADDRESS, Meaning.BAUD, Meaning.AVERAGE, Meaning.ZERO, Meaning.IDENTITY})
"""Settings, read on opening and when the sensor is checked again; the others are read each time."""


@dataclass(frozen=True, slots=True)
class Register:
    """A row: first address and meaning of a number; a count is ``scale`` of the unit (°, °C)."""

    address: int
    function: int
    kind: Kind
    scale: float
    meaning: Meaning
    about: str
    largest: int | None = None
    """Maximum valid bits of this number; None: no limit."""
    must_be: int | None = None
    """Required bits of an ``IDENTITY``."""

    def value(self, raw: int) -> float:
        """Value of the bits of this number, in its unit."""
        return self.kind.number(raw) * self.scale


@dataclass(frozen=True, slots=True)
class Sensor:
    """A type of inclinometer.

    ``sampling_s`` is the maximum age of a value when it is requested. ``invalid_word`` in the roll register
    means that a setting of the sensor is wrong. ``code_of_baud`` returns the content of the baud rate
    register.
    """

    name: str
    address: int
    baud: int
    sampling_s: float
    accuracy: InclinometerAccuracy
    registers: tuple[Register, ...]
    code_of_baud: Callable[[int], int | None] = lambda _: None
    invalid_word: int | None = None

    def blocks(self, *, settings: bool) -> list[tuple[Register, ...]]:
        """Rows that are settings, or those that are not, in blocks of one request each."""
        rows = [row for row in self.registers if (row.meaning in SETTINGS) is settings]
        return _blocks(sorted(rows, key=lambda row: (row.function, row.address)))


def _blocks(rows: Sequence[Register]) -> list[tuple[Register, ...]]:
    """Group consecutive rows without a gap into one block: the contents of a gap are unknown."""
    blocks = [[rows[0]]]
    for before, row in pairwise(rows):
        if (row.function, row.address) == (before.function, before.address + before.kind.registers):
            blocks[-1].append(row)
        else:
            blocks.append([row])
    return [tuple(block) for block in blocks]


_CENTI = 0.01
_HALF_TURN = 180.0 / 32768.0

BALLUFF = Sensor(
    name="Balluff BSI R11A0-…-CXP360",
    address=1,
    baud=19200,
    sampling_s=0.15,
    accuracy=InclinometerAccuracy(
        limit_deg=0.1,
        from_c=10.0,
        to_c=40.0,
        limit_elsewhere_deg=0.15,
        cross_axis_deg=0.1,
        step_deg=0.01,
    ),
    code_of_baud=lambda baud: baud // 100,
    registers=(
        Register(0, INPUT, Kind.U16, _CENTI, Meaning.ROLL, "inclination, 0 to 360°", 36000),
        Register(10, INPUT, Kind.S16, _CENTI, Meaning.TEMPERATURE, "temperature of the sensor"),
        Register(133, HOLDING, Kind.U16, 1, Meaning.AVERAGE, "readings averaged, 1 to 20"),
        Register(134, HOLDING, Kind.U16, _CENTI, Meaning.ZERO, "offset"),
        Register(135, HOLDING, Kind.U16, 1, Meaning.ZERO, "direction, 0 clockwise"),
        Register(200, HOLDING, Kind.U16, 1, Meaning.ADDRESS, "address"),
        Register(201, HOLDING, Kind.U16, 1, Meaning.BAUD, "baud rate / 100"),
    ),
    invalid_word=55555,
)

_WIT_BAUDS = MappingProxyType({4800: 1, 9600: 2, 19200: 3, 38400: 4, 57600: 5, 115200: 6})

WITMOTION = Sensor(
    name="WitMotion WT901C485",
    address=0x50,
    baud=9600,
    sampling_s=0.1,
    accuracy=InclinometerAccuracy(
        limit_deg=0.2,
        from_c=-40.0,
        to_c=85.0,
        limit_elsewhere_deg=0.2,
        cross_axis_deg=0.0,
        step_deg=_HALF_TURN,
    ),
    code_of_baud=_WIT_BAUDS.get,
    registers=(
        Register(0x04, HOLDING, Kind.U16, 1, Meaning.BAUD, "code of the baud rate"),
        Register(0x1A, HOLDING, Kind.U16, 1, Meaning.ADDRESS, "address"),
        *(
            Register(0x34 + n, HOLDING, Kind.S16, 1, Meaning.LIVE, f"{what} {axis}")
            for n, (what, axis) in enumerate(
                (what, axis) for what in ("acceleration", "rate", "magnetic field") for axis in "xyz"
            )
        ),
        Register(0x3D, HOLDING, Kind.S16, _HALF_TURN, Meaning.ROLL, "roll, ±180°"),
        Register(0x3E, HOLDING, Kind.S16, _HALF_TURN, Meaning.PITCH, "pitch, ±90°"),
        Register(0x3F, HOLDING, Kind.S16, _HALF_TURN, Meaning.LIVE, "yaw"),
        Register(0x40, HOLDING, Kind.S16, _CENTI, Meaning.TEMPERATURE, "temperature of the sensor"),
    ),
)

SENSORS: Mapping[str, Sensor] = MappingProxyType(
    {"balluff_bsi_r11a0": BALLUFF, "witmotion_wt901c485": WITMOTION}
)
"""Sensors by the ``driver`` of the table ``[inclinometer]``."""


_EXCEPTION = 0x80
_FRAME_BYTES = 5
"""Length of a response without registers: address, function, byte count, CRC. An exception is as long."""


@dataclass(frozen=True, slots=True)
class Question:
    """Request for ``count`` registers from ``first`` on of the sensor at a Modbus address."""

    address: int
    function: int
    first: int
    count: int

    @property
    def frame(self) -> bytes:
        """Request as it is sent."""
        return with_crc(struct.pack(">BBHH", self.address, self.function, self.first, self.count))

    @property
    def answer_bytes(self) -> int:
        """Length of the response."""
        return _FRAME_BYTES + 2 * self.count

    def registers(self, heard: bytes, place: str) -> list[int]:
        """Registers in all bytes received after the request, up to the next silence.

        An adapter that receives its own transmission puts the request before the response. Raises
        InclinometerTimeoutError, …DisturbedError or …WrongError that names ``place``.
        """
        answer = heard.removeprefix(self.frame)
        if not answer:
            why = "the line echoes the requests, and no sensor answers" if heard else "no answer"
            raise InclinometerTimeoutError(f"{why}: {place}")
        if len(answer) < _FRAME_BYTES or register_after(answer) != 0:
            raise InclinometerDisturbedError(f"damaged answer (CRC), {len(answer)} bytes: {place}")
        if answer[0] != self.address:
            raise InclinometerDisturbedError(f"address {answer[0]} answers in place of {place}")
        if answer[1] == self.function | _EXCEPTION and len(answer) == _FRAME_BYTES:
            what = f"refuses function {self.function}, register {self.first} (exception {answer[2]})"
            raise InclinometerWrongError(f"it is another sensor: it {what}: {place}")
        if answer[1:3] != bytes([self.function, 2 * self.count]) or len(answer) != self.answer_bytes:
            raise InclinometerDisturbedError(f"an answer to another question: {place}")
        return list(struct.unpack(f">{self.count}H", answer[3:-2]))
