"""Read Device Identification, function 43/14 (Modbus Application Protocol V1.1b3, 6.21).

pymodbus 3.16 answers a stream access to an object that is not there with no objects at all, where the
specification starts again at object 0, and it stumbles over read code 0; so it is answered here.
"""

from __future__ import annotations

from pymodbus.constants import ExcCodes

from altd import __version__

READ_DEVICE_IDENTIFICATION = 43
MEI_TYPE = 14

OBJECTS = {0: "altd", 1: "ALT", 2: __version__, 4: "Active Laser Target"}
"""Vendor, product code, version and product name, by object id; all of them fit into one response."""

_STREAMS = {1: range(3), 2: range(0x80), 3: range(0x100)}
"""The objects of a category, by the read code that asks for them as a stream: basic, regular, extended."""

_INDIVIDUAL = 4
_CONFORMITY = 0x83
"""Every category, as a stream and one by one."""


def identification(request: bytes) -> bytes | ExcCodes:
    """The response to a request, both from the function code on; or the code of the exception."""
    if len(request) > 1 and request[1] != MEI_TYPE:
        return ExcCodes.ILLEGAL_FUNCTION
    if len(request) != 4:
        return ExcCodes.ILLEGAL_VALUE
    read_code, object_id = request[2], request[3]
    if read_code == _INDIVIDUAL:
        if object_id not in OBJECTS:
            return ExcCodes.ILLEGAL_ADDRESS
        return _response(read_code, [object_id])
    if read_code not in _STREAMS:
        return ExcCodes.ILLEGAL_VALUE
    category = [number for number in OBJECTS if number in _STREAMS[read_code]]
    if object_id not in category:
        object_id = 0  # "as if object 0 were pointed out", 6.21
    return _response(read_code, [number for number in category if number >= object_id])


def _response(read_code: int, numbers: list[int]) -> bytes:
    head = bytes([READ_DEVICE_IDENTIFICATION, MEI_TYPE, read_code, _CONFORMITY, 0, 0, len(numbers)])
    values = ((number, OBJECTS[number].encode("ascii")) for number in numbers)
    return head + b"".join(bytes([number, len(value)]) + value for number, value in values)
