"""From a request to its response: the protocol data unit, the same on every wire.

pymodbus reads the request, checks it and builds the response; ``docs/decisions/0002-modbus.md`` says why its
servers and its other functions are not used.

pymodbus 3.16 answers a stream access to a device identification object that is not there with no objects at
all, where the specification starts again at object 0, and it stumbles over read code 0; so Read Device
Identification (function 43/14, Modbus Application Protocol V1.1b3, 6.21) is answered here.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Sequence
from typing import cast

from pymodbus.constants import ExcCodes
from pymodbus.datastore import ModbusServerContext
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from altd import __version__
from altd.publish.modbus import checked_block
from altd.publish.modbus.checked_block import CheckedBlock
from altd.publish.modbus.registers import SIZE, RegisterImage
from altd.publish.modbus.values import Snapshot
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Component
from altd.status.proof import Stamps
from altd.status.services import NoSelfCheckError, SelfCheckService

WRITE_SINGLE_REGISTER = 6
"""Modbus Application Protocol V1.1b3, 6.6: function, address, value; the response is the request again."""

SELF_CHECK_ADDRESS = 1000
"""Beyond the registers that are read, so that no read block reaches it."""
SELF_CHECK_NOW = 1

_REQUEST = struct.Struct(">BHH")


def command_response(request: bytes, service: SelfCheckService) -> bytes:
    """The response to a request with function 6, from the function code on."""
    refusal = _refusal(request, service)
    return request if refusal is None else bytes([WRITE_SINGLE_REGISTER | 0x80, refusal])


def _refusal(request: bytes, service: SelfCheckService) -> ExcCodes | None:
    """Carry a request out; the code of the exception where that cannot be."""
    if len(request) != _REQUEST.size:
        return ExcCodes.ILLEGAL_VALUE
    _, address, value = _REQUEST.unpack(request)
    if address != SELF_CHECK_ADDRESS:
        return ExcCodes.ILLEGAL_ADDRESS
    if value != SELF_CHECK_NOW:
        return ExcCodes.ILLEGAL_VALUE
    try:
        service.ask("modbus")
    except NoSelfCheckError:
        return ExcCodes.DEVICE_FAILURE
    return None


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


READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS = 3, 4
"""What is served beside the identification (Modbus Application Protocol V1.1b3, 6.3, 6.4); the rest is an
illegal function."""

_READ_REQUEST_BYTES = 5
"""Function, address and number of registers; pymodbus would answer a longer one, too."""

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it logs a line for every malformed request


class Responder:
    """Answers requests and counts them; each is answered from one reading of the board.

    ``state`` finds out the unit's state; None: nobody does.
    """

    def __init__(
        self, board: Board, component: Component, state: Callable[[], StateReport | None] = lambda: None
    ) -> None:
        self._board = board
        self._state = state
        self._component = component
        self._decoder = DecodePDU(True)
        self._image = RegisterImage()
        self._block = CheckedBlock()
        self._stamps = Stamps(board)

    async def answer(self, request: bytes) -> bytes:
        """The response to a request, both from the function code on and not empty."""
        response = await self._response(request)
        self._component.count("requests")
        if isinstance(response, ExcCodes):
            self._component.count("exceptions")
            return bytes([request[0] | 0x80, response])
        self._component.gave_data()
        return response

    async def _response(self, request: bytes) -> bytes | ExcCodes:
        """The response, or the code of the exception."""
        function = request[0]
        if function == READ_DEVICE_IDENTIFICATION:
            return identification(request)
        if function not in (READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS):
            return ExcCodes.ILLEGAL_FUNCTION
        decoded = self._decoder.decode(request) if len(request) == _READ_REQUEST_BYTES else None
        if decoded is None:
            return ExcCodes.ILLEGAL_VALUE
        response: ModbusPDU = await decoded.datastore_update(cast("ModbusServerContext", self), 0)
        if isinstance(response, ExceptionResponse):
            return ExcCodes(response.exception_code)
        return bytes([response.function_code]) + response.encode()

    async def async_getValues(  # noqa: N802  the name by which pymodbus asks its context
        self, device_id: int, function: int, address: int, count: int
    ) -> Sequence[int] | ExcCodes:
        """The registers of a read; holding and input registers are the same."""
        board = self._board
        measurement, age_s, published = board.read(), board.age_s(), board.published
        if address + count <= SIZE:
            return self._image.at(Snapshot(measurement, age_s, published))[address : address + count]
        place = address - checked_block.FIRST
        if place < 0 or place + count > checked_block.SIZE:
            return ExcCodes.ILLEGAL_ADDRESS
        report = self._state()
        state = None if report is None else report.signal.number
        words = self._block.at(Snapshot(measurement, age_s, published, self._stamps.next(), state))
        return words[place : place + count]
