"""Events of the unit: the newest ones, for the history and for interfaces; noting never waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum

from altd.errors import one_line
from altd.ports import Clock

MAX_EVENTS = 1000
"""Maximum number of events in memory; only the history has older ones."""

MAX_REQUEST_EVENTS = 250
"""Maximum number in memory, in addition, of the kinds that any client on the network can cause."""

MAX_OF_ONE_IN_WINDOW = 10
"""Maximum number of noted events of one kind and subject in ``WINDOW_S``; others are counted."""

MAX_IN_WINDOW = 200
"""Maximum number of noted events of all other kinds in ``WINDOW_S``."""

MAX_REQUESTS_IN_WINDOW = 50
"""Maximum number, in addition, of the kinds that any client on the network can cause."""

WINDOW_S = 60.0
MAX_TEXT_CHARACTERS = 500
_NO_TIME = datetime.fromtimestamp(0, UTC)
"""Time of events if the clock does not provide UTC, which no daemon's clock does."""


class EventKind(StrEnum):
    """A row of the table: code, default severity, meaning.

    The severity is that of the unit's signals, 0 good to 4 failure. The history drops the oldest of the least
    severe events first. Rare events that explain much therefore rank higher than their harm.
    """

    STARTED = "started", 2, "the daemon started"
    STOPPED = "stopped", 2, "the daemon was stopped"
    NOT_ENDED = "not_ended", 4, "the previous daemon ended without being stopped: a crash, or a power cut"
    STATE = "state", 0, "the unit's state changed"
    CAUSE_CAME = "cause_came", 0, "a fault began"
    CAUSE_WENT = "cause_went", 0, "a fault ended"
    CONFIG = "config", 3, "the settings have changed since the last start, were reloaded, or were refused"
    CALIBRATION = "calibration", 3, "the calibration has changed since the last start"
    VERSION = "version", 3, "the program has changed since the last start"
    SELF_CHECK = "self_check", 0, "a self-check ended"
    REQUEST = "request", 1, "a client sent a command to the unit"
    RECORDING = "recording", 1, "frames of the last seconds were recorded, or could not be"
    CLOCK = "clock", 3, "the time of day was set"
    HISTORY = "history", 1, "the history was restarted, moved aside or shortened, or has a gap"

    severity: int
    meaning: str

    def __new__(cls, code: str, severity: int, meaning: str) -> EventKind:
        """Create a member that is equal to its code."""
        kind = str.__new__(cls, code)
        kind._value_ = code
        kind.severity, kind.meaning = severity, meaning
        return kind


SHOWN_KINDS: Mapping[str, str] = {EventKind.CAUSE_CAME: "began", EventKind.CAUSE_WENT: "ended"}
"""Words on screens, where they differ from the codes."""

ASKED = frozenset({EventKind.REQUEST, EventKind.RECORDING, EventKind.SELF_CHECK})
"""Events that any client on the network can cause repeatedly. They have separate limits, here and in the
history, so that their number does not displace a state or a cause."""


@dataclass(frozen=True, slots=True)
class Event:
    """An event of the unit.

    ``number`` counts the events of this daemon from 1, ``of`` names the target, component or interface,
    ``detail`` contains plain JSON types. ``held_back`` is the number of earlier events of its kind that were
    only counted; ``is_recorded``: the history contains it already.
    """

    number: int
    t_ns: int
    time: datetime
    kind: EventKind
    severity: int
    text: str
    of: str | None = None
    detail: Mapping[str, object] = field(default_factory=dict)
    held_back: int = 0
    is_recorded: bool = False


@dataclass(slots=True)
class _Window:
    """Events of one kind and subject since ``begun_ns``; ``last`` is the newest that was held back."""

    begun_ns: int
    noted: int = 0
    held_back: int = 0
    last: Event | None = None


_Key = tuple[EventKind, str | None, object]
"""Identity of a repeated event: its kind, its subject, and the code of a cause."""


