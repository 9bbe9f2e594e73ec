"""The whole daemon on a clock that is set: cameras that deliver what an episode has, and its interfaces."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, ClassVar
from unittest import mock

from altd.acquisition.frame_pairs import FramePairs
from altd.app.daemon import Daemon
from altd.config import Measuring
from altd.measuring.pairing import Pair
from altd.ports import CameraError, CameraLostError, CameraNotFoundError, CameraTimeoutError, Stop
from altd.records import CameraIdentity, Frame, Measurement, Origin
from benchmarks.campaign.clips import SimulatedRig
from benchmarks.campaign.timed import SteppedClock
from benchmarks.campaign.way import CAMERAS
from benchmarks.interfaces import Interfaces
from benchmarks.material import make_config

_PATIENCE_S = 30.0
_POLL_S = 0.0002


class LiveClock(SteppedClock):
    """A stepped clock on which threads wait too; ``utc_step`` is what the computer's clock was set by."""

    def __init__(self, now_ns: int) -> None:
        super().__init__(now_ns)
        self.passed = threading.Condition()
        self.utc_step = timedelta()
        self.has_ended = False
        self._waiting: dict[int, int] = {}

    def utc(self, t_ns: int) -> datetime:
        """UTC of a monotonic instant, as the computer's clock has it now."""
        return super().utc(t_ns) + self.utc_step

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread until time was set so far."""
        due_ns = self.monotonic_ns() + round(seconds * 1e9)
        with self.passed:
            while not stop.is_set() and self.is_before(due_ns):
                self.passed.wait(0.05)

    def is_before(self, due_ns: int) -> bool:
        """Whether a thread still has to wait; it is counted as waiting. ``passed`` is held."""
        self._waiting[threading.get_ident()] = due_ns
        if self.monotonic_ns() < due_ns and not self.has_ended:
            return True
        del self._waiting[threading.get_ident()]
        return False

    def is_busy(self) -> None:
        """The thread that calls has something to do. ``passed`` is held."""
        self._waiting.pop(threading.get_ident(), None)

    def is_held(self, threads: int) -> bool:
        """Whether so many threads wait for a later time."""
        with self.passed:
            return sum(due_ns > self.monotonic_ns() for due_ns in self._waiting.values()) >= threads

    async def set(self, t_ns: int, *, at_one_blow: bool = False) -> None:
        """Let time pass, for tasks and for threads."""
        await self.pass_to(t_ns, at_one_blow=at_one_blow)
        with self.passed:
            self.passed.notify_all()

    def end(self) -> None:
        """Let all threads go."""
        with self.passed:
            self.has_ended = True
            self.passed.notify_all()


class EpisodeCamera:
    """``altd.ports.Camera``: delivers what it is given, and may be unplugged."""

    playback, waits, exposure_range = False, False, None
    origin = Origin.SIMULATED

    def __init__(self, name: str, clock: LiveClock) -> None:
        self.name = name
        self.identity = CameraIdentity(f"SIM-{name}", "simulated", "hw_sim")
        self.is_unplugged = self.is_open = False
        self.frames: deque[Frame] = deque()
        self._clock = clock

    def open(self) -> None:
        """It is there unless it was unplugged."""
        if self.is_unplugged:
            raise CameraNotFoundError("no such device")
        self.frames.clear()
        self.is_open = True

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame that was given."""
        clock = self._clock
        due_ns = clock.monotonic_ns() + round(timeout_s * 1e9)
        with clock.passed:
            while not self.frames and not self.is_unplugged:
                if not clock.is_before(due_ns):
                    raise CameraTimeoutError("no frame")
                clock.passed.wait(0.05)
            clock.is_busy()
            if self.is_unplugged:
                raise CameraLostError("it was unplugged")
            return self.frames.popleft()

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """It has none to set."""
        raise CameraError("not settable")

    def close(self) -> None:
        """Lose all that arrives until it is opened again."""
        self.is_open = False


@dataclass(frozen=True, slots=True, eq=False)
class LiveUnit:
    """The daemon's cameras and its clock. ``wires`` are the places of its interfaces."""

    daemon: Daemon
    clock: LiveClock
    cameras: dict[str, EpisodeCamera]
    wires: Interfaces
    socket: Path
    _is_done: Callable[[], bool]

    async def deliver(self, *frames: Frame) -> None:
        """Hand over frames and wait until the daemon has done all that it does with them."""
        with self.clock.passed:
            for frame in frames:
                camera = self.cameras[frame.camera]
                if camera.is_open and not camera.is_unplugged:
                    camera.frames.append(frame)
            self.clock.passed.notify_all()
        await self.settle()

    async def settle(self) -> None:
        """Wait until cameras' threads wait for a later time, and every frame set was measured."""
        give_up_s = time.monotonic() + _PATIENCE_S
        quiet = 0
        while quiet < 2:
            is_quiet = self.clock.is_held(len(CAMERAS)) and not any(
                camera.is_open and (camera.frames or camera.is_unplugged) for camera in self.cameras.values()
            )
            quiet = quiet + 1 if is_quiet and self._is_done() else 0
            if time.monotonic() > give_up_s:
                raise TimeoutError("the daemon does not come to rest")
            await asyncio.sleep(0 if quiet else _POLL_S)
        await self.clock.settle()


@contextlib.asynccontextmanager
async def live_unit(
    rig: SimulatedRig,
    wires: Interfaces,
    telegram: Path,
    now_ns: int,
    measuring: Measuring,
) -> AsyncIterator[LiveUnit]:
    """A daemon that serves on ``wires``, with default settings beside these; it measures when this yields."""
    clock, socket = LiveClock(now_ns), telegram.with_name("altd.sock")
    port, *lines = wires.tables["serial"]
    tables = {**wires.tables, "serial": [{**port, "device": telegram}, *lines]}
    config = make_config(**tables, measuring=measuring, local={"socket": socket})
    cameras = {name: EpisodeCamera(name, clock) for name in CAMERAS}
    daemon = Daemon(config, rig.calibration, cameras, clock=clock, rehearsal=True)
    if config.history.file is not None:
        daemon.past.keep_as(config, rig.calibration)
    with _watched(daemon) as is_done:
        task = asyncio.create_task(daemon.run(), name="daemon")
        try:
            async with asyncio.timeout(_PATIENCE_S):
                while not clock.is_held(len(CAMERAS)) and not task.done():  # noqa: ASYNC110  of threads
                    await asyncio.sleep(0.001)
            if task.done():
                task.result()
            yield LiveUnit(daemon, clock, cameras, wires, socket, is_done)
        finally:
            clock.end()
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


class _WatchedPairs(FramePairs):
    """The daemon's frame pairs, which tell how many were taken to be located."""

    made: ClassVar[_WatchedPairs]
    taken = 0

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        _WatchedPairs.made = self

    def take(self) -> list[Pair[Frame]]:
        """As the daemon takes them."""
        pairs = super().take()
        self.taken += len(pairs)
        return pairs


@contextlib.contextmanager
def _watched(daemon: Daemon) -> Iterator[Callable[[], bool]]:
    """Whether every frame set that waits was taken, located and measured.

    Nothing that a daemon shows tells that: its frame pairs and its chain are watched.
    """
    measured, add = [0], daemon.chain.add

    def add_and_count(located: Pair[Any]) -> Measurement | None:
        measured[0] += 1
        return add(located)

    pairs = f"{Daemon.__module__}.FramePairs"
    with mock.patch.object(daemon.chain, "add", add_and_count), mock.patch(pairs, _WatchedPairs):
        yield lambda: _WatchedPairs.made.is_empty and _WatchedPairs.made.taken == measured[0]
