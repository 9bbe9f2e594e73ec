"""The event loop's side of the history: accepts items without waiting, writes about once a second."""

from __future__ import annotations

import asyncio
import logging
import sqlite3
from collections import deque
from collections.abc import Callable

from altd.history.outbox import Outbox
from altd.history.records import Batch, ClockSet, Item, Sample, StateSample, Written
from altd.history.schema import MovedFileError, UnusableFileError
from altd.history.store import Store
from altd.history.summary import WorstFault
from altd.ports import Clock
from altd.reasons import Reason
from altd.records import Measurement
from altd.runtime.threads import NO_LIMIT_S, DeviceThread
from altd.status.cause import StateReport
from altd.status.event_log import EventKind, EventLog
from altd.status.health import Component, State, duration

log = logging.getLogger("altd")

WRITE_INTERVAL_S = 0.8
"""Interval between batches; with the disk's time, a crash or a power cut loses less than a second."""

MAX_WAITING_ITEMS = 4096
"""Maximum number of waiting items, 3 min at 20 measurements per second; then the oldest is dropped and
counted."""

CLOCK_STEP_US = 500_000
"""Difference between the time of day and the monotonic clock, µs, above which the clock counts as set."""

SLOW_S = 3.0
_MAX_BACKOFF_S = 10.0
_END_TIMEOUT_S = 2.0


