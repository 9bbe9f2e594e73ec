"""From a request to its response: the protocol data unit, the same on every wire.

pymodbus reads the request, checks it and builds the response; ``docs/decisions/modbus.md`` says why its
servers and its other functions are not used.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import cast

from pymodbus.constants import ExcCodes
from pymodbus.datastore import ModbusServerContext
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU, ReadDeviceInformationRequest
from pymodbus.pdu.device import ModbusControlBlock

from altd import __version__
from altd.publish.modbus.registers import SIZE, Snapshot, image
from altd.service.board import Board
from altd.service.health import Component

READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, READ_DEVICE_IDENTIFICATION = 3, 4, 43
FUNCTIONS = frozenset({READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, READ_DEVICE_IDENTIFICATION})
"""What is served (Modbus Application Protocol V1.1b3, 6.3, 6.4, 6.21); the rest is an illegal function."""

IDENTITY = {0: "altd", 1: "ALT", 2: __version__, 4: "Active Laser Target"}
"""Vendor, product code, version and product name (ibid. 6.21)."""

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it logs a line for every malformed request
ModbusControlBlock().Identity.update(IDENTITY)  # type: ignore[no-untyped-call]  # one for the whole process


class Responder:
    """Answers requests and counts them; each is answered from one reading of the board."""

    def __init__(self, board: Board, component: Component) -> None:
        self._board = board
        self._component = component
        self._decoder = DecodePDU(True)

    async def answer(self, request: bytes) -> bytes:
        """The response to a request, both from the function code on and not empty."""
        response = await self._response(request)
        self._component.count("requests")
        if isinstance(response, ExceptionResponse):
            self._component.count("exceptions")
        else:
            self._component.gave_data()
        return bytes([response.function_code]) + response.encode()

    async def _response(self, request: bytes) -> ModbusPDU:
        function = request[0]
        if function not in FUNCTIONS:
            return ExceptionResponse(function, ExcCodes.ILLEGAL_FUNCTION)
        decoded = self._decoder.decode(request)
        if decoded is None or _has_read_code_0(decoded):
            return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
        return await decoded.datastore_update(cast("ModbusServerContext", self), 0)

    async def async_getValues(  # noqa: N802  the name by which pymodbus asks its context
        self, device_id: int, function: int, address: int, count: int
    ) -> Sequence[int] | ExcCodes:
        """The registers of a read; holding and input registers are the same."""
        if address + count > SIZE:
            return ExcCodes.ILLEGAL_ADDRESS
        board = self._board
        return image(Snapshot(board.read(), board.age_s(), board.published))[address : address + count]


def _has_read_code_0(request: ModbusPDU) -> bool:
    """Whether it asks for the identification of kind 0: pymodbus 3.16 lets it pass and then stumbles."""
    return isinstance(request, ReadDeviceInformationRequest) and request.read_code == 0
