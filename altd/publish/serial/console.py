"""The technician's console: keys in, what the terminal shows out; no port and no clock of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from altd.publish.serial.lines import BadLine, LineEditor
from altd.publish.serial.words import WIDTH, measurement_text, status_text, watch_head, watch_line
from altd.records import Measurement
from altd.service.health import Health

PROMPT = b"> "
WATCH_S = (0.1, 3600.0)
"""The shortest and the longest interval of ``watch``."""


class Console:
    """One console. ``watching_s`` is the interval at which ``tick`` is due, None while nobody watches."""

    def __init__(self, read: Callable[[], Measurement | None], health: Health) -> None:
        self.read = read
        self.health = health
        self.watching_s: float | None = None
        self.commands = 0
        """Commands that were carried out."""
        self._editor = LineEditor()

    def greet(self) -> bytes:
        """What a person sees first."""
        serial = self.health.facts.get("serial", "of unknown serial number")
        return b"\r\n" + _on_wire(f"Active Laser Target {serial}. Type help and press Enter.") + PROMPT

    def feed(self, data: bytes) -> bytes:
        """Take what was typed; gives back the echo and the answers."""
        return b"".join(map(self._take, data))

    def tick(self) -> bytes:
        """The next line of ``watch``, nothing while nobody watches."""
        return b"" if self.watching_s is None else _on_wire(watch_line(self.read()))

    def _take(self, byte: int) -> bytes:
        if self.watching_s is not None:
            if not self._editor.discard(byte):
                return b""
            self.watching_s = None
            return PROMPT
        match self._editor.take(byte):
            case bytes(echo):
                return echo
            case BadLine() as bad:
                return b"\r\n" + _on_wire(f"{bad.value}; type help for what there is") + PROMPT
            case line:
                return b"\r\n" + self._answer(line.split())

    def _answer(self, words: list[str]) -> bytes:
        if not words:
            return PROMPT
        name, *arguments = words
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
        return _on_wire(text) + (PROMPT if self.watching_s is None else b"")


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


def _status(console: Console) -> str:
    return status_text(console.read(), console.health)


def _measure(console: Console) -> str:
    return measurement_text(console.read())


def _watch(console: Console, seconds: str = "1") -> str:
    shortest, longest = WATCH_S
    try:
        interval_s = float(seconds)
    except ValueError:
        interval_s = -1.0
    if not shortest <= interval_s <= longest:
        raise UsageError(f"watch wants seconds from {shortest:g} to {longest:g}, not {seconds!r}")
    console.watching_s = interval_s
    return "\n".join(["any key ends it", watch_head(), watch_line(console.read())])


COMMANDS = {
    command.name: command
    for command in (
        Command("help", "", "what can be typed here", _help),
        Command("status", "", "how the unit is, what is wrong and what to do", _status),
        Command("measure", "", "the latest measurement with its uncertainty (1 sigma)", _measure),
        Command("watch", "[SECONDS]", "a measurement every second, or every SECONDS, until a key", _watch),
    )
}


def _on_wire(text: str) -> bytes:
    """Lines as terminals want them, none wider than the screen."""
    return b"".join(line[:WIDTH].encode("ascii", "replace") + b"\r\n" for line in text.split("\n"))
