"""Serial ports: find and open them.

These calls may block for seconds: every request to a USB adapter goes over its bus, and each request to a
hanging adapter times out only after five seconds.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import termios
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import serial
from serial.tools import list_ports

_STABLE = (Path("/dev/serial/by-id"), Path("/dev/serial/by-path"))


@dataclass(frozen=True, slots=True)
class FoundPort:
    """One port: its path, if possible one that survives re-plugging, the kernel's path, a description."""

    path: Path
    device: Path
    about: str


def has_hardware(device: Path, folder: Path = Path("/sys/class/tty")) -> bool:
    """Whether a port exists: the kernel names more on-board ports than there are (type 0)."""
    try:
        return (folder / device.name / "type").read_text().strip() != "0"
    except OSError:
        return True


def find_ports() -> list[FoundPort]:
    """Return the serial ports of this machine, sorted by device name; none is opened."""
    stable: dict[Path, Path] = {}
    for folder in _STABLE:
        for link in sorted(folder.glob("*")):
            stable.setdefault(link.resolve(), link)
    found = []
    for port in sorted(list_ports.comports()):
        device = Path(port.device)
        if not has_hardware(device):
            continue
        about = port.description if port.description not in ("n/a", port.name) else "serial port"
        found.append(FoundPort(stable.get(device.resolve(), device), device, about))
    return found


_TIOCSRS485 = 0x542F  # not in Python's termios
_RS485 = struct.Struct("=3I20x")
"""``struct serial_rs485`` of linux/serial.h: flags, delay before and after sending in ms, reserved."""
_ENABLED, _RTS_ON_SEND, _RTS_AFTER_SEND = 1, 2, 4

_SENTENCES = {
    errno.ENOENT: "there is no such port now: unplugged, or switched off?",
    errno.EACCES: "this user may not open it: see `altd doctor`",
    errno.EPERM: "the service may not open this kind of port: see DeviceAllow in its unit",
    errno.EBUSY: "another program uses the port",
    errno.ENOTTY: "is not a serial port or refuses its settings",
}


class Rs485(Protocol):
    """The kernel's RS485 mode, as in ``[serial.rs485]``."""

    rts_while_sending: Literal["high", "low"]
    delay_before_ms: int
    delay_after_ms: int


@dataclass(frozen=True, slots=True)
class LineSettings:
    """Format of bytes on a line: 8 data bits, without flow control."""

    baud: int
    """Bits per second."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    rs485: Rs485 | None = None
    """RS-485 mode of the kernel; None: the direction needs no switching."""


def open_serial(
    device: Path, line: LineSettings, *, read_timeout_s: float = 0.0, write_timeout_s: float = 0.0
) -> serial.Serial:
    """Open the port with the settings of its line, locked against other programs until it is closed.

    Raises OSError with a sentence for a technician as ``strerror`` and the device as ``filename``.
    """
    try:
        port = serial.Serial(
            str(device),
            line.baud,
            parity=line.parity[0].upper(),
            stopbits=line.stop_bits,
            timeout=read_timeout_s,
            write_timeout=write_timeout_s,
            exclusive=True,  # a lock that daemons and good terminal programs respect
            inter_byte_timeout=0,  # sets VMIN to 1: an empty read then means a hang-up, not an idle line
        )
    except serial.SerialException as error:
        raise _named(device, error.errno) from error
    except termios.error as error:
        raise OSError(error.args[0], f"refuses its settings: {error.args[1]}", str(device)) from error
    try:
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)  # keeps out programs that ignore the lock
        if line.rs485 is not None:
            _switch_to_rs485(port.fileno(), device, line.rs485)
    except BaseException as error:
        close_serial(port)
        if isinstance(error, OSError) and error.filename is None:
            raise _named(device, error.errno) from error
        raise
    return port


def close_serial(port: serial.Serial) -> None:
    """Release the port. Discard unsent bytes if the driver can: closing would wait for them.

    cdc_acm cannot: an adapter that accepts no bytes blocks this call for 30 s.
    """
    with contextlib.suppress(OSError, termios.error):
        port.reset_output_buffer()
    with contextlib.suppress(OSError):
        fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
    port.close()


def _switch_to_rs485(descriptor: int, device: Path, wanted: Rs485) -> None:
    """Let the kernel switch the transceiver; raises OSError if it cannot, or not with these settings.

    pyserial's ``rs485_mode`` is not used: it keeps neither the error number nor the settings that the driver
    actually applied.
    """
    level = _RTS_ON_SEND if wanted.rts_while_sending == "high" else _RTS_AFTER_SEND
    asked = (_ENABLED | level, wanted.delay_before_ms, wanted.delay_after_ms)
    try:
        # The kernel returns the settings that it applied, without those that the driver cannot apply.
        flags, before_ms, after_ms = _RS485.unpack(fcntl.ioctl(descriptor, _TIOCSRS485, _RS485.pack(*asked)))
    except OSError as error:
        if error.errno not in (errno.ENOTTY, errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        sentence = "has no RS485 mode: leave rs485 out if the adapter switches direction automatically"
        raise OSError(errno.ENOTTY, sentence, str(device)) from error
    given = (flags & (_ENABLED | _RTS_ON_SEND | _RTS_AFTER_SEND), before_ms, after_ms)
    if given != asked:
        raise OSError(errno.EINVAL, f"cannot do rs485 so: {_difference(asked, given)}", str(device))


def _difference(asked: tuple[int, int, int], given: tuple[int, int, int]) -> str:
    if not given[0] & _ENABLED:
        return "its driver leaves it off"
    if given[0] != asked[0]:
        return "rts_while_sending is the other level only"
    names = ("delay_before_ms", "delay_after_ms")
    changes = zip(names, asked[1:], given[1:], strict=True)
    return ", ".join(f"{name} = {ms} becomes {made}" for name, ms, made in changes if made != ms)


def _named(device: Path, number: int | None) -> OSError:
    """Return the error with its sentence. pyserial has no error number for a file that is no serial port."""
    if number is None:
        number = errno.ENOTTY
    elif number == errno.EAGAIN:  # another program holds the lock
        number = errno.EBUSY
    return OSError(number, _SENTENCES.get(number, os.strerror(number)), str(device))
