"""Modbus RTU on a serial port, alone or as one of many units on an RS485 bus.

"Serial" is the Modbus over Serial Line Specification V1.02.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from pymodbus.framer import FramerRTU

from altd.config import ModbusRtuPortSettings
from altd.publish.modbus.bus import MAX_FRAME_BYTES, Bus
from altd.publish.modbus.responder import Responder
from altd.serial_port.port import Port, describe, opened
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Component, State

BITS_PER_CHARACTER = 11

MAX_BUFFERED_BYTES = 1024
"""Of what comes without a silence: a busy computer receives some frames at once."""


def silence_s(baud: int) -> float:
    """The silence that ends a frame: 3.5 characters, above 19200 baud 1.75 ms (Serial 2.5.1.1)."""
    return 1.75e-3 if baud > 19200 else 3.5 * BITS_PER_CHARACTER / baud


class ModbusRtuPublisher:
    """Serves the board over Modbus RTU; is silent to any unit id but its own."""

    def __init__(
        self,
        settings: ModbusRtuPortSettings,
        board: Board,
        component: Component,
        state: Callable[[], StateReport | None] = lambda: None,
    ) -> None:
        self._settings = settings
        self._responder = Responder(board, component, state)
        self._component = component

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the port cannot be had or is gone."""
        async with opened(self._settings, limit=MAX_FRAME_BYTES, fresh=True) as port:
            ready()
            unit = f"unit id {self._settings.unit_id} on {describe(self._settings)}"
            self._component.set_state(State.OK, f"Modbus RTU, {unit}")
            await self._serve(port)

    async def _serve(self, port: Port) -> None:
        clock = asyncio.get_running_loop().time
        bus, answered = Bus(self._settings.unit_id), b""
        while True:
            received = await port.read() + await self._until_silence(port)
            request = bus.receive(received[-MAX_BUFFERED_BYTES:], clock())
            if request is not None and self._framed(request) != answered:  # a two-wire adapter hears itself
                answered = self._framed(await self._responder.answer(request))
                if not port.write(answered):  # the controller does not listen; it asks again when it does
                    self._component.count("answers_dropped")

    async def _until_silence(self, port: Port) -> bytes:
        """What is received before the line falls silent."""
        received = b""
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(silence_s(self._settings.baud)):
                    received = (received + await port.read())[-MAX_BUFFERED_BYTES:]
        return received

    def _framed(self, answer: bytes) -> bytes:
        frame = bytes([self._settings.unit_id]) + answer
        return frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big")
