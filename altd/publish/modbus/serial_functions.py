"""The functions that Modbus has for serial lines alone: diagnostics (8) and report server id (17).

Numbers of sections are those of the Modbus Application Protocol V1.1b3.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pymodbus.constants import ExcCodes

from altd.status.health import Health

DIAGNOSTICS, REPORT_SERVER_ID = 8, 17

SERVER_ID, RUNNING = 0xA1, 0xFF
"""One byte each, and then text: so libmodbus and mbpoll read it (6.13 leaves the lengths open)."""

_REQUEST = struct.Struct(">BHH")
_ECHO, _CLEAR = 0, 10


@dataclass(slots=True)
class LineCounters:
    """Counters of the line since the daemon opened it; each is sent modulo 65536.

    ``messages`` are whole frames of any unit, ``errors`` pieces that were none, ``requests`` those to this
    unit, ``exceptions`` those of its responses that were one, ``unanswered`` those for which the line had no
    room.
    """

    messages: int = 0
    errors: int = 0
    exceptions: int = 0
    requests: int = 0
    unanswered: int = 0


COUNTERS = {11: "messages", 12: "errors", 13: "exceptions", 14: "requests", 15: "unanswered"}
"""By sub-function (6.8.1)."""


def serial_response(request: bytes, counters: LineCounters, health: Health) -> bytes | None:
    """The response to a request, both from the function code on; None: it is no function of serial lines."""
    if request[0] == DIAGNOSTICS:
        response = _diagnostics(request, counters)
    elif request[0] == REPORT_SERVER_ID:
        response = _server_id(request, health)
    else:
        return None
    return response if isinstance(response, bytes) else bytes([request[0] | 0x80, response])


def _diagnostics(request: bytes, counters: LineCounters) -> bytes | ExcCodes:
    if request[1:3] == bytes(2) and len(request) > 3:
        return request
    if len(request) != _REQUEST.size:
        return ExcCodes.ILLEGAL_VALUE
    _, what, data = _REQUEST.unpack(request)
    if what not in (_CLEAR, *COUNTERS):
        return ExcCodes.ILLEGAL_FUNCTION
    if data != 0:
        return ExcCodes.ILLEGAL_VALUE
    if what == _CLEAR:
        for name in COUNTERS.values():
            setattr(counters, name, 0)
        return request
    return _REQUEST.pack(DIAGNOSTICS, what, getattr(counters, COUNTERS[what]) & 0xFFFF)


def _server_id(request: bytes, health: Health) -> bytes | ExcCodes:
    if len(request) != 1:
        return ExcCodes.ILLEGAL_VALUE
    known = " ".join(["ALT", *(health.facts.get(key, "") for key in ("version", "serial"))])
    content = bytes([SERVER_ID, RUNNING]) + known.encode("ascii", "replace")
    return bytes([REPORT_SERVER_ID, len(content)]) + content
