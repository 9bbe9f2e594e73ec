"""The checked block: all values that a controller needs, in one read, with the means to verify them.

Message number, time stamp, source and CRC are the measures of a black channel (EN 50159, 7.3). The CRC
covers every register before it in the order sent, so only a read of the whole block can be checked. New rows
use gaps and leave ``BLOCK_VERSION`` as it is. ``docs/proof.md`` is generated from this file.
"""

from __future__ import annotations

import struct
from operator import attrgetter

from altd.publish.modbus import values
from altd.publish.modbus.registers import Register, RegisterImage, Table, Type, WordOrder, in_pairs
from altd.publish.modbus.values import Reading
from altd.status.proof import crc32
from altd.status.unit import UnitView

BLOCK_VERSION = 1
"""Version of the block; incremented when a register changes its meaning or address."""

FIRST, SIZE = 200, 80
"""First address of the block, and its number of registers."""

FLOATS = 230
"""First address of its floating point values."""


def _of_stamp(name: str) -> Reading:
    return lambda view: attrgetter(name)(view.stamp) if view.stamp else None


def _published(view: UnitView) -> int:
    return view.published % 0xFFFF_FFFF


HEAD = (
    Register(200, "block_version", Type.U16, "", "version of this block", values.constant(BLOCK_VERSION)),
    Register(201, "state", Type.U16, "", values.STATE_MEANING, values.state, is_ageing=True),
    Register(202, "unit", Type.U32, "", "CRC-32 of the serial number", _of_stamp("identity.unit")),
    Register(204, "session", Type.U32, "", "random at each start, never 0", _of_stamp("identity.session")),
    Register(
        206,
        "message",
        Type.U32,
        "",
        "counts the responses with registers of this block",
        _of_stamp("message"),
        is_ageing=True,
    ),
    Register(
        208,
        "clock",
        Type.U32,
        "ms",
        "since the daemon started, when answered",
        _of_stamp("clock_ms"),
        is_ageing=True,
    ),
    Register(210, "published", Type.U32, "", "counts the measurements", _published),
    Register(212, "sequence", Type.U32, "", "number of the last exposure averaged", values.sequence),
    Register(214, "utc", Type.U32, "s", "middle of the exposures, since 1970-01-01", values.utc_s),
    Register(216, "utc_ms", Type.U16, "ms", "its milliseconds, 0 to 999", values.utc_rest_ms),
    Register(217, "exposures", Type.U16, "", "exposures averaged", values.exposures),
    Register(
        218,
        "age",
        Type.U32,
        "ms",
        "since the middle of the exposures, when answered",
        values.age_ms,
        is_ageing=True,
    ),
    Register(220, "status", Type.U16, "", "status word as at address 0", values.status),
    Register(221, "reason_unit", Type.U16, "", "as at addresses 2 to 4", values.reason(None)),
    Register(222, "reason_front", Type.U16, "", "as at addresses 2 to 4", values.reason("front")),
    Register(223, "reason_rear", Type.U16, "", "as at addresses 2 to 4", values.reason("rear")),
)

_VALUES = (
    "x y yaw pitch roll sigma_x sigma_y sigma_yaw sigma_pitch sigma_roll "
    "sigma_now_x sigma_now_y sigma_now_yaw sigma_now_pitch rate_x rate_y rate_yaw rate_pitch "
    "sigma_random_x sigma_random_y sigma_random_yaw sigma_random_pitch"
)
"""Values of two registers each, from ``FLOATS`` on. Add new ones after all rows, or others would move."""

CRC = Register(
    FIRST + SIZE - 2,
    "crc32",
    Type.U32,
    "",
    f"CRC-32 of the {SIZE - 2} registers before it",
    values.constant(None),  # computed after all others
)

ROWS = (
    *HEAD,
    *(point.register(at, Type.F32) for at, point in in_pairs(FLOATS, _VALUES)),
    CRC,
)


BLOCK = Table(ROWS, FIRST, SIZE)


class CheckedBlock:
    """Registers of the block; ageing values and the CRC are computed again for each read.

    The CRC covers the bytes as they are sent, in any word order.
    """

    def __init__(self, order: WordOrder = WordOrder.ABCD) -> None:
        self._order = order
        self._image = RegisterImage(BLOCK, order)

    def at(self, view: UnitView) -> list[int]:
        """Return all registers of a view that has a stamp; the list is valid until the next call."""
        words = self._image.at(view)
        checked = struct.pack(f">{SIZE - 2}H", *words[:-2])
        high, low = divmod(crc32(checked), 1 << 16)
        words[-2:] = self._order.arranged((high, low))
        return words
