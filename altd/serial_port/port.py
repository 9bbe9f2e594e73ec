"""A serial port inside the event loop: no call blocks, and data is sent completely or not at all.

Reading and writing bypass pyserial: with a zero timeout its ``write`` spins while the device accepts nothing,
and both add system calls that a ready event loop does not need.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
from collections.abc import AsyncIterator
from typing import Any

import serial

from altd.config import SerialPortSettings
from altd.runtime.threads import call_in_thread
from altd.serial_line.opening import LineSettings, close_serial, open_serial

MAX_READ_BYTES = 4096

CLOSE_TIMEOUT_S = 1.0
"""Maximum wait for closing; a device that accepts nothing blocks it for 30 s."""

_THREAD = "serial-port"


@contextlib.asynccontextmanager
async def opened(settings: SerialPortSettings, limit: int, *, fresh: bool) -> AsyncIterator[Port]:
    """Open the port for the context; raises OSError with a sentence for a technician and the device's name.

    At most ``limit`` bytes wait to be sent. ``fresh``: bytes in the kernel's buffer count too, for data that
    must not be late; some drivers (cdc_acm) then count a whole buffer for each write that is not sent yet.
    """
    line = LineSettings(settings.baud, settings.parity, settings.stop_bits, settings.rs485)
    opening = call_in_thread(lambda: open_serial(settings.device, line), _THREAD)
    try:
        device = await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close_unwanted)
        raise
    finally:
        del opening  # its exception would refer to this frame
    port = Port(device, limit, fresh)
    try:
        yield port
    finally:
        port.forget()
        await asyncio.wait({_close_in_thread(device)}, timeout=CLOSE_TIMEOUT_S)


class Port:
    """One open port, for one task."""

    def __init__(self, device: serial.Serial, limit: int, fresh: bool) -> None:
        self._loop = asyncio.get_running_loop()
        self._limit = limit
        self._fresh = fresh
        self._rest = bytearray()
        self._serial = device
        self._descriptor: int = device.fileno()

    def write(self, data: bytes) -> bool:
        """Send all of ``data``, or nothing and return False if too much waits already; raises OSError."""
        try:
            waiting = len(self._rest) + (self._serial.out_waiting if self._fresh else 0)
            if waiting + len(data) > self._limit:
                return False
            self._rest += data
            self._push()
        except OSError as error:
            raise self._gone() from error
        return True

    async def read(self, until: asyncio.Future[Any] | None = None, limit: int = MAX_READ_BYTES) -> bytes:
        """Return the next bytes, or none once ``until`` is done; raises OSError if the device is gone.

        Bytes beyond ``limit`` stay in the kernel's buffer, which limits the sender.
        """
        ready = self._loop.create_future()

        def wake(*_: object) -> None:
            if not ready.done():
                ready.set_result(None)

        self._loop.add_reader(self._descriptor, wake)
        if until is not None:
            until.add_done_callback(wake)
        try:
            await ready
            data = os.read(self._descriptor, limit)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone() from error
        finally:
            self._loop.remove_reader(self._descriptor)
            if until is not None:
                until.remove_done_callback(wake)
        if not data:
            raise self._gone()
        return data

    def forget(self) -> None:
        """Discard the bytes that wait to be sent."""
        self._rest.clear()
        self._loop.remove_writer(self._descriptor)

    def _gone(self) -> OSError:
        return OSError(errno.EIO, "the port is gone: unplugged, or switched off?", self._serial.port)

    def _push(self) -> None:
        """Write the bytes that the kernel accepts now; the rest follows when it accepts more."""
        with contextlib.suppress(BlockingIOError):
            del self._rest[: os.write(self._descriptor, self._rest)]
        if self._rest:
            self._loop.add_writer(self._descriptor, self._push_later)
        else:
            self._loop.remove_writer(self._descriptor)

    def _push_later(self) -> None:
        try:
            self._push()
        except OSError:  # the next read or write fails again and raises
            self._loop.remove_writer(self._descriptor)


def describe(settings: SerialPortSettings) -> str:
    """Return the port in a technician's notation: ``/dev/ttyS1, 9600 baud 8N1``."""
    mode = " RS485" if settings.rs485 is not None else ""
    return f"{settings.device}, {settings.baud} baud 8{settings.parity[0].upper()}{settings.stop_bits}{mode}"


def seconds_on_line(settings: SerialPortSettings, length: int) -> float:
    """Return the time of ``length`` bytes on the line, s: each has start, 8 data, parity and stop bits."""
    bits = 1 + 8 + (settings.parity != "none") + settings.stop_bits
    return length * bits / settings.baud


def _close_in_thread(device: serial.Serial) -> asyncio.Future[None]:
    """Close the port in a thread, for this may take long; return a future that is done then."""
    return call_in_thread(lambda: close_serial(device), _THREAD)


def _close_unwanted(opening: asyncio.Future[serial.Serial]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        _close_in_thread(opening.result())
