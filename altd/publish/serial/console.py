"""The technician's console: keys in, what the terminal shows out; no port and no clock of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from altd.publish.serial.keys import Key, KeyReader
from altd.publish.serial.lines import BadLine, LineEditor
from altd.publish.serial.words import WIDTH, measurement_text, status_text, watch_head, watch_line
from altd.records import Measurement, Quantities
from altd.status.health import Health

PROMPT = b"> "
PAGE_LINES = 23
"""A terminal shows 24 lines; the last one is the prompt, or says that there is more."""
MORE = b"-- more: space goes on, q ends --"
WATCH_S = (0.1, 3600.0)
"""The shortest and the longest interval of ``watch``."""

_NO_KEYS = (Key.JUNK, Key.JUNK_END)
_LEAVING = {"e": "exit", "q": "quit"}
"""Commands to leave by their first letters, with which a person may have ended ``watch`` already."""


class Console:
    """One console. ``watching_s`` is the interval at which ``tick`` is due, None while nobody watches."""

    def __init__(
        self, read: Callable[[], Measurement | None], health: Health, quantities: Quantities
    ) -> None:
        self.read = read
        self.health = health
        self.quantities = quantities
        self.watching_s: float | None = None
        self.commands = 0
        """Commands that were carried out."""
        self._keys = KeyReader()
        self._editor = LineEditor()
        self._further: deque[bytes] = deque()
        """Lines of an answer that wait until the ones before were read."""
        self._swallowed = ""
        """The character that ended ``watch``."""

    @property
    def waiting_s(self) -> float | None:
        """After how much silence ``rest`` is due, for a key that has not ended; None: none is open."""
        return self._keys.waiting_s

    def greet(self) -> bytes:
        """What a person sees first."""
        serial = self.health.facts.get("serial", "of unknown serial number")
        return b"\r\n" + _on_wire(f"Active Laser Target {serial}. Type help and press Enter.") + PROMPT

    def feed(self, data: bytes) -> bytes:
        """Take what was typed; gives back the echo and the answers."""
        return b"".join(self._all(key for byte in data for key in self._keys.take(byte)))

    def rest(self) -> bytes:
        """Nothing was typed for ``waiting_s``."""
        return b"".join(self._all(self._keys.rest()))

    def tick(self) -> bytes:
        """The next line of ``watch``, nothing while nobody watches."""
        return b"" if self.watching_s is None else _on_wire(watch_line(self.read()))

    def _all(self, keys: Iterable[str | Key]) -> Iterable[bytes]:
        for key in keys:
            yield self._take(key)

    def _take(self, key: str | Key) -> bytes:
        if self.watching_s is not None:
            return self._end_watch(key)
        if self._further:
            return self._turn_page(key)
        if key is Key.REDRAW:
            return b"\r\n" + PROMPT + self._editor.shown()
        match self._editor.take(key):
            case bytes(echo):
                return echo
            case BadLine() as bad:
                return b"\r\n" + _on_wire(f"{bad.value}; type help for what there is") + PROMPT
            case line:
                return b"\r\n" + self._answer(line.split())

    def _end_watch(self, key: str | Key) -> bytes:
        if key in _NO_KEYS:
            return b""
        self.watching_s = None
        self._swallowed = key.lower() if isinstance(key, str) else ""
        return PROMPT

    def _turn_page(self, key: str | Key) -> bytes:
        """Go on with space or Enter, else end; a character but q is typed into the next line."""
        if key in _NO_KEYS:
            return b""
        cleared = b"\r" + b" " * len(MORE) + b"\r"
        if key in (" ", Key.ENTER):
            return cleared + self._next_page()
        self._further.clear()
        typed = self._take(key) if isinstance(key, str) and key not in "qQ" else b""
        return cleared + PROMPT + typed

    def _next_page(self) -> bytes:
        fits = len(self._further) <= PAGE_LINES
        page = [self._further.popleft() for _ in range(min(len(self._further), PAGE_LINES))]
        return b"".join(page) + (PROMPT if fits else MORE)

    def _answer(self, words: list[str]) -> bytes:
        swallowed, self._swallowed = self._swallowed, ""
        if not words:
            return PROMPT
        name, *arguments = words
        if (leaving := _LEAVING.get(swallowed)) == swallowed + name.lower():
            name = leaving
        command = COMMANDS.get(name.lower())
        try:
            if command is None:
                raise UsageError(f"no command {name[:24]!r}; type help for what there is")
            if len(arguments) > bool(command.argument):
                raise UsageError(f"too much after {name}; it is used as: {command.usage}")
            text = command.run(self, *arguments)
        except UsageError as error:
            return _on_wire(str(error)) + PROMPT
        self.commands += 1
        if self.watching_s is not None:
            return _on_wire(text)
        self._further.extend(_on_wire(line) for line in text.split("\n"))
        return self._next_page()


class UsageError(Exception):
    """A line that is no command, in words for the person who typed it."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command; ``argument`` is what may follow its name."""

    name: str
    argument: str
    does: str
    run: Callable[..., str]

    @property
    def usage(self) -> str:
        """The command as it is typed."""
        return f"{self.name} {self.argument}".rstrip()


def _help(_: Console) -> str:
    return "\n".join(f"{command.usage:<18}{command.does}" for command in COMMANDS.values())


def _status(console: Console, whole: str = "") -> str:
    if whole.lower() not in ("", "all"):
        raise UsageError(f"status is used as: status [all], not {whole[:24]!r}")
    return status_text(console.read(), console.health, whole=bool(whole))


def _measure(console: Console) -> str:
    return measurement_text(console.read())


def _version(console: Console) -> str:
    facts = console.health.facts
    return f"altd {facts.get('version', 'of unknown version')}, unit {facts.get('serial', 'not known')}"


def _leave(_: Console) -> str:
    return (
        "there is nothing to leave: nobody is logged in, and the unit measures on.\n"
        "Close your terminal: picocom Ctrl-A Ctrl-X, minicom Ctrl-A X, screen Ctrl-A K"
    )


def _watch(console: Console, seconds: str = "1") -> str:
    shortest, longest = WATCH_S
    try:
        interval_s = float(seconds)
    except ValueError:
        interval_s = -1.0
    if not shortest <= interval_s <= longest:
        raise UsageError(f"watch wants seconds from {shortest:g} to {longest:g}, not {seconds!r}")
    console.watching_s = interval_s
    return "\n".join(["any key ends it", watch_head(console.quantities), watch_line(console.read())])


COMMANDS = {
    command.name: command
    for command in (
        Command("help", "", "what can be typed here", _help),
        Command("status", "[all]", "how the unit is, what is wrong and what to do; all: more", _status),
        Command("measure", "", "the latest measurement with its uncertainty (1 sigma)", _measure),
        Command("watch", "[SECONDS]", "a measurement every second, or every SECONDS, until a key", _watch),
        Command("version", "", "the software's version and the unit's serial number", _version),
        Command("exit", "", "how to leave; the port has no session to end", _leave),
        Command("quit", "", "the same", _leave),
        Command("?", "", "the same as help", _help),
    )
}


def _on_wire(text: str) -> bytes:
    """Lines as terminals want them, none wider than the screen."""
    return b"".join(line[:WIDTH].encode("ascii", "replace") + b"\r\n" for line in text.split("\n"))
