"""From a request to its response: the protocol data unit, the same on every wire.

Numbers of sections are those of the Modbus Application Protocol V1.1b3. ``docs/decisions/0002-modbus.md``
says why pymodbus does not answer.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from pymodbus.constants import ExcCodes

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
"""6.6: function, address, value; the response is the request again."""

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
"""6.3, 6.4; holding and input registers are the same."""

MAX_READ = 125
"""Registers in one response (6.3)."""


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
        self._image = RegisterImage()
        self._block = CheckedBlock()
        self._stamps = Stamps(board)

    def answer(self, request: bytes) -> bytes:
        """The response to a request, both from the function code on and not empty."""
        response = self._response(request)
        self._component.count("requests")
        if isinstance(response, ExcCodes):
            self._component.count("exceptions")
            return bytes([request[0] | 0x80, response])
        self._component.gave_data()
        return response

    def _response(self, request: bytes) -> bytes | ExcCodes:
        """The response, or the code of the exception."""
        function = request[0]
        if function == READ_DEVICE_IDENTIFICATION:
            return identification(request)
        if function not in (READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS):
            return ExcCodes.ILLEGAL_FUNCTION
        if len(request) != _REQUEST.size:
            return ExcCodes.ILLEGAL_VALUE
        _, address, count = _REQUEST.unpack(request)
        if not 1 <= count <= MAX_READ:
            return ExcCodes.ILLEGAL_VALUE
        words = self._registers(address, count)
        if isinstance(words, ExcCodes):
            return words
        return struct.pack(f">BB{count}H", function, 2 * count, *words)

    def _registers(self, address: int, count: int) -> list[int] | ExcCodes:
        """So many registers from an address on."""
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
