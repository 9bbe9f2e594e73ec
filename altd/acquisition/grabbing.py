"""One thread per camera: blocking grabs, re-opening after a loss, never a block in the loop."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from altd.acquisition.auto_exposure.control import ExposureSetter
from altd.acquisition.inbox import Inbox
from altd.acquisition.timestamps import StampCheck
from altd.ports import (
    Camera,
    CameraBusyError,
    CameraEndedError,
    CameraError,
    CameraLostError,
    CameraMistimedError,
    CameraNotFoundError,
    CameraRefusedError,
    CameraTimeoutError,
    Clock,
)
from altd.status.health import Component, State, duration

log = logging.getLogger("altd")

GRAB_TIMEOUT_S = 0.25
_LOOK_EVERY_S = 0.25
_HELD_AFTER_S = 0.6
"""A driver that has neither delivered nor timed out for so long is held in a call."""
_LOSSES_FOR_S = 1.0
"""A lost or mistimed frame is spoken of for so long."""
_FIRST_RETRY_S = 0.2
_LONGEST_RETRY_S = 0.5
"""A camera that is back must be measured again within 2 s; half a window of exposures is 0.5 s of them."""
_NEWS_AFTER_S = 10.0
"""A failure goes to the journal once, and again when the camera has delivered for so long."""
_FAREWELL_S = 3.0
"""The service manager kills after 10 s, and the faces say farewell too."""

_KINDS: tuple[tuple[type[CameraError], str], ...] = (
    (CameraNotFoundError, "not found"),
    (CameraBusyError, "busy"),
    (CameraLostError, "lost"),
    (CameraRefusedError, "refused"),
)


async def grab(
    camera: Camera, inbox: Inbox, component: Component, setter: ExposureSetter | None = None
) -> None:
    """Deliver a camera's frames to the inbox until cancelled or until the source is at its end.

    A camera that fails is closed and opened again, for ever. Without a ``setter`` its exposure is left alone.
    """
    report = _Report(component, camera.waits)
    grabber = _Grabber(camera, inbox, report, setter, asyncio.get_running_loop(), component.clock)
    thread = threading.Thread(target=grabber.run, name=f"camera-{camera.name}", daemon=True)
    thread.start()
    try:
        while not await _set_within(grabber.done, _LOOK_EVERY_S):
            report.look(component.clock.monotonic_ns())
    finally:
        grabber.stop.set()
        if not grabber.done.is_set():
            inbox.close()
        # The thread may sit in a driver's call; it is a daemon, so a dead camera cannot keep the process.
        await asyncio.shield(asyncio.to_thread(thread.join, _FAREWELL_S))
    if grabber.failure is not None:
        raise grabber.failure


async def _set_within(event: asyncio.Event, seconds: float) -> bool:
    """Whether an event is set before ``seconds`` are over."""
    try:
        async with asyncio.timeout(seconds):
            await event.wait()
    except TimeoutError:
        return False
    return True


def _in_words(error: CameraError) -> str:
    kind = next((word for known, word in _KINDS if isinstance(error, known)), "")
    return f"{kind}: {error}" if kind else str(error)


class _Report:
    """What the thread has to tell, as the camera's health; in the loop only.

    ``now_ns`` is the component's clock at the event, as the thread read it.
    """

    def __init__(self, component: Component, waits: bool) -> None:
        self._component = component
        self._waits = waits
        """The source waits until its frame is taken: then it is no fault that none follows."""
        self._open = False
        self._late = False
        self._heard_ns = 0
        self._frame_ns = component.clock.monotonic_ns()
        """When the last frame came; before the first, when the camera was first wanted."""
        self._losses: deque[tuple[int, int]] = deque()
        self._mistimed: tuple[str, int] | None = None
        self._refusal = ""
        self._logged_refusal = ""

    def opened(self, now_ns: int) -> None:
        """The camera was opened; it is well with its first frame."""
        self._open, self._late, self._heard_ns = True, True, now_ns
        self._refusal = ""

    def frame(self, now_ns: int, lost: int) -> None:
        """A frame came, and ``lost`` before it did not."""
        self._came(now_ns)
        self._component.count("frames")
        if lost:
            self._component.count("lost", lost)
            self._losses.append((now_ns, lost))
        self._say(now_ns)

    def mistimed(self, now_ns: int, sentence: str) -> None:
        """A frame came whose time cannot be true; it is not measured."""
        self._came(now_ns)
        self._mistimed = sentence, now_ns
        self._component.count("mistimed")
        self._say(now_ns)

    def timeout(self, now_ns: int) -> None:
        """No frame came in time; the driver is well."""
        self._late, self._heard_ns = True, now_ns
        self._say_silent()

    def refused(self, refusal: str) -> None:
        """The camera does not take an exposure; it goes on with what it has. Empty: it took the next one."""
        if refusal:
            self._component.count("refused_exposures")
            if refusal != self._logged_refusal:
                self._logged_refusal = refusal
                log.warning("%s: exposure refused: %s", self._component.name, refusal)
        self._refusal = refusal

    def failed(self, sentence: str) -> None:
        """The camera was closed, or never open."""
        self._open = False
        self._losses.clear()
        self._component.say(State.FAILED, f"{sentence}; trying again")
        self._component.count("failures")

    def ended(self, sentence: str) -> None:
        """The source is at its end."""
        self._open = False
        self._component.say(State.ENDED, sentence)

    def look(self, now_ns: int) -> None:
        """Time has passed: losses are forgotten, and a driver that is held in a call is seen."""
        if not self._open:
            return
        if now_ns - self._heard_ns > _HELD_AFTER_S * 1e9 and not self._waits:
            self._late = True
            self._say_silent("the driver does not return; ")
        elif not self._late:
            self._say(now_ns)

    def _came(self, now_ns: int) -> None:
        self._late, self._heard_ns, self._frame_ns = False, now_ns, now_ns

    def _say_silent(self, why: str = "") -> None:
        frame_ns = self._frame_ns
        self._component.say(
            State.DEGRADED, lambda now_ns: f"{why}no frame for {duration((now_ns - frame_ns) * 1e-9)}"
        )

    def _say(self, now_ns: int) -> None:
        oldest_ns = now_ns - _LOSSES_FOR_S * 1e9
        while self._losses and self._losses[0][0] < oldest_ns:
            self._losses.popleft()
        complaints = []
        if self._losses:
            complaints.append(f"{sum(lost for _, lost in self._losses)} frames lost in the last second")
        if self._mistimed and self._mistimed[1] >= oldest_ns:
            complaints.append(f"not measured: {self._mistimed[0]}")
        if self._refusal:
            complaints.append(f"exposure refused: {self._refusal}")
        self._component.say(State.DEGRADED if complaints else State.OK, "; ".join(complaints))


class _Grabber:
    """The thread's side; it speaks to the loop only through ``call_soon_threadsafe``."""

    def __init__(
        self,
        camera: Camera,
        inbox: Inbox,
        report: _Report,
        setter: ExposureSetter | None,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self.stop = threading.Event()
        self.done = asyncio.Event()
        self.failure: BaseException | None = None
        self._camera = camera
        self._inbox = inbox
        self._report = report
        self._setter = setter
        self._loop = loop
        self._clock = clock
        self._delivered = False

    def run(self) -> None:
        try:
            self._grab_for_ever()
        except CameraEndedError as error:
            self._call(self._report.ended, str(error))
        except BaseException as error:
            self.failure = error
        finally:
            self._call(self.done.set)

    def _grab_for_ever(self) -> None:
        retry_s, failed_s, told = _FIRST_RETRY_S, time.monotonic(), set[str]()
        while not self.stop.is_set():
            self._delivered = False
            try:
                self._camera.open()
                self._call(self._report.opened, self._clock.monotonic_ns())
                self._deliver()
            except CameraEndedError:
                raise
            except CameraError as error:
                sentence = _in_words(error)
                now_s = time.monotonic()
                if now_s - failed_s > _NEWS_AFTER_S and self._delivered:
                    told.clear()
                if sentence not in told:
                    told.add(sentence)
                    log.warning("camera %s: %s; trying again", self._camera.name, sentence)
                self._call(self._report.failed, sentence)
            finally:
                self._camera.close()
            if self._delivered:
                retry_s = _FIRST_RETRY_S
            failed_s = time.monotonic()
            self.stop.wait(retry_s)
            retry_s = min(2 * retry_s, _LONGEST_RETRY_S)

    def _deliver(self) -> None:
        last: int | None = None
        stamps = StampCheck()
        if self._setter is not None:
            self._setter.opened(self._camera)
        while not self.stop.is_set():
            if self._setter is not None and (refusal := self._setter.set(self._camera)) is not None:
                self._call(self._report.refused, refusal)
            try:
                frame = self._camera.next_frame(GRAB_TIMEOUT_S)
            except CameraTimeoutError:
                self._call(self._report.timeout, self._clock.monotonic_ns())
                continue
            except CameraMistimedError as error:
                last = error.sequence
                self._call(self._report.mistimed, self._clock.monotonic_ns(), str(error))
                continue
            lost = 0 if last is None else max(frame.sequence - last - 1, 0)
            last = frame.sequence
            self._delivered = True
            if not self._camera.waits and (sentence := stamps.refusal(frame, time.monotonic_ns())):
                self._call(self._report.mistimed, self._clock.monotonic_ns(), sentence)
                continue
            if self._setter is not None:
                frame = self._setter.marked(frame)
            self._call(self._report.frame, self._clock.monotonic_ns(), lost)
            self._inbox.put(frame, wait=self._camera.waits)

    def _call(self, function: Callable[..., object], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            self.stop.set()  # the loop is closed: the process is going down
