"""Modbus RTU on a serial port, alone or as one of many units on an RS485 bus.

"Serial" is the Modbus over Serial Line Specification V1.02.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import termios
from collections.abc import Callable

import serial
from pymodbus.framer import FramerRTU

from altd.config import SerialPort
from altd.publish.modbus.responder import Responder
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
        port = _opened(self._settings)
        reader = asyncio.StreamReader()
        try:
            transport, _ = await asyncio.get_running_loop().connect_read_pipe(
                lambda: asyncio.StreamReaderProtocol(reader), port
            )
            try:
                ready()
                self._component.say(State.OK, f"Modbus RTU, unit id {self._settings.unit_id}")
                await self._serve(reader, port.fileno())
            finally:
                transport.close()
        finally:
            with contextlib.suppress(OSError, termios.error):
                port.reset_output_buffer()  # close would wait until it is sent
            port.close()

    async def _serve(self, reader: asyncio.StreamReader, descriptor: int) -> None:
        clock = asyncio.get_running_loop().time
        heard, heard_at, answered = b"", clock(), b""
        while True:
            first = await _read(reader)
            if clock() - heard_at > TORN_S:
                heard = b""
            heard = (heard + first + await self._until_silence(reader))[-LONGEST:]
            heard_at = clock()
            if answered and heard.endswith(answered):
                heard = b""  # a two-wire adapter hears what it sends
                continue
            request = request_at_end(heard, self._settings.unit_id)
            if request is not None:
                heard = b""
                answered = self._framed(await self._responder.answer(request))
                self._send(descriptor, answered)

    async def _until_silence(self, reader: asyncio.StreamReader) -> bytes:
        """What is heard before the line falls silent."""
        heard = b""
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(silence_s(self._settings.baud)):
                    heard = (heard + await _read(reader))[-LONGEST:]
        return heard

    def _framed(self, answer: bytes) -> bytes:
        frame = bytes([self._settings.unit_id]) + answer
        return frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big")

    def _send(self, descriptor: int, frame: bytes) -> None:
        """Hand a frame to the kernel; what it does not take at once is lost: the controller asks again."""
        try:
            sent = os.write(descriptor, frame)
        except BlockingIOError:
            sent = 0
        if sent < len(frame):
            self._component.count("answers_cut")


async def _read(reader: asyncio.StreamReader) -> bytes:
    """The bytes that came, at least one; raises OSError when the port is gone."""
    came = await reader.read(LONGEST)
    if not came:
        raise OSError("the serial port is gone")
    return came


def _opened(settings: SerialPort) -> serial.Serial:
    """The port, for us alone; raises OSError that names the device."""
    device = str(settings.device)
    try:
        return serial.Serial(
            device,
            baudrate=settings.baud,
            parity=settings.parity[0].upper(),
            stopbits=settings.stop_bits,
            timeout=0,
            inter_byte_timeout=0,  # sets VMIN to 1: to read nothing then means that the device is gone
            exclusive=True,
        )
    except termios.error as error:
        raise OSError(error.args[0], f"refuses its settings: {error.args[1]}", device) from error
    except serial.SerialException as error:  # a lock that is taken, or what is no serial port at all
        number = errno.EBUSY if error.errno == errno.EAGAIN else error.errno or errno.ENOTTY
        raise OSError(number, os.strerror(number), device) from error
