"""One thread per camera locates the spot in its newest frame; the event loop only pairs what it found."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.buffers import Buffers
from altd.measuring.spot_locator import Located, SpotLocator
from altd.records import Frame, NoSpot, Spot
from altd.runtime.threads import call_in_thread

MAX_WAITING_FRAMES = 8
"""What was located waits for a loop that comes late, so many of a camera: it is small, and was the work."""
_CHECK_INTERVAL_S = 0.25
_MAX_CHECKS = 20
"""One frame that is still being located after so many checks, 5 s, never will be. Checks are counted and not
seconds, for a process that was stopped and goes on has not located longer."""
_JOIN_TIMEOUT_S = 3.0


class LocatingStalledError(Exception):
    """A frame that is never done: a defect, which a new process may not have."""


async def locate_frames(
    buffers: Buffers,
    locator: SpotLocator,
    exposure: ExposureControl | None = None,
    waits: bool = False,
    show: Callable[[Frame, Spot | NoSpot], None] = lambda frame, spot: None,
) -> None:
    """Locate the spot in each of a camera's frames, until cancelled or until they are at their end.

    ``exposure`` is shown each of them, and ``show`` is called with each and its spot, in the thread.
    ``waits``: none is to be dropped. Raises what the locator raises, and
    LocatingStalledError when it does not return.
    """
    worker = _Worker(buffers, locator, exposure, waits, show)
    done = call_in_thread(worker.run, f"locate-{locator.camera}")
    done.add_done_callback(lambda _: done.cancelled() or done.exception())  # nobody may ask for it
    same, checks = None, 0
    try:
        while not (await asyncio.wait({done}, timeout=_CHECK_INTERVAL_S))[0]:
            in_hand = worker.in_hand
            checks = checks + 1 if in_hand is not None and in_hand is same else 0
            same = in_hand
            if in_hand is not None and checks >= _MAX_CHECKS:
                raise LocatingStalledError(
                    f"camera {locator.camera}: exposure {in_hand.sequence} is not located within "
                    f"{_MAX_CHECKS * _CHECK_INTERVAL_S:g} s"
                )
    finally:
        worker.stop.set()
        if not done.done():
            buffers.close()
        await asyncio.wait({done}, timeout=_JOIN_TIMEOUT_S)
    done.result()
    buffers.located.wake()  # nothing follows that would


def locate_frame(frame: Frame, locator: SpotLocator, exposure: ExposureControl | None = None) -> Located:
    """What one frame holds; ``exposure`` is shown it."""
    located = locator.locate(frame)
    if exposure is not None and located.found is not None:
        exposure.sample(frame, located.found)
    return located


class _Worker:
    """The thread's side; ``in_hand`` is the frame that is being located."""

    def __init__(
        self,
        buffers: Buffers,
        locator: SpotLocator,
        exposure: ExposureControl | None,
        waits: bool,
        show: Callable[[Frame, Spot | NoSpot], None],
    ) -> None:
        self.stop = threading.Event()
        self.in_hand: Frame | None = None
        self._frames, self._located = buffers.frames, buffers.located
        self._locator = locator
        self._exposure = exposure
        self._waits = waits
        self._show = show

    def run(self) -> None:
        while (frame := self._frames.take(self._locator.camera)) is not None and not self.stop.is_set():
            self.in_hand = frame
            located = locate_frame(frame, self._locator, self._exposure)
            self.in_hand = None
            self._located.put(located, self._waits)
            self._show(frame, located.spot)
