"""Records of a history: what it gives, and what its writer is handed; times are UTC, µs since 1970."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from altd.history.columns import Column
from altd.history.summary import WorstFault
from altd.records import Measurement, Value
from altd.status.event_log import Event, EventKind


@dataclass(frozen=True, slots=True)
class StoredMeasurement:
    """A measurement as it was published; what was not known is absent.

    ``id`` grows over restarts and is never given twice in one file. ``values`` and ``sigmas`` are by the keys
    of quantities, those of a target as ``TARGET.KEY``; ``randoms`` are the parts of ``sigmas`` that scatter.
    ``t_ns`` is the monotonic time of its daemon.
    """

    id: int
    epoch: int
    t_us: int
    sequence: int
    t_ns: int
    frames: int
    valid: bool
    status: tuple[str, ...]
    values: Mapping[str, float]
    sigmas: Mapping[str, float]
    randoms: Mapping[str, float]

    def known(self, key: str) -> Value | None:
        """A quantity of the unit, or ``TARGET.KEY``; None: not known."""
        value = self.values.get(key)
        return None if value is None else Value(value, self.sigmas.get(key), self.randoms.get(key))


@dataclass(frozen=True, slots=True)
class SummaryValue:
    """A quantity over a span: mean and lowest and highest of the valid measurements, and their sigma.

    ``sigma`` is the standard deviation of one measurement (the root of their mean variance); None: not known.
    """

    mean: float
    sigma: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class SummaryPoint:
    """A span of time that begins at ``t_us``.

    ``n`` measurements were made in it, ``n_valid`` of them valid. ``worst`` is the severity (0 good to 4
    failure) of the unit's state, ``worst_code`` its cause; ``lost_to`` is the worst reason of those that were
    not valid. Both codes are empty where there is none. A quantity that was not known is absent.
    """

    t_us: int
    span_us: int
    n: int
    n_valid: int
    worst: int
    worst_code: str
    lost_to: str
    values: Mapping[str, SummaryValue]


@dataclass(frozen=True, slots=True)
class Trend:
    """Points in the order of time; spans in which no daemon ran have none. ``source`` is the table read."""

    source: str
    span_us: int
    points: tuple[SummaryPoint, ...]


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """An event; ``id`` grows over restarts and is never given twice in one file."""

    id: int
    epoch: int
    t_us: int
    severity: int
    kind: str
    of: str | None
    text: str
    detail: Mapping[str, object]
    held_back: int


@dataclass(frozen=True, slots=True)
class OutboxMark:
    """The outbox after a batch was written.

    ``file`` identifies the file, ``stream`` one opening of it: sequences up to ``complete`` will not change.
    ``oldest`` is the first that is still there. ``dropped`` were deleted before they were acknowledged, since
    the file was begun.
    """

    file: str
    stream: str
    oldest: int
    complete: int
    dropped: int

    @property
    def waiting(self) -> int:
        """Complete seconds that are not acknowledged."""
        return self.complete - self.oldest + 1


@dataclass(frozen=True, slots=True)
class QueuedSecond:
    """A summary of 1 s in the outbox, under its sequence."""

    sequence: int
    epoch: int
    point: SummaryPoint


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
    """Of about a second. ``monotonic_ns`` is when it was handed over.

    ``acknowledged``: a stream of the outbox, and the sequence up to which an ingest has it.
    """

    monotonic_ns: int
    wall_us: int
    items: Sequence[Item]
    events: Sequence[Event] = ()
    acknowledged: tuple[str, int] | None = None


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
    """The result of a batch: the other events that were written, and the size of the file's used pages.

    ``outbox`` is None where there is none.
    """

    notices: Sequence[Notice]
    used_bytes: int
    outbox: OutboxMark | None = None
