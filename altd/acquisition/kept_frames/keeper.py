"""Writes the frames of the last seconds as a recording: after a fault, or on request."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from altd.acquisition.exposures_writer import ExposuresWriter, RecordingPlan
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.kept_frames.store import RecordingStore, Written
from altd.config import KeptFrames, Measuring
from altd.measuring.pairing import Pair, Pairer
from altd.ports import Camera, Clock
from altd.reasons import Signal
from altd.records import Frame, counted
from altd.runtime.threads import DeviceThread, call_in_thread
from altd.status.cause import ShownCause, StateReport
from altd.status.health import Component, State
from altd.status.services import KeptRecording, NoExposureError, NotKeptError

log = logging.getLogger("altd")

Result = TypeVar("Result")

_LOOK_INTERVAL_S = 0.25
_GRAVE = (Signal.FAILURE, Signal.OUT_OF_SPECIFICATION)
"""Signals of faults to record; an intended state, such as a self-check, or maintenance alone is no fault."""
_MAX_PAUSE_S = 0.1
_DISK_TIMEOUT_S = 120.0
"""Maximum time of a disk operation. Writing a recording on half a core takes seconds."""
_READ_TIMEOUT_S = 10.0
"""Maximum time of reading a file, which normally takes milliseconds."""
_END_TIMEOUT_S = 1.0
_MAX_WAITING = 4
"""Maximum number of recordings requested or being written; only the one being written holds frames."""


@dataclass(frozen=True, slots=True)
class Source:
    """Source of recordings: the cameras' newest frames, their pairing, and the unit."""

    ring: FrameRing
    cameras: Mapping[str, Camera]
    measuring: Measuring
    plan: RecordingPlan


