"""The demo's terminal: a screen redrawn in place, single keys, and the terminal restored at the end."""

import asyncio
import contextlib
import os
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from typing import Any


class Style(StrEnum):
    """Style of a line: parameters of the control sequence SGR (ECMA-48, 8.3.117)."""

    PLAIN = ""
    BOLD = "1"
    DIM = "2"
    GOOD = "1;32"
    BAD = "1;31"


StyledLine = tuple[str, Style]

_ENTER = "\x1b[?1049h\x1b[?25l"  # alternate screen, hidden cursor
_LEAVE = "\x1b[0m\x1b[?25h\x1b[?1049l"


class Screen:
    """The terminal on standard output, and the keys of the terminal on standard input.

    Only changed lines are written, so that a person can select and copy the others.
    """

    def __init__(self) -> None:
        self._size = os.terminal_size((0, 0))
        self._shown: list[StyledLine] = []
        self._lock = threading.Lock()
        self._left = False

    async def draw(self, lines: Sequence[StyledLine]) -> None:
        """Show these lines, cut to the terminal's size. A terminal that accepts no data blocks nothing."""
        await asyncio.to_thread(self._write, self._changes(lines))

    def _changes(self, lines: Sequence[StyledLine]) -> str:
        size = os.get_terminal_size(sys.stdout.fileno())
        cut = [(text[: size.columns], style) for text, style in lines]
        if len(cut) > size.lines:
            more = len(cut) - size.lines + 1
            cut[size.lines - 1 :] = [
                (f"({more} more lines: make the window higher)"[: size.columns], Style.DIM)
            ]
        changes = ""
        if size != self._size:
            self._size, self._shown = size, []
            changes = "\x1b[2J"
        for row, line in enumerate(cut, start=1):
            if row > len(self._shown) or line != self._shown[row - 1]:
                text, style = line
                changes += f"\x1b[{row};1H\x1b[{style}m{text}\x1b[0m\x1b[K"
        if len(cut) < len(self._shown):
            changes += f"\x1b[{len(cut) + 1};1H\x1b[J"
        self._shown = cut
        return changes

    def _write(self, text: str) -> None:
        with self._lock:
            if not self._left:
                sys.stdout.write(text)
                sys.stdout.flush()

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Use the alternate screen; restore the terminal in any case."""
        self._write(_ENTER)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # the terminal is gone
                self._write(_LEAVE)
            self._left = True


@contextlib.contextmanager
def keys(pressed: Callable[[str], None]) -> Iterator[bool]:
    """Call ``pressed`` with every key immediately; yields whether there is a keyboard.

    Ctrl-C still works. Ctrl-S and Ctrl-Z, which would freeze a half-drawn screen, do nothing.
    """
    keyboard = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
    if keyboard is None or os.tcgetpgrp(keyboard) != os.getpgrp():  # no terminal, or the shell owns it
        yield False
        return
    before = termios.tcgetattr(keyboard)
    loop = asyncio.get_running_loop()

    def read() -> None:
        typed = os.read(keyboard, 64)
        if not typed:
            loop.remove_reader(keyboard)
        for key in typed.decode("ascii", "ignore"):
            pressed(key)

    try:
        _take_single_keys(keyboard)
        loop.add_reader(keyboard, read)
        yield True
    finally:
        loop.remove_reader(keyboard)
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def _take_single_keys(keyboard: int) -> None:
    tty.setcbreak(keyboard, termios.TCSADRAIN)
    attributes: list[Any] = termios.tcgetattr(keyboard)
    attributes[tty.IFLAG] &= ~termios.IXON
    attributes[tty.CC][termios.VSUSP] = b"\0"
    termios.tcsetattr(keyboard, termios.TCSADRAIN, attributes)
