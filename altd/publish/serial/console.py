"""The technician's console: converts keys to terminal output; it has no port and no clock of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterable

from altd.publish.serial.commands import Later, Question, Sources, UsageError, Watch, answer_to
from altd.publish.serial.keys import Key, KeyReader
from altd.publish.serial.lines import BadLine, LineEditor
from altd.publish.serial.parts_text import Past
from altd.publish.serial.words import WIDTH, watch_line
from altd.status.unit import PublishedUnit

PROMPT = b"> "
PAGE_LINES = 23
"""Lines of a page: a terminal shows 24 lines; the last one is the prompt, or reports that there is more."""
MORE_PROMPT = b"-- more: space, end: q --"
QUESTION_PROMPT = b" (y: yes) "
QUESTION_S = 10.0
"""Time after which an unanswered question is answered with no."""

_NO_KEYS = (Key.JUNK, Key.JUNK_END)
_LEAVING = {"e": "exit", "q": "quit"}
"""Commands to leave, by their first letters, with which a person may already have ended ``watch``."""


class Console:
    """One console.

    ``watching_s`` is the interval at which ``tick`` is due, None without ``watch``; ``asking_s`` is the time
    after a question at which ``drop_question`` is due, None while no question is open.
    """

    def __init__(
        self,
        unit: PublishedUnit,
        past: Past | None = None,
    ) -> None:
        self.unit = unit
        self._sources = Sources(unit, past)
        self._question: Question | None = None
        self._find: Callable[[], Awaitable[str]] | None = None
        self.watching_s: float | None = None
        self.commands = 0
        """Number of commands that were carried out."""
        self._keys = KeyReader()
        self._editor = LineEditor()
        self._further: deque[bytes] = deque()
        """Lines of an answer that wait until the previous ones were read."""
        self._swallowed = ""
        """The character that ended ``watch``."""

    @property
    def waiting_s(self) -> float | None:
        """Time of silence until ``rest`` is due, for an incomplete key; None: no key is open."""
        return self._keys.waiting_s

    @property
    def asking_s(self) -> float | None:
        """Time until an open question is answered with no; None: no question is open."""
        return None if self._question is None else QUESTION_S

    @property
    def is_finding(self) -> bool:
        """Whether ``found`` is due before anything else is typed."""
        return self._find is not None

    async def found(self) -> bytes:
        """Return the answer to a command that had to look it up."""
        find, self._find = self._find, None
        return b"" if find is None else self._paged(await find())

    def drop_question(self) -> bytes:
        """End an open question that was not answered."""
        return b"" if self._question is None else self._reply(None)

    def welcome(self) -> bytes:
        """The welcome message and the first prompt."""
        facts = self.unit.facts
        serial = facts.serial or "of unknown serial number"
        return b"\r\n" + _on_wire(f"{facts.product} {serial}. Type help and press Enter.") + PROMPT

    def feed(self, data: bytes) -> bytes:
        """Process typed bytes; return the echo and the answers."""
        return b"".join(self._all(key for byte in data for key in self._keys.take(byte)))

    def rest(self) -> bytes:
        """Complete an open key after ``waiting_s`` without input."""
        return b"".join(self._all(self._keys.rest()))

    def tick(self) -> bytes:
        """Return the next line of ``watch``; empty without ``watch``."""
        return b"" if self.watching_s is None else _on_wire(watch_line(self.unit.board.read()))

    def _all(self, keys: Iterable[str | Key]) -> Iterable[bytes]:
        for key in keys:
            yield self._take(key)

    def _take(self, key: str | Key) -> bytes:
        if self.watching_s is not None:
            return self._end_watch(key)
        if self._question is not None:
            return self._reply(key)
        if self._further:
            return self._turn_page(key)
        if key is Key.REDRAW:
            return b"\r\n" + PROMPT + self._editor.shown()
        match self._editor.take(key):
            case bytes(echo):
                return echo
            case BadLine() as bad:
                return b"\r\n" + _on_wire(f"{bad.value}; type help for the commands") + PROMPT
            case line:
                return b"\r\n" + self._answer(line.split())

    def _end_watch(self, key: str | Key) -> bytes:
        if key in _NO_KEYS:
            return b""
        self.watching_s = None
        self._swallowed = key.lower() if isinstance(key, str) else ""
        return PROMPT

    def _reply(self, key: str | Key | None) -> bytes:
        """Do what was asked after a ``y``, and nothing after any other key or noise.

        A character other than ``y`` and ``n`` is typed into the next line.
        """
        question, self._question = self._question, None
        assert question is not None  # noqa: S101  asked before
        if key in ("y", "Y"):
            self.commands += 1
            answer = question.do()
            if isinstance(answer, Later):
                self._find = answer.find
                return b"yes\r\n" + _on_wire("checking: up to ten seconds")
            return b"yes\r\n" + _on_wire(answer) + PROMPT
        typed = self._take(key) if isinstance(key, str) and key not in "nN" else b""
        return b"no\r\n" + PROMPT + typed

    def _turn_page(self, key: str | Key) -> bytes:
        """Continue with space or Enter, else end; a character other than q is typed into the next line."""
        if key in _NO_KEYS:
            return b""
        cleared = b"\r" + b" " * len(MORE_PROMPT) + b"\r"
        if key in (" ", Key.ENTER):
            return cleared + self._next_page()
        self._further.clear()
        typed = self._take(key) if isinstance(key, str) and key not in "qQ" else b""
        return cleared + PROMPT + typed

    def _next_page(self) -> bytes:
        fits = len(self._further) <= PAGE_LINES
        page = [self._further.popleft() for _ in range(min(len(self._further), PAGE_LINES))]
        return b"".join(page) + (PROMPT if fits else MORE_PROMPT)

    def _answer(self, words: list[str]) -> bytes:
        swallowed, self._swallowed = self._swallowed, ""
        if not words:
            return PROMPT
        name, *arguments = words
        if (leaving := _LEAVING.get(swallowed)) == swallowed + name.lower():
            name = leaving
        try:
            answer = answer_to(self._sources, name, arguments)
        except UsageError as error:
            return _on_wire(str(error)) + PROMPT
        if isinstance(answer, Question):
            self._question = answer
            return _on_wire(answer.text).removesuffix(b"\r\n") + QUESTION_PROMPT
        self.commands += 1
        if isinstance(answer, Watch):
            self.watching_s = answer.interval_s
            return _on_wire(answer.text)
        if isinstance(answer, Later):
            self._find = answer.find
            return b""
        return self._paged(answer)

    def _paged(self, text: str) -> bytes:
        self._further.extend(_on_wire(line) for line in text.split("\n"))
        return self._next_page()


def _on_wire(text: str) -> bytes:
    """Lines as terminals require them, cut to the screen's width, without control characters."""
    return b"".join(_plain(line[:WIDTH]) + b"\r\n" for line in text.split("\n"))


def _plain(line: str) -> bytes:
    shown = (letter if letter.isascii() and letter.isprintable() else "?" for letter in line)
    return "".join(shown).encode("ascii")
