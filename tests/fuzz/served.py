"""Interfaces that are served while the examples of one process are tried, and measurements to be served."""

import asyncio
import atexit
import contextlib
import functools
import logging
from collections.abc import Callable, Coroutine
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

from hypothesis import strategies as st
from support.clock import FakeClock
from support.measurements import measured

from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.solver import Beam
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import Component, Health
from altd.status.unit import PublishedUnit, UnitFacts
from tools.pages.example import MEASURED

Result = TypeVar("Result")


class Faces:
    """A loop that runs only while an example is tried, and what is served in it."""

    def __init__(self) -> None:
        self.clock = FakeClock(MEASURED.t_ns + 520_000_000)
        self.board = Board(self.clock, 1.0, QUANTITIES)
        self.board.publish(MEASURED)
        self.health = Health(self.clock)
        facts = UnitFacts(version="0.1.0", serial="ALT-0007", calibration="2026-11-02")
        self.published = PublishedUnit(self.board, self.health, facts)
        self.said = Said()
        self._loop = asyncio.new_event_loop()
        self._serving: list[asyncio.Task[None]] = []
        logging.getLogger().addHandler(self.said)
        atexit.register(self._end)

    def component(self, name: str) -> Component:
        return self.health.component(name)

    def do(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Run until the work is done; any log line of an interface meanwhile is a defect."""
        self.said.lines.clear()
        result = self._loop.run_until_complete(work)
        assert not self.said.lines, "\n".join(self.said.lines)
        for face in self._serving:
            assert not face.done(), "the face ended"
        return result

    def serve(self, publisher: Any) -> None:
        """Serve from now on; returns once it is ready."""

        async def begin() -> None:
            ready = asyncio.Event()
            self._serving.append(asyncio.create_task(publisher.run(ready.set)))
            await asyncio.wait_for(ready.wait(), 60.0)

        self.do(begin())

    def _end(self) -> None:
        async def end() -> None:
            for face in self._serving:
                face.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.gather(*self._serving)

        logging.getLogger().removeHandler(self.said)
        self._loop.run_until_complete(end())
        self._loop.close()


class Said(logging.Handler):
    """Keeps what is logged: no client may make a unit log anything."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(self.format(record))


def served(make: Callable[[Faces], Any]) -> Callable[[], tuple[Faces, Any]]:
    """The face of a target and what serves it, made with the first example."""

    @functools.cache
    def made() -> tuple[Faces, Any]:
        faces = Faces()
        publisher = make(faces)
        faces.serve(publisher)
        return faces, publisher

    return made


async def read_all(reader: asyncio.StreamReader) -> bytes:
    """The bytes that an interface sends until it closes; a reset ends it, too."""
    heard = b""
    with contextlib.suppress(ConnectionError):
        while piece := await reader.read(65536):
            heard += piece
    return heard


_FINITE = st.floats(allow_nan=False, allow_infinity=False)
_LENGTH = st.floats(-200, 200) | _FINITE
_ANGLE = st.floats(-89, 89) | st.floats(-1e6, 1e6)
_SIGMA = st.floats(0, 1) | st.floats(0, allow_nan=False, allow_infinity=False)
_TARGETS = st.sampled_from(("front", "rear", None))
_FAULTS = st.builds(Fault, st.sampled_from(Reason), _TARGETS, st.text(max_size=200))
_TIMES = st.none() | st.datetimes(datetime(1970, 1, 1), datetime(2105, 1, 1), timezones=st.just(UTC))


def _with_a_reason(measurement: Measurement) -> Measurement:
    """An invalid measurement has at least one reason that is no warning."""
    if measurement.valid or any(not fault.reason.is_warning for fault in measurement.status):
        return measurement
    return replace(measurement, status=(*measurement.status, Fault(Reason.STALE)))


measurements = st.builds(
    measured,
    sequence=st.integers(0, 2**63),
    t_ns=st.integers(0, 2**62),
    time=_TIMES | _TIMES.map(lambda time: time and time + timedelta(microseconds=999)),
    frames=st.integers(0, 1000) | st.integers(0, 2**31),
    beam=st.none() | st.builds(Beam, _LENGTH, _LENGTH, _ANGLE, _ANGLE, _SIGMA, _SIGMA, _SIGMA, _SIGMA),
    points_mm=st.fixed_dictionaries(
        {"front": st.none() | st.tuples(_LENGTH, _LENGTH), "rear": st.none() | st.tuples(_LENGTH, _LENGTH)}
    ),
    status=st.lists(_FAULTS, max_size=8).map(tuple),
    roll_deg=st.none() | _ANGLE,
).map(_with_a_reason)
"""Finite numbers of any size: that they are finite and in range is the last check's before the board."""
