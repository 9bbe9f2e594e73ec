"""Responses to requests: the protocol data units, which are the same on every transport.

Section numbers refer to the Modbus Application Protocol V1.1b3. ``docs/decisions/0002-modbus.md`` explains
why no library answers.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from altd import __version__
from altd.config import ModbusRtuPortSettings, ModbusTcpSettings
from altd.publish.modbus.checked_block import BLOCK, CheckedBlock
from altd.publish.modbus.machine_blocks import JOINT, MACHINE
from altd.publish.modbus.registers import (
    FAR,
    MEASUREMENT,
    NEAR,
    RegisterImage,
    WordOrder,
    image,
)
from altd.publish.modbus.unit_blocks import CONDITION, RELATIVE, UNIT
from altd.publish.modbus.values import DISCRETE_INPUTS
from altd.status.health import Component
from altd.status.proof import Stamps
from altd.status.services import NoSelfCheckError
from altd.status.unit import PublishedUnit, UnitFacts, UnitView
from altd.status.zero import NoZeroError

log = logging.getLogger("altd")


class ExceptionCode(IntEnum):
    """Reason of a refused request (7)."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_ADDRESS = 2
    ILLEGAL_VALUE = 3
    DEVICE_FAILURE = 4
    DEVICE_BUSY = 6
    GATEWAY_NO_RESPONSE = 11


WRITE_SINGLE_REGISTER = 6
"""Function code (6.6): function, address, value; the response repeats the request."""

SELF_CHECK_ADDRESS, ZERO_ADDRESS = 1000, 1001
"""Addresses of the commands, beyond the registers that are read, so that no read block reaches them."""
SELF_CHECK_NOW = 1

_REQUEST = struct.Struct(">BHH")

READ_DEVICE_IDENTIFICATION = 43
MEI_TYPE = 14

OBJECTS = {0: "altd", 1: "ALT", 2: __version__, 4: UnitFacts().product}
"""Vendor, product code, version and product name of a machine's unit, by object id."""

SERIAL, CALIBRATION_DATE, CALIBRATION_CHECKSUM = 0x80, 0x81, 0x82
"""Ids of the unit's objects in the extended category; with the others they fit into one response."""

_STREAMS = {1: range(3), 2: range(0x80), 3: range(0x100)}
"""Object ids by the read code that requests them as a stream: basic, regular, extended category."""

_INDIVIDUAL = 4
_CONFORMITY = 0x83
"""Conformity level: every category, as a stream and individually."""


def objects_of(view: UnitView) -> Mapping[int, bytes]:
    """Return the objects of function 43/14, as ASCII; unknown ones are absent."""
    calibration = view.calibration_identity
    texts = OBJECTS | {
        4: view.facts.product,
        SERIAL: view.facts.serial,
        CALIBRATION_DATE: (calibration.created or "")[: len("2026-11-02")],
        CALIBRATION_CHECKSUM: calibration.checksum,
    }
    return {number: text.encode("ascii", "replace") for number, text in texts.items() if text}


def identification(request: bytes, objects: Mapping[int, bytes]) -> bytes | ExceptionCode:
    """Return the response to a request, both from the function code on; or the exception code."""
    if len(request) > 1 and request[1] != MEI_TYPE:
        return ExceptionCode.ILLEGAL_FUNCTION
    if len(request) != 4:
        return ExceptionCode.ILLEGAL_VALUE
    read_code, object_id = request[2], request[3]
    if read_code == _INDIVIDUAL:
        if object_id not in objects:
            return ExceptionCode.ILLEGAL_ADDRESS
        return _response(read_code, {object_id: objects[object_id]})
    if read_code not in _STREAMS:
        return ExceptionCode.ILLEGAL_VALUE
    category = {number: text for number, text in objects.items() if number in _STREAMS[read_code]}
    if object_id not in category:
        object_id = 0  # "as if object 0 were pointed out", 6.21
    return _response(read_code, {number: text for number, text in category.items() if number >= object_id})


