"""Progress of a scan on standard error: a bar on a terminal, lines that stay in a pipe."""

from __future__ import annotations

import shutil
import sys
import time

from altd.errors import one_line
from altd.process.standard_streams import complain

_BAR_LETTERS = 24


class ScanScreen:
    """See ``altd.acquisition.scan.scanner.ProgressReporter``; ``name`` begins the lines that stay."""

    def __init__(self, name: str = "altd scan") -> None:
        self._name = name
        self._terminal = sys.stderr.isatty()
        self._first: tuple[float, int] | None = None

    def say(self, line: str) -> None:
        """A line of its own, above the bar."""
        self.clear()
        complain(f"{self._name}: {line}")

    def progress(self, done: int, total: int, doing: str) -> None:
        """Draw the bar again; nothing in a pipe."""
        if not self._terminal:
            return
        bar = ("#" * (_BAR_LETTERS * done // total)).ljust(_BAR_LETTERS, ".")
        line = f"[{bar}] {done}/{total} nodes{self._left(done, total)}  {doing}"
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write(f"\r{one_line(line)[:width]}\033[K")
        sys.stderr.flush()

    def clear(self) -> None:
        """Take the bar away."""
        if self._terminal:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()

    def _left(self, done: int, total: int) -> str:
        """The time that the other nodes will take at the pace of this run."""
        now = time.monotonic()
        if self._first is None or done <= self._first[1]:
            self._first = now, done
            return ""
        since, at_first = self._first
        left_s = round((now - since) / (done - at_first) * (total - done))
        return f", {left_s // 60}:{left_s % 60:02d} left"
