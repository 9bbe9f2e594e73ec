"""Components of the daemon and the unit's events: what they report, and what interfaces show of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum

from altd.ports import Clock
from altd.status.conditions import Condition
from altd.status.event_log import EventLog

MEASURING = "measuring"
"""Name of the component whose state follows the latest measurement."""

COMPUTER = "computer"
"""Name of the component that is degraded while the computer is busy."""

FIGURE_AGE_S = 2.5
"""Maximum age of a current figure, s; components observe at least every 2 s, even without data."""

Findings = Mapping[str, str]
"""Findings in words, by the target or the camera that they concern."""

Message = str | Callable[[int], str | Findings]
"""A sentence, or a function of the current monotonic ns for a sentence that contains a time, or findings."""


class State(StrEnum):
    """State of a component."""

    STARTING = "starting"
    OK = "ok"
    DEGRADED = "degraded"
    FAILED = "failed"
    ENDED = "ended"


class CameraTrouble(Enum):
    """Known trouble of a camera that loses frames or delivers none, with its remedy."""

    NOT_FOUND = "check its cable and power"
    BUSY = "end the program that uses it"
    LOST = "check its cable and supply"
    REFUSED = "check its table in the config"
    DRIVER_HANGS = "unplug it and plug it in again"
    NO_FRAMES = "check its trigger, cable and supply"
    EXPOSURE_REFUSED = "check its limits in the config"
    AUTOMATIC = Condition.CAMERA_AUTOMATIC.remedy


@dataclass(frozen=True, slots=True)
class ComponentReport:
    """Report of one component at one instant."""

    name: str
    kind: str
    state: State
    trouble: CameraTrouble | None
    for_s: float
    """Time since its state last changed, s."""
    message: str
    """Sentence that explains the state."""
    findings: Findings
    """Findings; empty if the component reports a sentence."""
    counters: Mapping[str, int]
    figures: Mapping[str, float | str | None]
    """Current figures by name; None: not known, or too old to be true now."""
    data_given: int
    """Number of data deliveries to clients."""

    @property
    def is_faulty_camera(self) -> bool:
        """Whether it is a camera that loses frames or delivers none."""
        return self.kind == "camera" and self.state not in (State.OK, State.STARTING)

    def figure(self, name: str) -> float | None:
        """Return a figure that is a number; None: not known."""
        value = self.figures.get(name)
        return value if isinstance(value, (int, float)) else None


@dataclass(slots=True)
class Component:
    """One component's state, the sentence that explains it, and its counters."""

    name: str
    clock: Clock
    state: State = State.STARTING
    trouble: CameraTrouble | None = None
    since_ns: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    heard_ns: int = 0
    """Time of the component's last report of its state or of being alive."""
    silent_after_s: float | None = None
    """Longest interval between reports of a live component; None: it reports changes only."""
    data_given: int = 0
    """Number of data deliveries to clients, requested or not; the Data lamp shows them."""
    _message: Message = ""
    _figures: dict[str, tuple[float | str | None, int]] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Kind of the component, the first word of its name: ``camera`` of ``camera front``."""
        return self.name.partition(" ")[0]

    @property
    def message(self) -> str:
        """Sentence that explains the state at this moment."""
        said = self._said
        return said if isinstance(said, str) else "; ".join(f"{of}: {found}" for of, found in said.items())

    @property
    def findings(self) -> Findings:
        """Findings at this moment; empty if the component reports a sentence."""
        said = self._said
        return {} if isinstance(said, str) else said

    @property
    def _said(self) -> str | Findings:
        return self._message if isinstance(self._message, str) else self._message(self.clock.monotonic_ns())

    def set_state(self, state: State, message: Message = "", trouble: CameraTrouble | None = None) -> None:
        """Set the state; ``since_ns`` changes only with the state."""
        self.heard_ns = self.clock.monotonic_ns()
        if state is not self.state:
            self.since_ns = self.heard_ns
        self.state = state
        self.trouble = trouble
        self._message = message

    def expect(self, silent_after_s: float) -> None:
        """Require a report at least this often from now on."""
        self.silent_after_s = silent_after_s
        self.heard_ns = self.clock.monotonic_ns()

    def is_alive(self) -> None:
        """Report that the component is alive and its state unchanged."""
        self.heard_ns = self.clock.monotonic_ns()

    def silent_s(self, now_ns: int) -> float | None:
        """Return the time since the last report if it is longer than allowed; None: it is not."""
        quiet_s = (now_ns - self.heard_ns) * 1e-9
        if self.silent_after_s is None or quiet_s <= self.silent_after_s or self.state is State.ENDED:
            return None
        return quiet_s

    def count(self, counter: str, by: int = 1) -> None:
        """Add to a counter, which starts at zero."""
        self.counters[counter] = self.counters.get(counter, 0) + by

    def observe(self, figures: Mapping[str, float | str | None]) -> None:
        """Set current figures, by names that end in the unit; None: not known.

        A non-finite number counts as not known: JSON has no NaN, and one would make all others unreadable.
        """
        now_ns = self.clock.monotonic_ns()
        self._figures |= {
            name: (None if isinstance(figure, float) and not math.isfinite(figure) else figure, now_ns)
            for name, figure in figures.items()
        }

    @property
    def figures(self) -> dict[str, float | str | None]:
        """Current figures by name; None: not known, or too old to be true now."""
        oldest_ns = self.clock.monotonic_ns() - round(FIGURE_AGE_S * 1e9)
        return {
            name: figure if at_ns >= oldest_ns else None for name, (figure, at_ns) in self._figures.items()
        }

    def gave_data(self) -> None:
        """Count a delivery of data: a response, a telegram, an event."""
        self.data_given += 1

    def report(self) -> ComponentReport:
        """Return the report of this moment."""
        return ComponentReport(
            name=self.name,
            kind=self.kind,
            state=self.state,
            trouble=self.trouble,
            for_s=(self.clock.monotonic_ns() - self.since_ns) * 1e-9,
            message=self.message,
            findings=self.findings,
            counters=dict(self.counters),
            figures=self.figures,
            data_given=self.data_given,
        )


class Health:
    """Components of one daemon, in the order in which they started, and its events."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.events = EventLog(clock)
        self._components: dict[str, Component] = {}

    def component(self, name: str) -> Component:
        """Return the component of that name; create it if it does not exist."""
        if name not in self._components:
            self._components[name] = Component(name, self.clock, since_ns=self.clock.monotonic_ns())
        return self._components[name]

    def remove(self, name: str) -> None:
        """Remove a component that is no longer in the settings."""
        self._components.pop(name, None)

    def __iter__(self) -> Iterator[Component]:
        return iter(self._components.values())


def duration(seconds: float) -> str:
    """Format a span of time in its two largest units; below 10 s in tenths."""
    minutes, hours, days = seconds / 60, seconds / 3600, seconds / 86400
    if seconds < 10:
        return f"{max(round(1e3 * seconds), 0) // 100 / 10:.1f} s"
    if minutes < 1:
        return f"{int(seconds)} s"
    if hours < 1:
        return f"{int(minutes)} min"
    if days < 1:
        return f"{int(hours)} h {int(minutes) % 60} min"
    return f"{int(days)} d {int(hours) % 24} h"
