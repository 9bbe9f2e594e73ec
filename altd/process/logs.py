"""The log on standard error: it never blocks the caller, and no client can flood it."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import re
import select
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from altd.errors import one_line

LOG_REPEAT_S = 10.0
"""Time in which a cause is written once, s; its next line gives the number of repetitions."""

MAX_CAUSES = 20
"""Maximum number of different causes of one logger that are written in this time; others are counted."""

MAX_WAITING_LINES = 1000
"""Maximum number of waiting lines while standard error is blocked; further lines are dropped and counted."""

JOIN_TIMEOUT_S = 1.0
"""Longest wait at the end for standard error to accept the rest, s."""

_PLAIN = logging.Formatter()
_ADDRESSES_AND_NUMBERS = re.compile(r"0x[0-9a-f]+|\d+")


@dataclass(slots=True)
class _Cause:
    line: str
    written_s: float
    held_back: int = 0


class RepeatLimit:
    """Passes warnings and errors of one cause once in ``LOG_REPEAT_S``, and counts the others.

    A cause is a logger, a level and a message without its numbers. Informational lines are not limited: their
    source writes at most one per second, and the last of them must be the true one.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._causes: dict[str, dict[str, _Cause]] = {}

    def note(self, record: logging.LogRecord) -> str | None:
        """Return the addition to the record's line, or None if the record is held back."""
        if record.levelno <= logging.INFO:
            return ""
        now_s = self._clock()
        family = record.name.partition(".")[0]
        message = record.getMessage()
        causes = self._causes.setdefault(family, {})
        key = f"{record.levelno} {_ADDRESSES_AND_NUMBERS.sub('', message)}"
        if key not in causes and len(causes) >= MAX_CAUSES:
            key, message = "", f"{family}: many different messages"
        cause = causes.get(key)
        if cause is not None and now_s - cause.written_s < LOG_REPEAT_S:
            cause.held_back += 1
            return None
        held_back = 0 if cause is None else cause.held_back
        causes[key] = _Cause(message, now_s)
        return _repeats_note(held_back)

    def due(self, *, all_of_them: bool = False) -> list[str]:
        """Return lines for causes held back without repetition since; forgets causes whose time is over."""
        now_s = self._clock()
        lines = []
        for causes in self._causes.values():
            for key, cause in list(causes.items()):
                if all_of_them or now_s - cause.written_s >= LOG_REPEAT_S:
                    del causes[key]
                    if cause.held_back:
                        lines.append(cause.line + _repeats_note(cause.held_back))
        return lines


class StderrLog(logging.Handler):
    """Passes lines to a writer thread; lines that standard error does not accept in time are dropped."""

    def __init__(self, prefix: str = "", descriptor: int = 2) -> None:
        super().__init__()
        self._prefix = prefix
        self._descriptor = descriptor
        self._limit = RepeatLimit()
        self._lines: queue.Queue[str] = queue.Queue(MAX_WAITING_LINES)
        self._dropped = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Accept a record without waiting."""
        try:
            note = self._limit.note(record)
            if note is None:
                return
            traceback = "" if record.exc_info is None else _PLAIN.formatException(record.exc_info)
            self._enqueue(record.getMessage() + note, traceback)
        except Exception:
            self.handleError(record)

    def close(self) -> None:
        """Write the remaining lines; wait at most ``JOIN_TIMEOUT_S`` for standard error."""
        if not self._ending.is_set():
            self._enqueue_repeats(all_of_them=True)
            self._ending.set()
            self._enqueue("")  # wakes the thread
            self._thread.join(JOIN_TIMEOUT_S)
        super().close()

    def _enqueue(self, line: str, traceback: str = "") -> None:
        """Queue an escaped line; traceback lines are indented so that their text cannot imitate a line."""
        indented = (f"\n  {one_line(each)}" for each in traceback.splitlines())
        try:
            self._lines.put_nowait(one_line(line) + "".join(indented))
        except queue.Full:
            self._dropped += 1

    def _enqueue_repeats(self, *, all_of_them: bool = False) -> None:
        self.acquire()
        try:
            for line in self._limit.due(all_of_them=all_of_them):
                self._enqueue(line)
        finally:
            self.release()

    def _run(self) -> None:
        flushed_s = time.monotonic()
        while not (self._ending.is_set() and self._lines.empty()):
            try:
                line = self._lines.get(timeout=LOG_REPEAT_S)
            except queue.Empty:
                line = ""
            if time.monotonic() - flushed_s >= LOG_REPEAT_S:
                flushed_s = time.monotonic()
                self._enqueue_repeats()
            if line:
                self._write(line)
            if self._lines.empty():
                dropped, self._dropped = self._dropped, 0
                if dropped:
                    self._write(f"standard error was blocked; dropped lines: {dropped}")

    def _write(self, line: str) -> None:
        """Write a line, however long it takes; if standard error is closed, the line is dropped."""
        rest = f"{self._prefix}{line}\n".encode()
        try:
            while rest:
                try:
                    rest = rest[os.write(self._descriptor, rest) :]
                except BlockingIOError:
                    select.select([], [self._descriptor], [])
        except OSError:
            self._dropped += 1


@contextlib.contextmanager
def logging_to_stderr(level: int, prefix: str = "altd: ") -> Iterator[None]:
    """Write log records from ``level`` on to standard error, with ``prefix``."""
    root, handler = logging.getLogger(), StderrLog(prefix)
    before = root.level
    root.addHandler(handler)
    root.setLevel(level)
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(before)
        handler.close()


def _repeats_note(held_back: int) -> str:
    return f" ({held_back} more like it in {LOG_REPEAT_S:g} s)" if held_back else ""
