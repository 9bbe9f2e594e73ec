"""The end of a command: normal, by a signal, by an error; its exit status and its last line."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

from altd.errors import BadInputError
from altd.process.standard_streams import (
    clear_counter,
    drop_unwritten,
    output_failure,
    prepare_streams,
    print_errors,
)

Result = TypeVar("Result")


class EndedBySignal(BaseException):
    """A signal requested the end. Not an ``Exception``, so only the end of the command catches it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number

    @property
    def status(self) -> int:
        """Exit status that a shell assigns to it."""
        return 128 + self.number


def run_to_end(work: Callable[[], int], name: Callable[[], str]) -> int:
    """Run a command called ``name``; returns the exit status of the process.

    The status is that of the work, 2 for a mistake of the caller, 1 if standard output did not accept
    everything, or 128 plus the number of the signal that ended it. The work's cleanup runs first.
    """
    prepare_streams()
    try:
        with _signals_raised():
            return _status_of(work, name)
    finally:
        drop_unwritten()


def _status_of(work: Callable[[], int], name: Callable[[], str]) -> int:
    try:
        status = work()
    except BadInputError as error:
        print_errors(*(f"{name()}: {line}" for line in error.lines))
        return 2
    except EndedBySignal as end:
        clear_counter()
        return end.status
    except ModuleNotFoundError as error:
        missing = f"the Python package {error.name!r} is missing in {sys.executable}"
        print_errors(f"{name()}: {missing}: start the `altd` that was installed, see docs/install.md")
        return 1
    except SystemExit as end:  # the parser has already printed the reason
        status = end.code if isinstance(end.code, int) else 1
    except OSError:
        if output_failure() is None:
            raise
        status = 1
    if (failure := output_failure()) is not None:
        status = status or 1
        if not isinstance(failure, BrokenPipeError):  # the reader of our output has ended
            print_errors(f"{name()}: standard output: {failure.strerror}")
    return status


async def until_signal(work: Coroutine[None, None, Result], hangup: asyncio.Event | None = None) -> Result:
    """Run until done; raises EndedBySignal after a signal, once the work has cleaned up.

    With the event of ``hangups``, SIGHUP only sets that event.
    """
    loop = asyncio.get_running_loop()
    task = asyncio.ensure_future(work)
    asked: list[int] = []

    def end(number: int) -> None:
        asked.append(number)
        task.cancel()

    before = {number: signal.getsignal(number) for number in _ending_signals()}
    for number in before:
        loop.add_signal_handler(number, end, number)
    if hangup is not None:
        loop.add_signal_handler(signal.SIGHUP, hangup.set)
    try:
        return await task
    except asyncio.CancelledError:
        if not asked:
            raise
        raise EndedBySignal(asked[0]) from None
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)


def hangups() -> asyncio.Event | None:
    """Return an event that SIGHUP sets from now on; None: it is ignored, or means a closed terminal."""
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN or _has_terminal():
        return None
    event = asyncio.Event()
    signal.signal(signal.SIGHUP, lambda *_: event.set())
    return event


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_CLOEXEC))
        return True
    except OSError:
        return False


@contextmanager
def _signals_raised() -> Iterator[None]:
    """Raise EndedBySignal on an ending signal; a second one ends the process at once."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return
    before = {number: signal.getsignal(number) for number in _ending_signals()}
    for number in before:
        signal.signal(number, _end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(number: int, _frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_DFL)
    raise EndedBySignal(number)


def _ending_signals() -> list[signal.Signals]:
    """Return SIGINT, SIGTERM and SIGHUP, without those that are ignored, as by nohup(1)."""
    ending = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    return [number for number in ending if signal.getsignal(number) is not signal.SIG_IGN]
