"""What each component says of itself, for the technician and for the status pages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from altd.ports import Clock


class State(StrEnum):
    """How a component does."""

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
    message: str = ""
    since_ns: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    figures: dict[str, float | str] = field(default_factory=dict)
    """What it measures of itself, by names that end in the unit; replaced, not added up."""
    data_given: int = 0
    """How often it gave data to whoever asked, or wants it unasked: what the Data lamp shows."""

    def say(self, state: State, message: str = "") -> None:
        """Set the state; ``since_ns`` moves only when the state changes."""
        if state is not self.state:
            self.since_ns = self.clock.monotonic_ns()
        self.state = state
        self.message = message

    def count(self, counter: str, by: int = 1) -> None:
        """Add to a counter, which starts at zero."""
        self.counters[counter] = self.counters.get(counter, 0) + by

    def gave_data(self) -> None:
        """Data went out: an answer, a telegram, an event."""
        self.data_given += 1


class Health:
    """The components of one daemon, in the order in which they came up."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._components: dict[str, Component] = {}
        self.facts: dict[str, str] = {}
        """What does not change while the daemon runs: serial, version, calibration."""

    def component(self, name: str) -> Component:
        """The component of that name, new when it is not known yet."""
        if name not in self._components:
            self._components[name] = Component(name, self._clock, since_ns=self._clock.monotonic_ns())
        return self._components[name]

    def __iter__(self) -> Iterator[Component]:
        return iter(self._components.values())

    def as_object(self) -> Mapping[str, object]:
        """All of it as plain JSON types."""
        now_ns = self._clock.monotonic_ns()
        return {
            **self.facts,
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