class HistoryRecorder:
    """Records one daemon's measurements, events and states. ``read_state`` is called once per batch."""

    def __init__(
        self,
        store: Store,
        events: EventLog,
        read_state: Callable[[], StateReport],
        component: Component,
        clock: Clock,
        outbox: Outbox | None = None,
    ) -> None:
        self._store = store
        self._outbox = outbox
        self._log = events
        self._read_state = read_state
        self._component = component
        self._clock = clock
        self._items: deque[Item] = deque()
        self._events_written = 0
        self._events_taken = 0
        self._events_lost = 0
        self._offset_us: int | None = None
        self._writing: asyncio.Task[Written] | None = None
        self._written: Batch | None = None
        self._begun_ns = 0
        self._retry_ns = 0
        self._backoff_s = WRITE_INTERVAL_S
        self._thread: DeviceThread | None = None
        component.set_state(State.STARTING, f"opens {store.path}")

    def take(self, measurement: Measurement) -> None:
        """Record a measurement that was published."""
        self._add(Sample(self._wall_us(), measurement))

    async def run(self) -> None:
        """Record until cancelled; then write the waiting items if the disk accepts them within 2 s."""
        self._thread = DeviceThread("history")
        try:
            while True:
                try:
                    self.step()  # at once: opening a file takes time, and new measurements wait
                except Exception as error:  # a defect here must not stop the measurement
                    log.exception("history: a defect")
                    self._report_fault(f"a defect: {type(error).__name__}: {error}")
                await self._clock.sleep(WRITE_INTERVAL_S)
        finally:
            await self._end(self._thread)

    def step(self) -> None:
        """Record the state, and write the waiting items unless the disk is busy with the previous batch."""
        self._add(StateSample(self._wall_us(), _worst_fault(self._read_state())))
        if self._writing is not None and not self._settle(self._writing):
            return
        now_ns = self._clock.monotonic_ns()
        if now_ns >= self._retry_ns and self._thread is not None:
            batch = self._written = self._next_batch(now_ns)
            self._begun_ns = now_ns
            call = self._thread.call(self._store.write, batch, within_s=NO_LIMIT_S)
            self._writing = asyncio.create_task(call, name="history's disk")

    def _settle(self, writing: asyncio.Task[Written]) -> bool:
        """Whether the disk is done with a batch, written or not; items that were not written wait again."""
        now_ns = self._clock.monotonic_ns()
        took_s = (now_ns - self._begun_ns) * 1e-9
        if not writing.done():
            if took_s >= SLOW_S:
                self._report_fault(
                    f"the disk has not answered for {duration(took_s)}", f"the disk is slow: {took_s:.0f} s"
                )
            return False
        batch, self._writing, self._written = self._written, None, None
        try:
            written = writing.result()
        except (OSError, sqlite3.Error, UnusableFileError) as error:
            self._put_back(batch)
            self._retry_ns = now_ns + round(self._backoff_s * 1e9)
            self._backoff_s = min(2 * self._backoff_s, _MAX_BACKOFF_S)
            what = "" if isinstance(error, MovedFileError) else "not written: "
            self._report_fault(f"{what}{self._store.path}: {_sentence(error)}")
            return True
        except Exception as error:  # a defect here must not stop the measurement
            log.exception("history: a defect")
            if batch is not None:
                self._count_lost(batch)
            self._events_written = self._events_taken
            self._retry_ns = now_ns + round(_MAX_BACKOFF_S * 1e9)
            self._report_fault(f"a defect: {type(error).__name__}: {error}")
            return True
        finally:
            del writing, batch  # an error raised in it refers to this frame
        self._show(written, took_s)
        return True

    def _show(self, written: Written, took_s: float) -> None:
        """Show the result of a batch that was written."""
        self._events_written = self._events_taken
        if self._outbox is not None:
            self._outbox.mark = written.outbox
        if self._events_lost:
            self._component.count("events_lost", self._events_lost)
        self._backoff_s = WRITE_INTERVAL_S
        if took_s >= SLOW_S + 2 * WRITE_INTERVAL_S:
            self._report_fault(f"the disk is slow: the last second took {took_s:.1f} s to write")
        elif written.complaint:
            self._report_fault(f"written, but {self._store.path}: {written.complaint}")
        else:
            size = f"{written.used_bytes / 1e6:.1f} MB in {self._store.path}"
            self._component.set_state(State.OK, size)
        for notice in written.notices:
            self._log.note_recorded(notice.kind, notice.text, notice.detail)

    def _next_batch(self, now_ns: int) -> Batch:
        items, self._items = self._items, deque()
        events = self._log.after(self._events_written)
        self._events_taken = events[-1].number if events else self._events_written
        self._events_lost = self._events_taken - self._events_written - len(events)
        new = [event for event in events if not event.is_recorded]
        acknowledged = None if self._outbox is None else self._outbox.acknowledged
        return Batch(now_ns, self._wall_us(), items, new, acknowledged)

    def _count_lost(self, batch: Batch) -> None:
        """Count what a batch held that is dropped."""
        for counter, number in (
            ("measurements_lost", sum(isinstance(item, Sample) for item in batch.items)),
            ("events_lost", self._events_lost + len(batch.events)),
        ):
            if number:
                self._component.count(counter, number)

    def _put_back(self, batch: Batch | None) -> None:
        if batch is None:
            return
        self._items.extendleft(reversed(batch.items))
        self._limit()

    def _add(self, item: Item) -> None:
        self._items.append(item)
        self._limit()

    def _limit(self) -> None:
        set_clock: ClockSet | None = None
        while len(self._items) + (set_clock is not None) > MAX_WAITING_ITEMS:
            dropped = self._items.popleft()
            if isinstance(dropped, Sample):
                self._component.count("measurements_lost")
            elif isinstance(dropped, ClockSet):
                set_clock = dropped  # the items after it use its time
        if set_clock is not None:
            self._items.appendleft(set_clock)

    def _wall_us(self) -> int:
        """Return UTC now; if the clock was set since the last call, record that first."""
        now_ns = self._clock.monotonic_ns()
        utc = self._clock.utc(now_ns)
        wall_us = 0 if utc is None else round(utc.timestamp() * 1e6)
        offset_us = wall_us - now_ns // 1000
        before_us, self._offset_us = self._offset_us, offset_us
        if before_us is not None and abs(offset_us - before_us) > CLOCK_STEP_US:
            step_s = (offset_us - before_us) * 1e-6
            self._items.append(ClockSet(wall_us))
            self._log.note(
                EventKind.CLOCK, f"the time of day was set by {step_s:+.1f} s", None, None, {"step_s": step_s}
            )
        return wall_us

    def _report_fault(self, sentence: str, logged: str = "") -> None:
        if self._component.state is not State.DEGRADED:
            log.warning("history: %s", logged or sentence)
        self._component.set_state(State.DEGRADED, sentence)

    async def _end(self, thread: DeviceThread) -> None:
        """Write the waiting items; what the disk does not accept in time is lost."""
        self._add(StateSample(self._wall_us(), _worst_fault(self._read_state())))
        if self._writing is not None:
            await asyncio.wait([self._writing], timeout=_END_TIMEOUT_S / 2)
            if not self._settle(self._writing):
                self._writing.cancel()
                await asyncio.gather(self._writing, return_exceptions=True)
                await thread.end(lambda: self._store.end(None), 0.0)
                return
        last = self._next_batch(self._clock.monotonic_ns())
        await thread.end(lambda: self._store.end(last), _END_TIMEOUT_S)


def _worst_fault(report: StateReport) -> WorstFault:
    """Return the severity of the unit's signal and the code of its worst cause."""
    if not report.causes:
        return report.signal.severity, ""
    cause = report.causes[0].cause
    is_of_target = cause.of is not None and isinstance(cause.kind, Reason)
    return report.signal.severity, f"{cause.of}_{cause.kind}" if is_of_target else str(cause.kind)


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error)