def _response(read_code: int, objects: Mapping[int, bytes]) -> bytes:
    head = bytes([READ_DEVICE_IDENTIFICATION, MEI_TYPE, read_code, _CONFORMITY, 0, 0, len(objects)])
    return head + b"".join(bytes([number, len(text)]) + text for number, text in objects.items())


READ_DISCRETE_INPUTS = 2
"""Function code (6.2); eight inputs per byte, the first in the lowest bit."""

MAX_INPUTS = 2000
"""Maximum number of inputs in one response (6.2)."""

READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS = 3, 4
"""Function codes (6.3, 6.4); holding and input registers are the same."""

MAX_READ = 125
"""Maximum number of registers in one response (6.3)."""


TABLES = (MEASUREMENT, BLOCK, UNIT, CONDITION, RELATIVE, NEAR, FAR, JOINT, MACHINE)
"""Tables for functions 3 and 4; a read must not extend beyond one of them."""


class Responder:
    """Answers requests and counts them; each response shows one view of the unit.

    The unit executes the commands that ``settings`` allow.
    """

    def __init__(
        self, settings: ModbusTcpSettings | ModbusRtuPortSettings, unit: PublishedUnit, component: Component
    ) -> None:
        order = WordOrder(settings.word_order)
        self._unit = unit
        self._component = component
        self._order = order
        self._image = RegisterImage(order=order)
        self._block = CheckedBlock(order)
        self._stamps = Stamps(unit.board, component.name)
        allowed = {SELF_CHECK_ADDRESS: settings.allow_self_check, ZERO_ADDRESS: settings.allow_zero}
        self._commands = {address for address, is_allowed in allowed.items() if is_allowed}

    def answer(self, request: bytes, may_command: bool = True) -> bytes:
        """Return the response to a request, both from the function code on and not empty.

        ``may_command``: whether this client may send the commands that the settings allow.
        """
        try:
            if request[0] == WRITE_SINGLE_REGISTER and self._commands and may_command:
                response = self._command(request)
            else:
                response = self._response(request)
        except Exception:  # a defect affects one request, never the other clients
            log.exception("modbus: a defect, at request %s", request.hex())
            response = ExceptionCode.DEVICE_FAILURE
        self._component.count("requests")
        if isinstance(response, ExceptionCode):
            self._component.count("exceptions")
            return bytes([request[0] | 0x80, response])
        self._component.gave_data()
        return response

    def _response(self, request: bytes) -> bytes | ExceptionCode:
        """Return the response, or the exception code."""
        function = request[0]
        if function == READ_DEVICE_IDENTIFICATION:
            return identification(request, objects_of(self._unit.view()))
        if function not in (READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS):
            return ExceptionCode.ILLEGAL_FUNCTION
        if len(request) != _REQUEST.size:
            return ExceptionCode.ILLEGAL_VALUE
        _, address, count = _REQUEST.unpack(request)
        if not 1 <= count <= (MAX_INPUTS if function == READ_DISCRETE_INPUTS else MAX_READ):
            return ExceptionCode.ILLEGAL_VALUE
        if function == READ_DISCRETE_INPUTS:
            return self._discrete_inputs(address, count)
        words = self._registers(address, count)
        if words is None:
            return ExceptionCode.ILLEGAL_ADDRESS
        return struct.pack(f">BB{count}H", function, 2 * count, *words)

    def _command(self, request: bytes) -> bytes | ExceptionCode:
        """Execute a write; returns the request, or the exception code if nothing was changed."""
        self._component.count("commands")
        if len(request) != _REQUEST.size:
            return ExceptionCode.ILLEGAL_VALUE
        _, address, value = _REQUEST.unpack(request)
        if address not in self._commands:
            return ExceptionCode.ILLEGAL_ADDRESS
        zero = self._unit.zero
        if value != (SELF_CHECK_NOW if address == SELF_CHECK_ADDRESS else zero.state.next_number):
            return ExceptionCode.ILLEGAL_VALUE
        try:
            if address == SELF_CHECK_ADDRESS:
                self._unit.self_check.ask("modbus")
            else:
                zero.set(self._unit.board, "modbus")
        except (NoSelfCheckError, NoZeroError):
            return ExceptionCode.DEVICE_FAILURE
        return request

    def _discrete_inputs(self, address: int, count: int) -> bytes | ExceptionCode:
        rows = DISCRETE_INPUTS[address : address + count]
        if len(rows) < count:
            return ExceptionCode.ILLEGAL_ADDRESS
        view = self._unit.view()
        bits = sum(row.is_set(view) << place for place, row in enumerate(rows))
        content = bits.to_bytes((count + 7) // 8, "little")
        return bytes([READ_DISCRETE_INPUTS, len(content)]) + content

    def _registers(self, address: int, count: int) -> list[int] | None:
        """Return ``count`` registers from an address on; None: not all of them are in one table."""
        if place := MEASUREMENT.place(address, count):
            return self._image.at(self._unit.view())[place]
        if place := BLOCK.place(address, count):
            return self._block.at(self._unit.view(self._stamps.next()))[place]
        for table in TABLES[2:]:
            if place := table.place(address, count):
                return image(self._unit.view(), table, self._order)[place]
        return None


DIAGNOSTICS, REPORT_SERVER_ID = 8, 17
"""Function codes that exist only on serial lines (6.8, 6.13)."""

SERVER_ID, RUNNING = 0xA1, 0xFF
"""Server id and run status, one byte each, as libmodbus and mbpoll read them; 6.13 leaves lengths open."""

_CLEAR = 10


@dataclass(slots=True)
class LineCounters:
    """Counters of the line since it was opened or a client cleared them; each is sent modulo 65536.

    ``messages`` counts whole frames of any unit, ``errors`` fragments that are not frames, ``requests`` the
    requests to this unit, ``exceptions`` its exception responses, ``unanswered`` its responses for which the
    line had no room.
    """

    messages: int = 0
    errors: int = 0
    exceptions: int = 0
    requests: int = 0
    unanswered: int = 0


COUNTERS = {11: "messages", 12: "errors", 13: "exceptions", 14: "requests", 15: "unanswered"}
"""Counters by sub-function (6.8.1)."""


def serial_response(request: bytes, counters: LineCounters, facts: UnitFacts) -> bytes | None:
    """Return the response to a request, both from the function code on; None for other functions."""
    if request[0] == DIAGNOSTICS:
        response = _diagnostics(request, counters)
    elif request[0] == REPORT_SERVER_ID:
        response = _server_id(request, facts)
    else:
        return None
    return response if isinstance(response, bytes) else bytes([request[0] | 0x80, response])


def _diagnostics(request: bytes, counters: LineCounters) -> bytes | ExceptionCode:
    if request[1:3] == bytes(2) and len(request) > 3:
        return request
    if len(request) != _REQUEST.size:
        return ExceptionCode.ILLEGAL_VALUE
    _, what, data = _REQUEST.unpack(request)
    if what not in (_CLEAR, *COUNTERS):
        return ExceptionCode.ILLEGAL_FUNCTION
    if data != 0:
        return ExceptionCode.ILLEGAL_VALUE
    if what == _CLEAR:
        for name in COUNTERS.values():
            setattr(counters, name, 0)
        return request
    return _REQUEST.pack(DIAGNOSTICS, what, getattr(counters, COUNTERS[what]) & 0xFFFF)


def _server_id(request: bytes, facts: UnitFacts) -> bytes | ExceptionCode:
    if len(request) != 1:
        return ExceptionCode.ILLEGAL_VALUE
    known = " ".join(["ALT", facts.version, facts.serial])
    content = bytes([SERVER_ID, RUNNING]) + known.encode("ascii", "replace")
    return bytes([REPORT_SERVER_ID, len(content)]) + content
