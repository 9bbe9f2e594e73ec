"""A serial port inside the event loop: nothing here blocks, and what is written goes out whole or not at all.

pyserial opens and sets up the port. Reading and writing go past it: with a zero timeout its ``write`` spins
while the device takes nothing, and both add system calls that a ready event loop does not need.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import termios
from typing import Any, Self

import serial

from altd.config import SerialPort

CHUNK = 4096


class Port:
    """One open port, for one task. At most ``limit`` bytes wait to go out."""

    def __init__(self, settings: SerialPort, limit: int) -> None:
        """Open the port; raises OSError that names the device."""
        self._device = str(settings.device)
        self._limit = limit
        self._loop = asyncio.get_running_loop()
        self._rest = bytearray()
        self._serial = _opened(settings)
        self._descriptor: int = self._serial.fileno()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the port. What still waits is thrown away: the kernel would block until it is out."""
        self._loop.remove_writer(self._descriptor)
        with contextlib.suppress(OSError, termios.error):
            self._serial.reset_output_buffer()
        self._serial.close()

    def write(self, data: bytes) -> bool:
        """Send all of ``data``, or nothing and return False when too much waits already; raises OSError."""
        waiting = len(self._rest) + self._serial.out_waiting
        if waiting + len(data) > self._limit:
            return False
        self._rest += data
        self._push()
        return True

    async def read(self, until: asyncio.Future[Any] | None = None) -> bytes:
        """What comes in next, or nothing once ``until`` is done; raises OSError when the device is gone."""
        ready = self._loop.create_future()

        def wake(*_: object) -> None:
            if not ready.done():
                ready.set_result(None)

        self._loop.add_reader(self._descriptor, wake)
        if until is not None:
            until.add_done_callback(wake)
        try:
            await ready
            data = os.read(self._descriptor, CHUNK)
        except BlockingIOError:
            return b""
        finally:
            self._loop.remove_reader(self._descriptor)
            if until is not None:
                until.remove_done_callback(wake)
        if not data:
            raise OSError(errno.EIO, "the other end hung up or the device is gone", self._device)
        return data

    def _push(self) -> None:
        """Hand the kernel what it takes now; the rest follows when it takes more."""
        with contextlib.suppress(BlockingIOError):
            del self._rest[: os.write(self._descriptor, self._rest)]
        if self._rest:
            self._loop.add_writer(self._descriptor, self._push_later)
        else:
            self._loop.remove_writer(self._descriptor)

    def _push_later(self) -> None:
        try:
            self._push()
        except OSError:  # the next read or write meets it again and raises
            self._loop.remove_writer(self._descriptor)


def describe(settings: SerialPort) -> str:
    """The port in the words of a technician: ``/dev/ttyS1, 9600 baud 8N1``."""
    return f"{settings.device}, {settings.baud} baud 8{settings.parity[0].upper()}{settings.stop_bits}"


def seconds_on_line(settings: SerialPort, length: int) -> float:
    """How long ``length`` bytes are on the line: start bit, 8 data bits, parity and stop bits for each."""
    bits = 1 + 8 + (settings.parity != "none") + settings.stop_bits
    return length * bits / settings.baud


def _opened(settings: SerialPort) -> serial.Serial:
    device = str(settings.device)
    try:
        return serial.Serial(
            device,
            settings.baud,
            parity=settings.parity[0].upper(),
            stopbits=settings.stop_bits,
            timeout=0,
            exclusive=True,
            inter_byte_timeout=0,  # sets VMIN to 1, so that reading nothing means a hang-up and no empty line
        )
    except serial.SerialException as error:
        if error.errno == errno.EAGAIN:
            raise OSError(errno.EBUSY, "another program uses the port", device) from error
        if error.errno is None:  # pyserial keeps the number of a refused setting in the text alone
            raise OSError(errno.ENOTTY, "is no serial port or refuses its settings", device) from error
        raise OSError(error.errno, os.strerror(error.errno), device) from error
    except termios.error as error:
        raise OSError(error.args[0], f"refuses its settings: {error.args[1]}", device) from error
