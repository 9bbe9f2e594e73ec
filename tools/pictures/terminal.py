"""Run a program in a real terminal (tmux), read its screen and send keys to it."""

import contextlib
import re
import secrets
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

_SGR = re.compile(r"\x1b\[([0-9;]*)m")
"""Control sequence SGR, select graphic rendition (ECMA-48, 8.3.117)."""


@dataclass(frozen=True, slots=True)
class Run:
    """Characters of the same style, starting at a column; ``style`` holds the parameters of SGR."""

    column: int
    text: str
    style: frozenset[str]


Screen = tuple[tuple[Run, ...], ...]
"""Lines of a screen."""


class Terminal:
    """A terminal that runs a program."""

    def __init__(self, socket: str) -> None:
        self._socket = socket

    def press(self, key: str) -> None:
        """Type one key."""
        self._tmux("send-keys", key)

    def resize(self, columns: int, rows: int) -> None:
        """Set the size of the terminal."""
        self._tmux("resize-window", "-x", str(columns), "-y", str(rows))

    def text(self) -> str:
        """Current text on the screen."""
        return self._tmux("capture-pane", "-p")

    def screen(self) -> Screen:
        """Current text on the screen with its styles."""
        return parse_screen(self._tmux("capture-pane", "-p", "-e"))

    def await_text(self, wanted: str, timeout_s: float) -> None:
        """Wait until the screen shows ``wanted``; raises TimeoutError with the text shown instead."""
        deadline_s = time.monotonic() + timeout_s
        while wanted not in (shown := self.text()):
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{wanted!r} is not on the screen:\n{shown}")
            time.sleep(0.05)

    def _tmux(self, *command: str) -> str:
        return tmux(self._socket, *command)


def tmux(socket: str, *command: str) -> str:
    """Send a command to the tmux server of a socket name; raises CalledProcessError."""
    whole = ["tmux", "-L", socket, "-f", "/dev/null", *command]
    return subprocess.run(whole, check=True, capture_output=True, text=True).stdout  # noqa: S603


@contextlib.contextmanager
def terminal(command: str, columns: int, rows: int) -> Iterator[Terminal]:
    """Run a program in a new terminal, which is closed at the end."""
    socket = f"altd-{secrets.token_hex(4)}"
    tmux(socket, "new-session", "-d", "-x", str(columns), "-y", str(rows), command)
    try:
        yield Terminal(socket)
    finally:
        with contextlib.suppress(
            subprocess.CalledProcessError
        ):  # the program has ended, and the server with it
            tmux(socket, "kill-server")


def parse_screen(text: str) -> Screen:
    """Parse lines of text that contain no control sequences other than SGR."""
    lines, style = [], frozenset[str]()
    for line in text.split("\n"):
        runs, style = _runs(line, style)
        lines.append(runs)
    return tuple(lines)


def _runs(line: str, style: frozenset[str]) -> tuple[tuple[Run, ...], frozenset[str]]:
    """Runs of a line, and the style at the start of the next line."""
    runs, column, at = [], 0, 0
    for match in [*_SGR.finditer(line), None]:
        text = line[at : match.start() if match else len(line)]
        if text.strip():
            indent = len(text) - len(text.lstrip())
            runs.append(Run(column + indent, text.strip(), style))
        column += len(text)
        if match:
            style = _styled(style, match[1].split(";"))
            at = match.end()
    return tuple(runs), style


def _styled(style: frozenset[str], parameters: Sequence[str]) -> frozenset[str]:
    for parameter in parameters:
        style = frozenset() if parameter in ("", "0") else style | {parameter}
        if parameter == "39":  # default colour
            style = frozenset(each for each in style if not each.startswith("3"))
        if parameter == "22":  # neither bold nor dim
            style -= {"1", "2", "22"}
    return style
