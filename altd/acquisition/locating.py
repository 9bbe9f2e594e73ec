"""The threads that locate the spots of the frame sets; the event loop takes their results."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from queue import SimpleQueue
from typing import Generic

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.frame_pairs import FramePairs, steps
from altd.measuring.frame_chain import Item, Locator
from altd.measuring.pairing import Pair
from altd.measuring.spot_locator import Located
from altd.records import Frame, NoSpot, Spot
from altd.runtime.threads import call_in_thread

MAX_WAITING_PAIRS = 8
"""Maximum number of located frame sets that wait for the event loop; then the thread waits."""
_CHECK_INTERVAL_S = 0.25
_MAX_CHECKS = 20
"""Number of checks, 5 s, after which a frame still being located counts as stalled. Checks are counted, not
seconds, so that a stopped and resumed process does not count as stalled."""
_JOIN_TIMEOUT_S = 3.0

_MIN_PIXELS_BESIDE = 1_000_000
"""Minimum size of frames located in parallel. Threads with smaller frames mostly wait for the interpreter: a
pair of 752 × 480 takes 13 % more CPU and 0.9 ms longer. Serially, 12 Mpx are too slow for 20 pairs/s."""


class LocatingStalledError(Exception):
    """The locating of a frame does not end: a defect that a new process may not have."""


class LocatedPairs(Generic[Item]):
    """Passes the results for ``frames`` from the locating thread to the loop; create it in that loop."""

    def __init__(self, frames: FramePairs) -> None:
        self.frames = frames
        self._loop = asyncio.get_running_loop()
        self._ready = asyncio.Event()
        self._pairs: deque[Pair[Item]] = deque()
        self._taken = threading.Condition()
        self._is_closed = False

    def put(self, pair: Pair[Item]) -> None:
        """Pass on a frame set, from the thread; wait while ``MAX_WAITING_PAIRS`` are not yet taken."""
        with self._taken:
            while len(self._pairs) >= MAX_WAITING_PAIRS and not self._is_closed:
                self._taken.wait()
            self._pairs.append(pair)
        try:
            self._loop.call_soon_threadsafe(self.wake)
        except RuntimeError:
            return  # the loop is closed: the process is ending

    async def take(self) -> list[Pair[Item]]:
        """Wait for a wake-up; return all waiting frame sets, oldest first; may be empty."""
        await self._ready.wait()
        self._ready.clear()
        with self._taken:
            pairs = list(self._pairs)
            self._pairs.clear()
            self._taken.notify_all()
        return pairs

    def wake(self) -> None:
        """Wake the reader from the loop, even if nothing waits."""
        self._ready.set()

    def close(self) -> None:
        """Release waiting threads; later frames are discarded."""
        self.frames.close()
        with self._taken:
            self._is_closed = True
            self._taken.notify_all()


class Locating(Generic[Item]):
    """Locates the spots of frame sets; large frames of a set in parallel, with one thread per camera.

    ``exposures`` (by camera) sample each frame with its result, and ``show`` is called with each frame and
    its spot, both in these threads.
    """

    def __init__(
        self,
        locators: Mapping[str, Locator[Item]],
        exposures: Mapping[str, ExposureControl],
        show: Callable[[Frame, Spot | NoSpot | str], None] = lambda frame, spot: None,
    ) -> None:
        self._locators = locators
        self._exposures = exposures
        self._show = show
        self._arrived = threading.Event()
        self._stop = threading.Event()
        self._in_hand: dict[str, Frame | None] = dict.fromkeys(locators)
        """The frame that is being located, by camera."""

    def arrived(self) -> None:
        """Wake the locating thread, from any thread: frame sets wait."""
        self._arrived.set()

    async def run(self, located: LocatedPairs[Item]) -> None:
        """Locate the spots of each frame set until cancelled or until the cameras end.

        Raises a locator's exception, and LocatingStalledError if a locator does not return.
        """
        done = call_in_thread(lambda: self._locate_all(located), "locate")
        done.add_done_callback(lambda _: done.cancelled() or done.exception())  # it may never be awaited
        last, checks = dict(self._in_hand), Counter[str]()
        try:
            while not (await asyncio.wait({done}, timeout=_CHECK_INTERVAL_S))[0]:
                for camera, frame in self._in_hand.items():
                    checks[camera] = checks[camera] + 1 if frame is not None and frame is last[camera] else 0
                    last[camera] = frame
                    if frame is not None and checks[camera] >= _MAX_CHECKS:
                        raise LocatingStalledError(
                            f"camera {camera}: exposure {frame.sequence} is not located within "
                            f"{_MAX_CHECKS * _CHECK_INTERVAL_S:g} s"
                        )
        finally:
            self._stop.set()
            located.close()
            await asyncio.wait({done}, timeout=_JOIN_TIMEOUT_S)
        done.result()
        located.wake()  # no later frame set wakes the reader

    def _locate_all(self, located: LocatedPairs[Item]) -> None:
        _, *others = self._locators
        helpers = {camera: _Helper(self._locate) for camera in others}
        is_at_end = False
        try:
            while not is_at_end:
                self._arrived.wait()
                self._arrived.clear()
                is_at_end = located.frames.is_at_end  # read before the waiting frame sets are taken
                while pairs := located.frames.take(1):  # the others can still be dropped
                    if self._stop.is_set():
                        return
                    located.put(self._locate_pair(pairs[0], helpers))
        finally:
            for helper in helpers.values():
                helper.end()

    def _locate_pair(self, pair: Pair[Frame], helpers: Mapping[str, _Helper[Item]]) -> Pair[Item]:
        """Start helpers on their large frames, locate the other frames here, and wait for the helpers."""
        beside = {
            frame.camera
            for frame in pair.all_items
            if frame.camera in helpers and frame.pixels.size >= _MIN_PIXELS_BESIDE
        }
        for frame in pair.all_items:
            if frame.camera in beside:
                helpers[frame.camera].begin(frame)
        own = iter([self._locate(frame) for frame in pair.all_items if frame.camera not in beside])
        return pair.converted(
            lambda frame: helpers[frame.camera].located() if frame.camera in beside else next(own)
        )

    def _locate(self, frame: Frame) -> Item:
        self._in_hand[frame.camera], began_ns = frame, time.perf_counter_ns()
        located = locate_frame(frame, self._locators[frame.camera], self._exposures.get(frame.camera))
        self._in_hand[frame.camera] = None
        took_ms = (time.perf_counter_ns() - began_ns) * 1e-6
        steps.debug(
            "frame %d of %s: located in %.2f ms: %s", frame.sequence, frame.camera, took_ms, located.spot
        )
        self._show(frame, located.spot)
        return located


class _Helper(Generic[Item]):
    """Locates the frames of one camera in a separate thread."""

    def __init__(self, locate: Callable[[Frame], Item]) -> None:
        self._locate = locate
        self._frames: SimpleQueue[Frame | None] = SimpleQueue()
        self._located: SimpleQueue[Item | BaseException] = SimpleQueue()
        threading.Thread(target=self._run, name="locate beside", daemon=True).start()

    def begin(self, frame: Frame) -> None:
        """Start locating the spot of a frame."""
        self._frames.put(frame)

    def located(self) -> Item:
        """Wait for the result of the started frame and return it; raises the locator's exception."""
        located = self._located.get()
        if isinstance(located, BaseException):
            raise located
        return located

    def end(self) -> None:
        """End the thread after its current frame."""
        self._frames.put(None)

    def _run(self) -> None:
        while (frame := self._frames.get()) is not None:
            try:
                self._located.put(self._locate(frame))
            except BaseException as error:
                self._located.put(error)


def locate_frame(frame: Frame, locator: Locator[Item], exposure: ExposureControl | None = None) -> Item:
    """Return the content of one frame; ``exposure`` samples a spot in it."""
    located = locator.locate(frame)
    if exposure is not None and isinstance(located, Located) and located.found is not None:
        exposure.sample(frame, located.found)
    return located
