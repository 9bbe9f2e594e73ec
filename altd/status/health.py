"""The reports of the components, for the technician and for the status pages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from altd.ports import Clock
from altd.status.cause import StateReport
from altd.status.event_log import EventLog
from altd.status.services import CalibrationService, PictureService, RecordingService, SelfCheckService
from altd.status.target_area import TargetArea
from altd.status.zero import Zero


@dataclass(frozen=True, slots=True)
class DiagnosticPart:
    """``name`` is the file's, ``meaning`` says in a few words what it is.

    ``make`` gives its content, in a thread; whatever it raises costs this part only.
    """

    name: str
    meaning: str
    make: Callable[[], bytes]


MEASURING = "measuring"
"""The component that does as the latest measurement does."""

FIGURE_AGE_S = 2.5
"""A figure is current for so long after it was observed; silence itself is observed at least every 2 s."""

Message = str | Callable[[int], str]
"""A sentence; one that holds a time is made again when it is read, from the monotonic ns of that moment."""


class State(StrEnum):
    """The condition of a component."""

    STARTING = "starting"
    OK = "ok"
    DEGRADED = "degraded"
    FAILED = "failed"
    ENDED = "ended"


@dataclass(slots=True)
class Component:
    """One component's state, the sentence that explains it, and its counters."""

    name: str
    clock: Clock
    state: State = State.STARTING
    since_ns: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    heard_ns: int = 0
    """Time of the component's last report of its state or of being alive."""
    silent_after_s: float | None = None
    """Longest interval between reports of a live component; None: it reports changes only."""
    data_given: int = 0
    """Deliveries of data to clients, on request or unasked, counted: what the Data lamp shows."""
    _message: Message = ""
    _figures: dict[str, tuple[float | str | None, int]] = field(default_factory=dict)

    @property
    def message(self) -> str:
        """The sentence that explains the state, true at this moment."""
        return self._message if isinstance(self._message, str) else self._message(self.clock.monotonic_ns())

    def set_state(self, state: State, message: Message = "") -> None:
        """Set the state; ``since_ns`` moves only when the state changes."""
        self.heard_ns = self.clock.monotonic_ns()
        if state is not self.state:
            self.since_ns = self.heard_ns
        self.state = state
        self._message = message

    def expect(self, silent_after_s: float) -> None:
        """From now on it is to be heard of at least so often."""
        self.silent_after_s = silent_after_s
        self.heard_ns = self.clock.monotonic_ns()

    def is_alive(self) -> None:
        """Report that the component is alive and its state unchanged."""
        self.heard_ns = self.clock.monotonic_ns()

    def silent_s(self, now_ns: int) -> float | None:
        """For how long nothing was heard of it, where that is longer than it should be; None: it is not."""
        quiet_s = (now_ns - self.heard_ns) * 1e-9
        if self.silent_after_s is None or quiet_s <= self.silent_after_s or self.state is State.ENDED:
            return None
        return quiet_s

    def count(self, counter: str, by: int = 1) -> None:
        """Add to a counter, which starts at zero."""
        self.counters[counter] = self.counters.get(counter, 0) + by

    def observe(self, figures: Mapping[str, float | str | None]) -> None:
        """Its current figures, by names that end in the unit; None: not known.

        A number that is none counts as not known: JSON has no NaN, and one would hide all the others.
        """
        now_ns = self.clock.monotonic_ns()
        self._figures |= {
            name: (None if isinstance(figure, float) and not math.isfinite(figure) else figure, now_ns)
            for name, figure in figures.items()
        }

    @property
    def figures(self) -> dict[str, float | str | None]:
        """Its figure; None: not known, or observed too long ago to be true now."""
        oldest_ns = self.clock.monotonic_ns() - round(FIGURE_AGE_S * 1e9)
        return {
            name: figure if at_ns >= oldest_ns else None for name, (figure, at_ns) in self._figures.items()
        }

    def gave_data(self) -> None:
        """Data went out: an answer, a telegram, an event."""
        self.data_given += 1


class Health:
    """The components of one daemon, in the order in which they came up."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._components: dict[str, Component] = {}
        self.facts: dict[str, str] = {}
        """Constants while the daemon runs: serial, version, calibration."""
        self.targets: tuple[TargetArea, ...] = ()
        """In beam order."""
        self.events = EventLog(clock)
        self.self_check = SelfCheckService(self.events)
        self.zero = Zero(self.events)
        self.recordings = RecordingService("this unit keeps no frames")
        self.pictures = PictureService("this unit shows no pictures")
        self.calibration = CalibrationService()
        self.diagnostics: tuple[DiagnosticPart, ...] = ()
        """Contents of the diagnostics beyond what every interface shows."""
        self.state: Callable[[], StateReport | None] = lambda: None
        """The unit's state at this moment; None: it is not determined."""

    def component(self, name: str) -> Component:
        """The component of that name, new when it is not known yet."""
        if name not in self._components:
            self._components[name] = Component(name, self.clock, since_ns=self.clock.monotonic_ns())
        return self._components[name]

    def remove(self, name: str) -> None:
        """Forget a component that the settings have no more."""
        self._components.pop(name, None)

    def __iter__(self) -> Iterator[Component]:
        return iter(self._components.values())

    def as_object(self) -> Mapping[str, object]:
        """All of it as plain JSON types."""
        now_ns = self.clock.monotonic_ns()
        report = self.state()
        found = (
            {}
            if report is None
            else {"state": report.as_object(), "availability": report.availability.as_object()}
        )
        return {
            **self.facts,
            **found,
            "components": {
                component.name: {
                    "state": str(component.state),
                    "message": component.message,
                    "for_s": round((now_ns - component.since_ns) * 1e-9, 1),
                    **component.figures,
                    **component.counters,
                }
                for component in self
            },
        }


def duration(seconds: float) -> str:
    """A span of time in its two largest units; below 10 s in tenths."""
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
