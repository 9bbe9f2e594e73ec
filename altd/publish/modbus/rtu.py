"""Modbus RTU on a serial port, alone or as one of many units on an RS485 bus.

"Serial" is the Modbus over Serial Line Specification V1.02.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from pymodbus.framer import FramerRTU

from altd.config import SerialPort
from altd.publish.modbus.responder import Responder
from altd.serial_port.port import Port, describe, opened
from altd.service.board import Board
from altd.service.health import Component, State

LONGEST = 256
"""Bytes of the longest frame (Serial 2.5.1)."""

SHORTEST = 4
"""Unit id, function and CRC."""

TORN_S = 0.1
"""A silence that no frame bridges. The specification says 1.5 characters (Serial 2.5.1.1), but USB adapters
hand over what they have every 16 ms."""

BITS_PER_CHARACTER = 11


def silence_s(baud: int) -> float:
    """The silence that ends a frame: 3.5 characters, above 19200 baud 1.75 ms (Serial 2.5.1.1)."""
    return 1.75e-3 if baud > 19200 else 3.5 * BITS_PER_CHARACTER / baud


def request_at_end(heard: bytes, unit_id: int) -> bytes | None:
    """The request for this unit that ends ``heard``, without unit id and CRC; None when there is none.

    The line has fallen silent, so a frame ends here; where it began is not known after noise or after other
    units' traffic. The CRC (Serial 2.5.1.2) says whether a byte that equals the unit id began it.
    """
    begin = heard.find(unit_id, max(0, len(heard) - LONGEST))
    while 0 <= begin <= len(heard) - SHORTEST:
        if FramerRTU.check_CRC(heard[begin:-2], int.from_bytes(heard[-2:], "big")):
            return heard[begin + 1 : -2]
        begin = heard.find(unit_id, begin + 1)
    return None


class ModbusRtuPublisher:
    """Serves the board over Modbus RTU; is silent to any unit id but its own."""

    def __init__(self, settings: SerialPort, board: Board, component: Component) -> None:
        self._settings = settings
        self._responder = Responder(board, component)
        self._component = component

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the port cannot be had or is gone."""
        async with opened(self._settings, limit=LONGEST, fresh=True) as port:
            ready()
            unit = f"unit id {self._settings.unit_id} on {describe(self._settings)}"
            self._component.say(State.OK, f"Modbus RTU, {unit}")
            await self._serve(port)

    async def _serve(self, port: Port) -> None:
        clock = asyncio.get_running_loop().time
        heard, heard_at, answered = b"", clock(), b""
        while True:
            first = await port.read()
            if clock() - heard_at > TORN_S:
                heard = b""
            heard = (heard + first + await self._until_silence(port))[-LONGEST:]
            heard_at = clock()
            if answered and heard.endswith(answered):
                heard = b""  # a two-wire adapter hears what it sends
                continue
            request = request_at_end(heard, self._settings.unit_id)
            if request is not None:
                heard = b""
                answered = self._framed(await self._responder.answer(request))
                if not port.write(answered):  # the controller does not listen; it asks again when it does
                    self._component.count("answers_dropped")

    async def _until_silence(self, port: Port) -> bytes:
        """What is heard before the line falls silent."""
        heard = b""
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(silence_s(self._settings.baud)):
                    heard = (heard + await port.read())[-LONGEST:]
        return heard

    def _framed(self, answer: bytes) -> bytes:
        frame = bytes([self._settings.unit_id]) + answer
        return frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big")
