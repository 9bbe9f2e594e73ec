"""One thread per camera: blocking grabs, re-opening after a loss, never a block in the loop."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable

from altd.ports import Camera, CameraEndedError, CameraError, CameraTimeoutError
from altd.service.health import Component, State
from altd.service.inbox import Inbox

log = logging.getLogger("altd")

GRAB_TIMEOUT_S = 0.25
_FIRST_RETRY_S = 0.2
_LONGEST_RETRY_S = 5.0
_FAREWELL_S = 3.0


async def grab(camera: Camera, inbox: Inbox, component: Component) -> None:
    """Deliver a camera's frames to the inbox until cancelled or until the source is at its end.

    A camera that fails is closed and opened again, more and more rarely, for ever.
    """
    grabber = _Grabber(camera, inbox, component, asyncio.get_running_loop())
    thread = threading.Thread(target=grabber.run, name=f"camera-{camera.name}", daemon=True)
    thread.start()
    try:
        await grabber.done.wait()
    finally:
        grabber.stop.set()
        if not grabber.done.is_set():
            inbox.close()
        # The thread may sit in a driver's call; it is a daemon, so a dead camera cannot keep the process.
        await asyncio.shield(asyncio.to_thread(thread.join, _FAREWELL_S))
    if grabber.failure is not None:
        raise grabber.failure


class _Grabber:
    """The thread's side; it speaks to the loop only through ``call_soon_threadsafe``."""

    def __init__(
        self, camera: Camera, inbox: Inbox, component: Component, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.stop = threading.Event()
        self.done = asyncio.Event()
        self.failure: BaseException | None = None
        self._camera = camera
        self._inbox = inbox
        self._component = component
        self._loop = loop

    def run(self) -> None:
        try:
            self._grab_for_ever()
        except CameraEndedError as error:
            self._say(State.ENDED, str(error))
        except BaseException as error:
            self.failure = error
        finally:
            self._call(self.done.set)

    def _grab_for_ever(self) -> None:
        retry_s, told = _FIRST_RETRY_S, ""
        while not self.stop.is_set():
            try:
                self._camera.open()
                self._deliver()
            except CameraEndedError:
                raise
            except CameraError as error:
                if str(error) != told:
                    told = str(error)
                    log.warning("camera %s: %s; trying again", self._camera.name, error)
                self._say(State.FAILED, f"{error}; trying again")
                self._count("failures")
                self.stop.wait(retry_s)
                retry_s = min(2 * retry_s, _LONGEST_RETRY_S)
            else:
                retry_s = _FIRST_RETRY_S
            finally:
                self._camera.close()

    def _deliver(self) -> None:
        well = False
        while not self.stop.is_set():
            try:
                frame = self._camera.next_frame(GRAB_TIMEOUT_S)
            except CameraTimeoutError:
                if well:
                    self._say(State.DEGRADED, f"no frame for {GRAB_TIMEOUT_S} s")
                well = False
                continue
            if not well:
                self._say(State.OK)
            well = True
            self._count("frames")
            self._inbox.put(frame, wait=self._camera.waits)

    def _say(self, state: State, message: str = "") -> None:
        self._call(self._component.say, state, message)

    def _count(self, counter: str) -> None:
        self._call(self._component.count, counter)

    def _call(self, function: Callable[..., object], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            self.stop.set()  # the loop is closed: the process is going down
