"""The whole daemon on a stepped clock: cameras that deliver an episode's frames, and its interfaces."""

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
from altd.runtime.supervision import keep_device
from altd.runtime.threads import DeviceThread
from benchmarks.campaign.clips import SimulatedRig
from benchmarks.campaign.episode import SteppedClock
from benchmarks.campaign.way import CAMERAS
from benchmarks.interfaces import Interfaces
from benchmarks.material import make_config

_PATIENCE_S = 30.0
_POLL_S = 0.0002
_TURNS = 10
"""Turns of the loop for which nothing happens at rest: a camera's task takes some between two calls."""


class _CameraThread(DeviceThread):
    """Thread of a device; those of the cameras are remembered."""

    made: ClassVar[list[DeviceThread]] = []

    def __init__(self, name: str) -> None:
        super().__init__(name)
        if name.startswith("camera "):
            self.made.append(self)


class LiveClock(SteppedClock):
    """A stepped clock for waiting threads too; ``utc_step`` is the step of the computer's clock."""

    def __init__(self, now_ns: int) -> None:
        super().__init__(now_ns)
        self.passed = threading.Condition()
        self.utc_step = timedelta()
        self.has_ended = False
        self._waiting: dict[int, int] = {}

    def utc(self, t_ns: int) -> datetime:
        """UTC of a monotonic instant by the computer's clock."""
        return super().utc(t_ns) + self.utc_step

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread until the time has been set that far."""
        due_ns = self.monotonic_ns() + round(seconds * 1e9)
        with self.passed:
            while not stop.is_set() and self.is_before(due_ns):
                self.passed.wait(0.05)

    def is_before(self, due_ns: int) -> bool:
        """Whether a thread must still wait, in which case it is counted as waiting. ``passed`` is held."""
        self._waiting[threading.get_ident()] = due_ns
        if self.monotonic_ns() < due_ns and not self.has_ended:
            return True
        del self._waiting[threading.get_ident()]
        return False

    def is_busy(self) -> None:
        """Mark the calling thread as busy. ``passed`` is held."""
        self._waiting.pop(threading.get_ident(), None)

    def is_held(self) -> bool:
        """Whether each camera's thread waits for a later time or has nothing to do."""
        busy = sum(thread._turn.locked() for thread in _CameraThread.made)  # noqa: SLF001
        with self.passed:
            return sum(due_ns > self.monotonic_ns() for due_ns in self._waiting.values()) >= busy

    async def set(self, t_ns: int, *, at_one_blow: bool = False) -> None:
        """Advance the time, for tasks and for threads."""
        await self.pass_to(t_ns, at_one_blow=at_one_blow)
        with self.passed:
            self.passed.notify_all()

    def end(self) -> None:
        """Release all threads."""
        with self.passed:
            self.has_ended = True
            self.passed.notify_all()


class EpisodeCamera:
    """Camera (``altd.ports.Camera``) that delivers the frames given to it; it may be unplugged."""

    playback, waits, exposure_range = False, False, None
    origin = Origin.SIMULATED

    def __init__(self, name: str, clock: LiveClock) -> None:
        self.name = name
        self.identity = CameraIdentity(f"SIM-{name}", "simulated", "hw_sim")
        self.is_unplugged = self.is_open = False
        self.frames: deque[Frame] = deque()
        self._clock = clock

    def open(self) -> None:
        """Open the camera; raises CameraError if it is unplugged."""
        if self.is_unplugged:
            raise CameraNotFoundError("no such device")
        self.frames.clear()
        self.is_open = True

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next frame given to the camera."""
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
        """Raise CameraError: the exposure is not settable."""
        raise CameraError("not settable")

    def close(self) -> None:
        """Close the camera; frames that arrive before it is reopened are lost."""
        self.is_open = False


@dataclass(frozen=True, slots=True, eq=False)
class LiveUnit:
    """The daemon's cameras and its clock. ``wires`` are the addresses of its interfaces."""

    daemon: Daemon
    clock: LiveClock
    cameras: dict[str, EpisodeCamera]
    wires: Interfaces
    socket: Path
    _is_done: Callable[[], bool]

    async def deliver(self, *frames: Frame) -> None:
        """Deliver frames and wait until the daemon has processed them."""
        with self.clock.passed:
            for frame in frames:
                camera = self.cameras[frame.camera]
                if camera.is_open and not camera.is_unplugged:
                    camera.frames.append(frame)
            self.clock.passed.notify_all()
        await self.settle()

    async def settle(self) -> None:
        """Wait until the cameras' threads wait for a later time and every frame set is measured."""
        give_up_s = time.monotonic() + _PATIENCE_S
        quiet = 0
        while quiet < _TURNS:
            is_quiet = self.clock.is_held() and not any(
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
    """Run a daemon with interfaces on ``wires``; settings without a parameter here are the defaults."""
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
                while not task.done() and not (  # noqa: ASYNC110  threads
                    all(camera.is_open for camera in cameras.values()) and clock.is_held()
                ):
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
    """Frame pairs of the daemon that count how many were taken for locating."""

    made: ClassVar[_WatchedPairs]
    taken = 0

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        _WatchedPairs.made = self

    def take(self, most: int | None = None) -> list[Pair[Frame]]:
        """Take the pairs and count them."""
        pairs = super().take(most)
        self.taken += len(pairs)
        return pairs


@contextlib.contextmanager
def _watched(daemon: Daemon) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether every waiting frame set was taken, located and measured.

    No output of the daemon shows that, so its frame pairs and its chain are observed.
    """
    measured, add = [0], daemon.chain.add

    def add_and_count(located: Pair[Any]) -> Measurement | None:
        measured[0] += 1
        return add(located)

    _CameraThread.made.clear()
    with (
        mock.patch.object(daemon.chain, "add", add_and_count),
        mock.patch(f"{Daemon.__module__}.FramePairs", _WatchedPairs),
        mock.patch(f"{keep_device.__module__}.DeviceThread", _CameraThread),
    ):
        yield lambda: _WatchedPairs.made.is_empty and _WatchedPairs.made.taken == measured[0]
