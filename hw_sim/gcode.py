"""One line of G-code: its words, the modes that it sets, and Grbl's errors about it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

INCH_MM = 25.4

_WORD = re.compile(r"([A-Z])([^A-Z]*)")
_MOTION, _UNITS, _DISTANCE = {0, 1}, {20, 21}, {90, 91}
_ACCEPTED = {17, 40, 49, 54, 80, 94}
"""G words that select what always applies here."""
_AXIS_COMMANDS = {0, 1, 10, 92}
_DWELL, _SET_OFFSET, _MACHINE_COORDINATES, _SET_POSITION = 4, 10, 53, 92
_KNOWN = {*_MOTION, *_UNITS, *_DISTANCE, *_ACCEPTED, _DWELL, _SET_OFFSET, _MACHINE_COORDINATES, _SET_POSITION}


class GrblError(Exception):
    """Grbl's response ``error:N``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True, slots=True)
class Modes:
    """State kept from line to line until a reset: G0 or G1, G20 or G21, G90 or G91, and the feed rate."""

    motion: int = 0
    inches: bool = False
    relative: bool = False
    feed_mm_per_min: float = 0.0


@dataclass(frozen=True, slots=True)
class Block:
    """A line of G-code as a stage executes it.

    ``codes`` are the numbers of its G words, ``values`` the values of the other words, ``axes_mm`` the values
    of X, Y and Z in mm; ``modes`` are valid from this line on.
    """

    codes: frozenset[int]
    values: Mapping[str, float]
    modes: Modes
    axes_mm: Mapping[str, float]

    @property
    def sets_work_zero(self) -> bool:
        """Whether the line sets the work zero, G10 and G92."""
        return bool(self.codes & {_SET_OFFSET, _SET_POSITION})

    @property
    def sets_offset(self) -> bool:
        """Whether the axes are the work zero itself, G10 L2, or the position in work coordinates."""
        return _SET_OFFSET in self.codes and self.values.get("L") == 2

    @property
    def is_dwell(self) -> bool:
        """Whether the line is a dwell, G4."""
        return _DWELL in self.codes

    @property
    def in_machine(self) -> bool:
        """Whether the axes are in machine coordinates, G53."""
        return _MACHINE_COORDINATES in self.codes


def read_block(line: str, modes: Modes) -> Block:
    """Parse a line under the modes before it; words that a stage does not need are error:20.

    Raises GrblError.
    """
    codes, values = parse_words(line)
    if not codes <= _KNOWN:
        raise GrblError(20)
    if len(codes & _AXIS_COMMANDS) > 1:
        raise GrblError(24)
    if len(codes & _UNITS) > 1 or len(codes & _DISTANCE) > 1:
        raise GrblError(21)
    inches = modes.inches if not codes & _UNITS else 20 in codes
    scale = INCH_MM if inches else 1.0
    if _DWELL in codes and "P" not in values:
        raise GrblError(28)
    after = Modes(
        motion=next(iter(codes & _MOTION), modes.motion),
        inches=inches,
        relative=modes.relative if not codes & _DISTANCE else 91 in codes,
        feed_mm_per_min=values["F"] * scale if "F" in values else modes.feed_mm_per_min,
    )
    axes_mm = {axis: values[axis] * scale for axis in "XYZ" if axis in values}
    return Block(frozenset(codes), values, after, axes_mm)


def parse_words(line: str) -> tuple[set[int], dict[str, float]]:
    """Parse the numbers of the G words, and the values of the other words; raises GrblError."""
    if line and not line[0].isalpha():
        raise GrblError(1)
    codes: set[int] = set()
    values: dict[str, float] = {}
    for letter, digits in _WORD.findall(line):
        try:
            value = float(digits)
        except ValueError:
            raise GrblError(2) from None
        if letter == "G":
            if value != int(value) or int(value) in codes:
                raise GrblError(20 if value != int(value) else 21)
            codes.add(int(value))
        elif letter in values:
            raise GrblError(25)
        elif letter not in "XYZFPLMNST":
            raise GrblError(20)
        else:
            values[letter] = value
    return codes, values