class FrameKeeper:
    """Keeps recordings of one unit.

    ``state`` returns the unit's current state and causes. ``note`` is called with a text and the kept
    recording, or None if it could not be kept; the text then has the reason.
    """

    def __init__(
        self,
        source: Source,
        settings: KeptFrames,
        store: RecordingStore,
        state: Callable[[], StateReport],
        component: Component,
        note: Callable[[str, KeptRecording | None], None] = lambda text, kept: None,
    ) -> None:
        self.ring = source.ring
        self._source = source
        self._settings = settings
        self._store = store
        self._state = state
        self._component = component
        self._clock: Clock = component.clock
        self._stop = threading.Event()
        self._note = note
        self._disk: DeviceThread | None = None
        self._waiting = 0
        self._recordings: tuple[KeptRecording, ...] = ()
        self._known: set[str] = set()
        """Causes with a signal of ``_GRAVE`` at the last check."""
        self._kept_ns: dict[str, int] = {}
        """Time of the last recording by cause."""
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """The kept recordings, newest first."""
        return self._recordings

    async def run(self) -> None:
        """Check for new faults and record them until cancelled."""
        self._disk = disk = DeviceThread("kept-frames")
        try:
            await self._open()
            while True:
                if self._settings.on_fault and (why := self._new_fault()):
                    task = asyncio.create_task(self._keep_after_fault(why), name=f"keep frames of {why}")
                    self._tasks.add(task)
                    task.add_done_callback(self._tasks.discard)
                await self._clock.sleep(_LOOK_INTERVAL_S)
        finally:
            self._stop.set()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            await disk.end(lambda: None, _END_TIMEOUT_S)

    async def keep(self, why: str) -> KeptRecording:
        """Write the frames of the last seconds, up to now; raises NotKeptError."""
        now_ns = self._clock.monotonic_ns()
        return await self._keep(why, now_ns - self._before_ns, now_ns)

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """Mark a recording, so that it is never removed, or unmark it; raises NotKeptError."""
        before = any(each.name == name and each.marked for each in self._recordings)
        kept = await self._on_disk(
            partial(self._store.mark, name, is_marked), lambda _: self._store.mark(name, before)
        )
        self._recordings = tuple(kept if each.name == name else each for each in self._recordings)
        return kept

    async def files(self, name: str) -> Sequence[str]:
        """Return the files of a recording, as paths relative to it; raises NotKeptError."""
        return await _beside(partial(self._store.files, name))

    async def content(self, name: str, file: str) -> bytes | None:
        """Return the content of one of these files; None: it is gone. Raises NotKeptError."""
        return await _beside(partial(self._store.content, name, file))

    @property
    def _before_ns(self) -> int:
        return round(self._settings.before_s * 1e9)

    async def _open(self) -> None:
        try:
            self._recordings = await self._on_disk(self._store.open)
        except NotKeptError as error:
            self._component.set_state(State.DEGRADED, f"recordings cannot be kept: {error}")
        else:
            self._show_usage()

    def _new_fault(self) -> str:
        """Return the worst cause that is new since the last check and not yet recorded; empty: none."""
        causes = [shown for shown in self._state().causes if shown.is_active and shown.signal in _GRAVE]
        before, self._known = self._known, {_key(shown) for shown in causes}
        now_ns = self._clock.monotonic_ns()
        again_ns = round(self._settings.again_after_s * 1e9)
        for why in map(_key, causes):
            last_ns = self._kept_ns.get(why)
            if why not in before and (last_ns is None or now_ns - last_ns >= again_ns):
                # one recording covers all causes of that moment
                self._kept_ns |= dict.fromkeys(self._known, now_ns)
                return why
        return ""

    async def _keep_after_fault(self, why: str) -> None:
        fault_ns = self._clock.monotonic_ns()
        await self._clock.sleep(self._settings.after_s)
        until_ns = fault_ns + round(self._settings.after_s * 1e9)
        try:
            kept = await self._keep(why, fault_ns - self._before_ns, until_ns)
        except NotKeptError as error:
            log.warning("the frames before %s are not saved: %s", why, error)
        else:
            log.info("the frames before %s are saved as %s", why, kept.name)

    async def _keep(self, why: str, since_ns: int, until_ns: int) -> KeptRecording:
        if self._waiting >= _MAX_WAITING:
            raise NotKeptError(f"{self._waiting} recordings are being written already")
        self._waiting += 1
        try:
            kept, self._recordings = await self._on_disk(
                partial(self._write, why, since_ns, until_ns), lambda done: self._store.remove(done[0].name)
            )
        except NotKeptError as error:
            self._component.count("not_kept")
            if not isinstance(error, NoExposureError):
                self._component.set_state(State.DEGRADED, f"{why} was not recorded: {error}")
            self._note(f"{why} was not recorded: {error}", None)
            raise
        finally:
            self._waiting -= 1
        self._component.count("kept")
        self._show_usage()
        self._note(f"{kept.seconds:.1f} s of frames saved: {why}", kept)
        return kept

    def _write(
        self, why: str, since_ns: int, until_ns: int
    ) -> tuple[KeptRecording, tuple[KeptRecording, ...]]:
        """Pair the frames and write them, in the disk's thread; return the recording, and all recordings.

        Frames are taken from the ring only here, so that two recordings never hold frames at a time.
        """
        ring = self._source.ring
        frames = ring.between(since_ns, until_ns)
        if not frames and ring.between(until_ns + 1, self._clock.monotonic_ns()):
            raise NotKeptError("the disk was too slow")
        if not frames:
            raise NoExposureError("no frames in the last seconds")
        start = self._clock.utc(frames[0].t_ns)
        nbytes = sum(frame.pixels.nbytes for frame in frames)
        kept = self._store.add(why, start, nbytes, partial(self._write_into, frames))
        try:
            return kept, self._store.recordings()
        except OSError:  # it is kept all the same
            return kept, (kept, *self._recordings)

    def _write_into(self, frames: deque[Frame], folder: Path) -> Written:
        source = self._source
        writer = ExposuresWriter(folder, source.plan, source.cameras, self._clock.utc)
        try:
            for pair in self._pairs(frames):
                if self._stop.is_set():
                    raise NotKeptError("the daemon ends")
                began_s = time.monotonic()
                writer.write(pair)
                # half of one core at most: current frames have priority
                self._stop.wait(min(time.monotonic() - began_s, _MAX_PAUSE_S))
        finally:
            writer.close()
        return Written(writer.exposures, writer.length_s)

    def _pairs(self, frames: deque[Frame]) -> Iterator[Pair[Frame]]:
        """Yield the frame sets, without frames of a change of exposure; a frame is released once yielded."""
        measuring = self._source.measuring
        pairer: Pairer[Frame] = Pairer(
            tuple(self._source.cameras), measuring.pair_by, measuring.max_skew_ns, measuring.max_lag_ns
        )
        while frames:
            frame = frames.popleft()
            if not frame.changing:
                yield from pairer.add(frame.camera, frame.sequence, frame.t_ns, frame)
        yield from pairer.flush()

    async def _on_disk(
        self, call: Callable[[], Result], undo: Callable[[Result], object] | None = None
    ) -> Result:
        """Make a call in the disk's thread; raises NotKeptError if it fails or the disk hangs.

        A call that returns after this was raised is undone.
        """
        if self._disk is None:
            raise NotKeptError("the unit starts")
        try:
            return await self._disk.call(call, within_s=_DISK_TIMEOUT_S, undo=undo)
        except NotKeptError:
            raise
        except TimeoutError:
            raise NotKeptError(f"the disk does not answer within {_DISK_TIMEOUT_S:g} s") from None
        except OSError as error:
            raise NotKeptError(error.strerror or str(error)) from error
        except Exception as error:  # despite any defect, the next fault must be recorded
            log.exception("kept frames: a defect")
            raise NotKeptError(f"a defect: {type(error).__name__}: {error}") from error

    def _show_usage(self) -> None:
        taken = sum(kept.bytes for kept in self._recordings)
        count = len(self._recordings)
        self._component.set_state(
            State.OK, f"{counted(count, 'recording')}, {taken >> 20} of {self._settings.disk_mb} MB"
        )


async def _beside(call: Callable[[], Result]) -> Result:
    """Read from the disk while a recording may be written; raises NotKeptError, also if the disk hangs.

    The call has its own thread; if it hangs, it blocks neither the loop nor the end of the process.
    """
    try:
        async with asyncio.timeout(_READ_TIMEOUT_S):
            return await call_in_thread(call, "kept-frames read")
    except TimeoutError:
        raise NotKeptError(f"the disk does not answer within {_READ_TIMEOUT_S:g} s") from None
    except OSError as error:
        raise NotKeptError(error.strerror or str(error)) from error


def _key(shown: ShownCause) -> str:
    of = f" {shown.cause.of}" if shown.cause.of else ""
    return f"{shown.cause.kind}{of}"
