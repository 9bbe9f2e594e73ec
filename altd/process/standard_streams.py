"""Standard input, output and error in any state: closed, full, disconnected."""

from __future__ import annotations

import contextlib
import io
import os
import select
import sys
from typing import Any

from altd.errors import escaped

_COMPLAINT_TIMEOUT_MS = 1000

_STREAMS = (("stdin", "r", os.O_WRONLY), ("stdout", "w", os.O_RDONLY), ("stderr", "w", os.O_WRONLY))
"""Name, mode, and flags for opening the null device: all but standard error then refuse to be used."""


class _Output(io.FileIO):
    """Standard output that stores the error of a failed write, which a caller may ignore."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


def prepare_streams() -> None:
    """Open the null device for closed descriptors 0, 1 and 2, and watch standard output.

    Otherwise the next opened file would get the number, and prints would go into it. Printing to a closed
    standard output fails (EBADF), because a lost response is not a success.
    """
    is_process_output = sys.stdout is sys.__stdout__
    for descriptor, (name, mode, way) in enumerate(_STREAMS):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, way)  # gets the lowest free number, this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(descriptor, mode, closefd=False))  # noqa: SIM115  a descriptor
    if is_process_output:
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(_Output(1, "w", closefd=False)),
            encoding=sys.stdout.encoding,
            errors="backslashreplace",  # standard output may be ASCII
            line_buffering=sys.stdout.isatty() or getattr(sys.stdout, "write_through", False),
        )


def print_lines(*lines: str) -> None:
    """Print lines on standard output, each ``escaped``."""
    sys.stdout.write("".join(f"{escaped(line)}\n" for line in lines))
    sys.stdout.flush()


def print_errors(*lines: str) -> None:
    """Print lines on standard error, each ``escaped``, unless it is blocked for a second.

    A counter in the last line of a terminal is overwritten.
    """
    _write(_erasure() + "".join(f"{escaped(line)}\n" for line in lines))


def clear_counter() -> None:
    """Erase a counter in the last line of a terminal."""
    if clearing := _erasure():
        _write(clearing)


def _erasure() -> str:
    try:
        return "\r\033[K" if sys.stderr.isatty() else ""
    except ValueError:  # it is closed
        return ""


def _write(text: str) -> None:
    try:
        descriptor = sys.stderr.fileno()
    except (OSError, ValueError):  # the replaced stream has none, or it is closed
        descriptor = None
    with contextlib.suppress(OSError, ValueError):
        if descriptor is None or _takes_output(descriptor):
            sys.stderr.write(text)
            sys.stderr.flush()


def output_failure() -> OSError | None:
    """Return the error of standard output; None if it has accepted everything."""
    try:
        sys.stdout.flush()
    except OSError as error:
        return error
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.failure if isinstance(raw, _Output) else None


def drop_unwritten() -> None:
    """Drop unwritten output, which Python would otherwise retry at its end with an error message."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, stream.fileno())
            os.close(nothing)


def _takes_output(descriptor: int) -> bool:
    waiting = select.poll()
    waiting.register(descriptor, select.POLLOUT)
    return bool(waiting.poll(_COMPLAINT_TIMEOUT_MS))
