"""The unit's state in the four signals of NAMUR NE 107 beside good, with every cause and the availability.

It is found out again whenever it is read, from the board, the components and the watches: no task can die and
leave an old state behind. The task that looks regularly serves the memory of causes and the counting.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from altd.ports import Clock
from altd.reasons import Signal
from altd.records import Measurement
from altd.status.availability import Availability
from altd.status.board import Board
from altd.status.cause import Cause, CauseFilter, ShownCause, StateReport, signal_of, worst
from altd.status.causes import START_S, causes_now, is_warning
from altd.status.conditions import Condition
from altd.status.health import Health

TICK_S = 0.25
"""How often the state is looked at when nobody asks."""

Watch = Callable[[int], Iterable[Cause]]
"""What is wrong at an instant of the monotonic clock, ns, by what is neither board nor component."""


class UnitState:
    """One daemon's state. ``watches`` know of more than board and health do."""

    def __init__(self, board: Board, health: Health, clock: Clock, watches: Iterable[Watch] = ()) -> None:
        self._board = board
        self._health = health
        self._clock = clock
        self._watches = tuple(watches)
        self._started_ns = clock.monotonic_ns()
        self._filter = CauseFilter()
        self._signal = Signal.CHECK_FUNCTION
        self._since_ns = self._started_ns
        self.availability = Availability(self._started_ns, clock.utc)

    async def run(self) -> None:
        """Look regularly until cancelled."""
        while True:
            self._look()
            await self._clock.sleep(TICK_S)

    def read(self) -> StateReport:
        """The state at this moment."""
        now_ns, causes = self._look()
        return StateReport(self._signal, self._since_ns, now_ns, causes, self.availability)

    def _look(self) -> tuple[int, tuple[ShownCause, ...]]:
        now_ns = self._clock.monotonic_ns()
        measurement = self._board.read()
        running_s = (now_ns - self._started_ns) * 1e-9
        causes = causes_now(measurement, self._health, now_ns, running_s)
        causes += self._watched(now_ns)
        self.availability.look(now_ns, _lost_to(measurement, running_s))
        shown = self._filter.update(causes, now_ns)
        if (signal := worst(shown)) is not self._signal:
            self._signal, self._since_ns = signal, now_ns
        return now_ns, shown

    def _watched(self, now_ns: int) -> Iterator[Cause]:
        """What the watches say. One that fails is a cause: it must neither end the daemon nor be good."""
        for watch in self._watches:
            try:
                yield from watch(now_ns)
            except Exception as error:
                detail = f"{type(error).__name__}: {error}"
                yield Cause(Condition.COMPONENT_FAILED, getattr(watch, "__qualname__", "watch"), detail)


def _lost_to(measurement: Measurement | None, running_s: float) -> str | None:
    """The worst reason for which nothing valid is measured, without its target; None when there is."""
    if measurement is None:
        return str(Condition.STARTING if running_s < START_S else Condition.NOTHING_MEASURED)
    if measurement.valid:
        return None
    reasons = [fault.reason for fault in measurement.status if not is_warning(fault)]
    return str(max(reasons, key=lambda reason: signal_of(reason).severity, default=Condition.UNKNOWN_REASON))