class EventLog:
    """Accepts events of one daemon, keeps the newest, and limits repeated ones.

    A toggling event is noted ``MAX_OF_ONE_IN_WINDOW`` times. When the window ends, the newest event held back
    is noted with the number of the others, so the last noted event always gives the present state.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._requests: deque[Event] = deque(maxlen=MAX_REQUEST_EVENTS)
        self._others: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._count = 0
        self._windows: dict[_Key, _Window] = {}
        self._begun_ns = clock.monotonic_ns()
        self._room: dict[bool, int] = {}
        """Remaining number of events in this window: client-caused ones (True) and the rest (False)."""
        self._make_room(self._begun_ns)

    def note(
        self,
        kind: EventKind,
        text: str,
        of: str | None = None,
        severity: int | None = None,
        detail: Mapping[str, object] | None = None,
    ) -> None:
        """Note an event that happened now; ``severity`` None: that of its kind.

        Control characters in its texts are written as escapes.
        """
        now_ns = self.clock.monotonic_ns()
        self.release(now_ns)
        event = self._event(kind, text, detail or {})
        self._limit(
            replace(
                event,
                of=None if of is None else one_line(of[:MAX_TEXT_CHARACTERS]),
                severity=kind.severity if severity is None else severity,
            )
        )

    def note_recorded(self, kind: EventKind, text: str, detail: Mapping[str, object]) -> None:
        """Note a finding of the history that it has written already."""
        self._keep(replace(self._event(kind, text, detail), is_recorded=True), _Window(0))

    def _event(self, kind: EventKind, text: str, detail: Mapping[str, object]) -> Event:
        now_ns = self.clock.monotonic_ns()
        time = self.clock.utc(now_ns) or _NO_TIME
        return Event(0, now_ns, time, kind, kind.severity, one_line(text[:MAX_TEXT_CHARACTERS]), None, detail)

    def _limit(self, event: Event) -> None:
        window = self._window_of((event.kind, event.of, event.detail.get("code")), event.t_ns)
        is_request = event.kind in ASKED
        if window.noted < MAX_OF_ONE_IN_WINDOW and self._room[is_request]:
            window.noted += 1
            self._room[is_request] -= 1
            self._keep(event, window)
        else:
            window.held_back += 1
            window.last = event

    def release(self, now_ns: int) -> None:
        """Note held-back events whose window has ended; call regularly, so that the last one is noted."""
        if now_ns - self._begun_ns >= WINDOW_S * 1e9:
            self._make_room(now_ns)
        for key, window in list(self._windows.items()):
            if now_ns - window.begun_ns < WINDOW_S * 1e9:
                continue
            if window.last is None:
                del self._windows[key]
                continue
            last, window.last = window.last, None
            window.held_back -= 1
            window.begun_ns, window.noted = now_ns, 1
            self._keep(last, window)

    @property
    def count(self) -> int:
        """Number of events noted so far."""
        return self._count

    def after(self, number: int) -> list[Event]:
        """Return the events with a larger number that are still in memory, oldest first."""
        if number >= self._count:
            return []
        events = sorted((*self._requests, *self._others), key=lambda event: event.number)
        return [event for event in events if event.number > number]

    def _make_room(self, now_ns: int) -> None:
        self._begun_ns = now_ns
        self._room = {True: MAX_REQUESTS_IN_WINDOW, False: MAX_IN_WINDOW}

    def _window_of(self, key: _Key, now_ns: int) -> _Window:
        if key not in self._windows:
            is_request = key[0] in ASKED
            alike = sum((kind in ASKED) is is_request for kind, _, _ in self._windows)
            if alike >= (MAX_REQUESTS_IN_WINDOW if is_request else MAX_IN_WINDOW):
                key = (key[0], None, None)  # limits the memory if names never repeat
        return self._windows.setdefault(key, _Window(now_ns))

    def _keep(self, event: Event, window: _Window) -> None:
        self._count += 1
        held_back, window.held_back = window.held_back, 0
        events = self._requests if event.kind in ASKED else self._others
        events.append(replace(event, number=self._count, held_back=held_back))
