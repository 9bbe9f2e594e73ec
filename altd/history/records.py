"""Records that a history returns and records that its writer receives; times are UTC, µs since 1970."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from altd.history.columns import StoredColumn
from altd.history.summary import WorstFault
from altd.records import Measurement, Value
from altd.status.event_log import Event, EventKind


@dataclass(frozen=True, slots=True)
class StoredMeasurement:
    """A measurement as it was published; values that were not known are absent.

    ``id`` increases across restarts and is never reused in one file. ``values`` and ``sigmas`` are by the
    keys of quantities, those of a target as ``TARGET.KEY``; ``randoms`` are the random parts of ``sigmas``.
    ``values`` also has the correlations (``correlations_of``). ``t_ns`` is the monotonic time of its daemon.
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
        """Return a quantity of the unit or of ``TARGET.KEY``; None: not known."""
        value = self.values.get(key)
        return None if value is None else Value(value, self.sigmas.get(key), self.randoms.get(key))


@dataclass(frozen=True, slots=True)
class SummaryValue:
    """A quantity over a span: mean, lowest and highest of the valid measurements, and their sigma.

    ``sigma`` is the standard deviation of one measurement (the root of their mean variance); None: not known.
    """

    mean: float
    sigma: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class SummaryPoint:
    """Summary of a span of time that begins at ``t_us``.

    ``n`` measurements were made in it, ``n_valid`` of them valid. ``worst`` is the severity (0 good to 4
    failure) of the unit's state, ``worst_code`` its cause; ``lost_to`` is the worst reason of the invalid
    measurements. Both codes are empty if there is none. A quantity that was not known is absent. Of a
    single row, ``epoch`` is that of the clock.
    """

    t_us: int
    span_us: int
    n: int
    n_valid: int
    worst: int
    worst_code: str
    lost_to: str
    values: Mapping[str, SummaryValue]
    epoch: int = 0


@dataclass(frozen=True, slots=True)
class Trend:
    """Points in the order of time; none for spans without a running daemon. ``source``: the table read."""

    source: str
    span_us: int
    points: tuple[SummaryPoint, ...]


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """An event; ``id`` increases across restarts and is never reused in one file."""

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
    """State of the outbox after a batch was written.

    ``file`` identifies the file, ``stream`` one opening of it: sequences up to ``complete`` will not change.
    ``oldest`` is the first sequence still in it. ``dropped`` counts the seconds deleted before they were
    acknowledged, since the file was created.
    """

    file: str
    stream: str
    oldest: int
    complete: int
    dropped: int

    @property
    def waiting(self) -> int:
        """Number of complete seconds that are not acknowledged."""
        return self.complete - self.oldest + 1


@dataclass(frozen=True, slots=True)
class QueuedSecond:
    """A summary of 1 s in the outbox, with its sequence."""

    sequence: int
    epoch: int
    point: SummaryPoint


@dataclass(frozen=True, slots=True)
class Sample:
    """A measurement and the UTC at which it was published, µs."""

    wall_us: int
    measurement: Measurement


@dataclass(frozen=True, slots=True)
class StateSample:
    """State of the unit at this UTC, µs."""

    wall_us: int
    fault: WorstFault


@dataclass(frozen=True, slots=True)
class ClockSet:
    """The time of day was set; it is ``wall_us`` from here on."""

    wall_us: int


Item = Sample | StateSample | ClockSet


@dataclass(frozen=True, slots=True)
class Batch:
    """Items of about one second. ``monotonic_ns`` is the time at which the batch was handed over.

    ``acknowledged``: a stream of the outbox, and the sequence up to which an ingest has stored it.
    """

    monotonic_ns: int
    wall_us: int
    items: Sequence[Item]
    events: Sequence[Event] = ()
    acknowledged: tuple[str, int] | None = None


@dataclass(frozen=True, slots=True)
class About:
    """Columns of a history, and facts that are compared with those of the last start.

    A fact's value is text, or a JSON document whose changed keys are reported.
    """

    columns: Sequence[StoredColumn]
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Notice:
    """A finding of the history itself, which it has written as an event."""

    kind: EventKind
    text: str
    detail: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Written:
    """The result of a batch: the history's own events and the size of the file's used pages.

    ``outbox`` is None if there is none. ``complaint``: what failed after the batch was written, or
    empty.
    """

    notices: Sequence[Notice]
    used_bytes: int
    outbox: OutboxMark | None = None
    complaint: str = ""
