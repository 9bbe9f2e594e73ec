"""Data from the event loop to the thread that writes the history: frozen, in the order of arrival."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from altd.history.columns import Column
from altd.history.summary import WorstFault
from altd.records import Measurement
from altd.status.event_log import Event, EventKind


@dataclass(frozen=True, slots=True)
class Sample:
    """A measurement, and the UTC at which it was published, µs."""

    wall_us: int
    measurement: Measurement


@dataclass(frozen=True, slots=True)
class StateSample:
    """The unit's state at this UTC, µs."""

    wall_us: int
    fault: WorstFault


@dataclass(frozen=True, slots=True)
class ClockSet:
    """The time of day was set: from here on it is ``wall_us``."""

    wall_us: int


Item = Sample | StateSample | ClockSet


@dataclass(frozen=True, slots=True)
class Batch:
    """Of about a second. ``monotonic_ns`` is when it was handed over."""

    monotonic_ns: int
    wall_us: int
    items: Sequence[Item]
    events: Sequence[Event] = ()


@dataclass(frozen=True, slots=True)
class About:
    """The columns of a history, and facts that are compared with those of the last start.

    A fact's value is text, or a JSON document whose changed keys are reported.
    """

    columns: Sequence[Column]
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that the history found out, and has written as an event."""

    kind: EventKind
    text: str
    detail: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Written:
    """The result of a batch: the other events that were written, and the size of the file's used pages."""

    notices: Sequence[Notice]
    used_bytes: int
