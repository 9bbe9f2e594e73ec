"""Histories for tests: a clock whose time of day can be set, measurements of a known beam, a store."""

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from altd.history.columns import columns_of
from altd.history.reader import Reader
from altd.history.records import About, Batch, Item, Sample, StateSample
from altd.history.store import Store
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.solver import Beam
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.event_log import Event, EventKind
from support.clock import FakeClock
from support.measurements import POINTS_MM, measured

ABOUT = About(columns_of(QUANTITIES, ("front", "rear")), {"serial": "TEST-1", "version": "1"})
START_S = 1_795_161_600
"""2026-11-20T08:00:00Z."""
US = 10**6
MAX_BYTES = 400 * 10**6


class WallClock(FakeClock):
    """A clock whose time of day is set while the monotonic one continues."""

    def __init__(self, now_ns: int = 0) -> None:
        super().__init__(now_ns)
        self.offset_s = 0.0

    def utc(self, t_ns: int) -> datetime:
        return super().utc(t_ns) + timedelta(seconds=self.offset_s)


def beam(x_mm: float) -> Beam:
    return Beam(x_mm, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)


def at(t_s: float, x_mm: float | None = 10.0, sequence: int = 1, *reasons: Reason) -> Measurement:
    """A measurement at that second of UTC; None: an invalid one, without a spot unless reasons are given."""
    status = tuple(Fault(reason, "front" if x_mm is None else None) for reason in reasons)
    if x_mm is None and not reasons:
        status = (Fault(Reason.SPOT_MISSING, "front"),)
    return measured(
        None if x_mm is None else beam(x_mm),
        dict.fromkeys(POINTS_MM) if x_mm is None else POINTS_MM,
        sequence=sequence,
        t_ns=round((t_s - START_S) * 1e9) + 10**12,
        time=datetime.fromtimestamp(t_s, UTC),
        frames=0 if x_mm is None else 20,
        status=status,
    )


def sample(t_s: float, x_mm: float | None = 10.0, sequence: int = 1, *reasons: Reason) -> Sample:
    """The same, published half a second after the middle of its window."""
    return Sample(round((t_s + 0.5) * US), at(t_s, x_mm, sequence, *reasons))


def state(t_s: float, severity: int = 0, code: str = "") -> StateSample:
    return StateSample(round(t_s * US), (severity, code))


def batch(t_s: float, items: Sequence[Item] = (), events: Sequence[Event] = ()) -> Batch:
    return Batch(round((t_s - START_S) * 1e9) + 10**12, round(t_s * US), items, events)


def event(
    number: int, t_s: float, kind: EventKind = EventKind.STATE, severity: int = 0, text: str = "t"
) -> Event:
    return Event(number, 0, datetime.fromtimestamp(t_s, UTC), kind, severity, text)


def store(folder: Path, about: About = ABOUT, max_bytes: int = MAX_BYTES) -> Store:
    return Store(folder / "history.db", max_bytes, about)


def write_seconds(into: Store, first_s: int, xs_mm: Iterable[float | None], rate: int = 20) -> None:
    """One batch a second: ``rate`` measurements with the same x in each, None: invalid."""
    for number, x_mm in enumerate(xs_mm):
        t_s = first_s + number
        severity, cause = (0, "") if x_mm is not None else (2, "spot_missing")
        items: list[Item] = [state(t_s, severity, cause)]
        items += [sample(t_s + n / rate, x_mm, number * rate + n) for n in range(rate)]
        into.write(batch(t_s + 1.6, items))


def record_seconds(folder: Path, first_s: int, xs_mm: Iterable[float | None], rate: int = 20) -> None:
    """A history of these seconds by a daemon that ended as by a kill."""
    writing = store(folder)
    write_seconds(writing, first_s, xs_mm, rate)
    writing.end(None)


@contextmanager
def recorded(folder: Path, *batches: Batch, about: About = ABOUT) -> Iterator[Reader]:
    """The same of these batches, read."""
    writing = store(folder, about)
    for each in batches:
        writing.write(each)
    writing.end(None)
    with Reader(folder / "history.db") as reader:
        yield reader


def forge(path: Path, *statements: str) -> None:
    """Change a file as another program does."""
    with closing(sqlite3.connect(path)) as foreign, foreign:
        for statement in statements:
            foreign.execute(statement)


def renamed(about: About, **facts: str) -> About:
    return replace(about, facts={**about.facts, **facts})
