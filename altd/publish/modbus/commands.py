"""What a controller may ask of the unit by a write, where the settings allow it: a self-check only."""

from __future__ import annotations

import struct

from pymodbus.constants import ExcCodes

from altd.status.self_check_desk import NoSelfCheckError, SelfCheckDesk

WRITE_SINGLE_REGISTER = 6
"""Modbus Application Protocol V1.1b3, 6.6: function, address, value; the response is the request again."""

SELF_CHECK_ADDRESS = 1000
"""Beyond the registers that are read, so that no read block reaches it."""
SELF_CHECK_NOW = 1

_REQUEST = struct.Struct(">BHH")


def command_response(request: bytes, desk: SelfCheckDesk) -> bytes:
    """The response to a request with function 6, from the function code on."""
    refusal = _refusal(request, desk)
    return request if refusal is None else bytes([WRITE_SINGLE_REGISTER | 0x80, refusal])


def _refusal(request: bytes, desk: SelfCheckDesk) -> ExcCodes | None:
    """Carry a request out; the code of the exception where that cannot be."""
    if len(request) != _REQUEST.size:
        return ExcCodes.ILLEGAL_VALUE
    _, address, value = _REQUEST.unpack(request)
    if address != SELF_CHECK_ADDRESS:
        return ExcCodes.ILLEGAL_ADDRESS
    if value != SELF_CHECK_NOW:
        return ExcCodes.ILLEGAL_VALUE
    try:
        desk.ask("modbus")
    except NoSelfCheckError:
        return ExcCodes.DEVICE_FAILURE
    return None
