"""The terminal of ``altd watch``: curses, entered and left under all circumstances."""

from __future__ import annotations

import contextlib
import curses
import locale
import os
import select
import sys
from collections.abc import Callable, Iterator

from altd.errors import BadInputError
from altd.terminal.canvas import Canvas, Style

DRAW_INTERVAL_S = 0.2

_ESCAPE_DELAY_MS = 25
_WITHOUT_BLOCKS = ("linux", "vt", "ansi", "cons")
"""Terminals, by the beginning of their names, that may be set to UTF-8 and still lack blocks and Braille."""
_KEYS = {
    curses.KEY_LEFT: "left",
    curses.KEY_RIGHT: "right",
    curses.KEY_UP: "up",
    curses.KEY_DOWN: "down",
    curses.KEY_BTAB: "left",
    9: "tab",
}
_COLOURS = {Style.GOOD: curses.COLOR_GREEN, Style.WARNING: curses.COLOR_YELLOW, Style.BAD: curses.COLOR_RED}
_ATTRIBUTES = {
    Style.PLAIN: curses.A_NORMAL,
    Style.BOLD: curses.A_BOLD,
    Style.DIM: curses.A_DIM,
    Style.GOOD: curses.A_BOLD,
    Style.WARNING: curses.A_BOLD,
    Style.BAD: curses.A_BOLD | curses.A_REVERSE,
}


class Gone(Exception):  # noqa: N818  no error: the terminal was closed
    """The terminal was closed."""


def check_terminal() -> None:
    """Raise BadInputError if there is no terminal on which a screen can be drawn."""
    instead = "; `altd status` needs no terminal"
    for name, stream in (("standard input", sys.stdin), ("standard output", sys.stdout)):
        if not stream.isatty():
            raise BadInputError(name, f"is not a terminal{instead}")
    kind = os.environ.get("TERM", "")
    try:
        curses.setupterm(kind or "dumb", sys.stdout.fileno())
    except curses.error:
        raise BadInputError("TERM", f"unknown terminal type {kind!r}{instead}") from None
    if not kind or curses.tigetstr("cup") is None or curses.tigetstr("clear") is None:
        raise BadInputError("TERM", f"{kind!r} is a terminal without cursor addressing{instead}")


class Terminal:
    """A screen to draw on, and the pressed keys."""

    def __init__(self, window: curses.window) -> None:
        self._window = window
        self._attributes = dict(_ATTRIBUTES)
        self._waiting = select.poll()
        self._waiting.register(sys.stdin.fileno(), select.POLLIN)
        self._is_utf8 = _shows_blocks()
        window.nodelay(True)
        with contextlib.suppress(curses.error):
            curses.curs_set(0)
        if curses.has_colors():
            curses.use_default_colors()
            for number, (style, colour) in enumerate(_COLOURS.items(), start=1):
                curses.init_pair(number, colour, -1)
                self._attributes[style] = curses.color_pair(number) | curses.A_BOLD

    def canvas(self) -> Canvas:
        """Return an empty canvas of the terminal's size."""
        rows, columns = self._window.getmaxyx()
        return Canvas(rows, columns, is_utf8=self._is_utf8)

    def show(self, canvas: Canvas) -> None:
        """Show the content of a canvas."""
        self._window.erase()
        for row, runs in enumerate(canvas.runs()):
            column = 0
            for text, style in runs:
                with contextlib.suppress(curses.error):  # the cursor cannot move past the last cell
                    self._window.addstr(row, column, text, self._attributes[style])
                column += len(text)
        self._window.refresh()

    def pressed(self) -> Iterator[str]:
        """Wait for keys, at most ``DRAW_INTERVAL_S``, and yield them; raises Gone."""
        for _, what in self._waiting.poll(1000 * DRAW_INTERVAL_S):
            if what & (select.POLLHUP | select.POLLERR | select.POLLNVAL):
                raise Gone
        while (key := self._window.getch()) != curses.ERR:
            name = _KEYS.get(key) or (chr(key) if 32 <= key < 127 else "")
            if name:
                yield name


def in_terminal(work: Callable[[Terminal], None]) -> None:
    """Run ``work`` on a screen of its own; the terminal is restored afterwards, however it ends.

    A closed terminal cannot be restored; that does not hide why the work ended.
    """
    locale.setlocale(locale.LC_ALL, "")
    curses.set_escdelay(_ESCAPE_DELAY_MS)
    if all(os.get_terminal_size(sys.stdout.fileno())):
        for stated in ("LINES", "COLUMNS"):  # exported by a shell, they would override every later size
            os.environ.pop(stated, None)
    try:
        curses.wrapper(lambda window: work(Terminal(window)))
    except curses.error as error:
        raise error.__context__ or error from None


def _shows_blocks() -> bool:
    encoding = locale.nl_langinfo(locale.CODESET).upper().replace("-", "")
    return encoding == "UTF8" and not os.environ.get("TERM", "").startswith(_WITHOUT_BLOCKS)
