"""One thread per camera acquires its frames: it makes the blocking calls.

The thread does nothing else. So a camera is triggered, stamped and emptied in time, however long the
measurement of a frame takes, and the event loop is never blocked.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.camera_report import CameraReport, Deliveries
from altd.ports import (
    AutomaticCamera,
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
from altd.records import Frame
from altd.runtime.supervision import Limits, Works, keep_device
from altd.runtime.threads import NO_LIMIT_S, DeviceThread
from altd.status.health import CameraTrouble, Component

_MAX_AHEAD_NS = 100_000_000
"""Maximum lead of a frame's time over the clock. Some drivers stamp a frame with its planned end and deliver
it earlier (the kernel's vivid, by nearly a period). The exposure time may not be known exactly either."""
MAX_AGE_S = 2.0
"""Maximum age of a frame; an older one was buffered while computer or process stopped: its beam is old."""


class StampCheck:
    """Refuses frames of one camera whose time is in the future, too old, or out of order.

    A refused frame does not count for the order: one wrong time costs one frame.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def refusal(self, frame: Frame, now_ns: int) -> str:
        """Return why the frame's time cannot be true, as text; empty if it can."""
        ahead_s = (frame.t_ns - now_ns) * 1e-9
        if frame.t_ns > now_ns + _MAX_AHEAD_NS:
            return f"exposure {frame.sequence} is stamped {ahead_s:.3f} s ahead of the clock"
        if -ahead_s > MAX_AGE_S:
            return f"exposure {frame.sequence} is {-ahead_s:.3f} s old"
        if self._last_ns is not None and frame.t_ns <= self._last_ns:
            back_s = (self._last_ns - frame.t_ns) * 1e-9
            return f"exposure {frame.sequence} is stamped {back_s:.3f} s before the one before it"
        self._last_ns = frame.t_ns
        return ""


FRAME_TIMEOUT_S = 0.25
_REPORT_INTERVAL_S = 0.25
_HEARTBEAT_S = 3.0
"""Maximum silence of a camera, checked every ``_REPORT_INTERVAL_S``: the loop may be blocked for a second."""
_LIMITS = Limits(0.2, 0.5, close_s=3.0)
"""A camera that returns must be measured again within 2 s, of which half a window of exposures takes 0.5 s.

The end waits up to 3 s for its thread: the service manager kills after 10 s, and the interfaces end too.
"""

_TROUBLES: dict[type[Exception], tuple[str, CameraTrouble]] = {
    CameraNotFoundError: ("not found: ", CameraTrouble.NOT_FOUND),
    CameraBusyError: ("busy: ", CameraTrouble.BUSY),
    CameraLostError: ("lost: ", CameraTrouble.LOST),
    CameraRefusedError: ("refused: ", CameraTrouble.REFUSED),
}


class FrameSink(Protocol):
    """Receiver of a camera's frames, called in the camera's thread."""

    def put(self, frame: Frame, wait: bool) -> None:
        """Take a frame; with ``wait`` block the thread until there is room, so that nothing is dropped."""

    def close(self) -> None:
        """Release a waiting thread."""


async def acquire(
    camera: Camera, sink: FrameSink, component: Component, exposure: ExposureControl | None = None
) -> None:
    """Deliver a camera's frames until cancelled or until the source ends.

    A camera that fails is reopened indefinitely. Without ``exposure`` the camera's exposure is not set.
    Raises exceptions of the driver other than CameraError.
    """
    report = CameraReport(component, camera.waits)
    component.expect(_HEARTBEAT_S)
    acquirer = _Acquirer(camera, sink, report, exposure, component.clock)
    keeping = asyncio.create_task(
        keep_device(acquirer, acquirer.use, acquirer.fail, _LIMITS, component), name=component.name
    )
    try:
        while not (await asyncio.wait({keeping}, timeout=_REPORT_INTERVAL_S))[0]:
            component.is_alive()
            report.update(acquirer.deliveries)
            if exposure is not None:
                report.show(exposure.figures)
    finally:
        acquirer.stop.set()
        if not keeping.done():
            sink.close()
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        report.count(acquirer.deliveries)
    try:
        keeping.result()
    except CameraEndedError as error:
        report.ended(acquirer.deliveries, str(error))


class _Acquirer:
    """The thread's part. It replaces ``deliveries``; other reports go through ``call_soon_threadsafe``."""

    def __init__(
        self,
        camera: Camera,
        sink: FrameSink,
        report: CameraReport,
        exposure: ExposureControl | None,
        clock: Clock,
    ) -> None:
        self.stop = threading.Event()
        now_ns = clock.monotonic_ns()
        self.deliveries = Deliveries(now_ns, now_ns)
        self._camera = camera
        self._sink = sink
        self._report = report
        self._exposure = exposure
        self._clock = clock
        self._loop = asyncio.get_running_loop()

    def open(self) -> None:
        """Leave it to ``use``: no frame of an opened camera may wait for the loop."""

    def close(self) -> None:
        self._camera.close()

    async def use(self, thread: DeviceThread, works: Works) -> None:
        await thread.call(self._deliver, works, within_s=NO_LIMIT_S)

    def fail(self, error: Exception, _: int) -> str:
        if isinstance(error, CameraEndedError) or not isinstance(error, CameraError):
            raise error
        word, trouble = _TROUBLES.get(type(error), ("", None))
        self._report.failed(self.deliveries, sentence := f"{word}{error}", trouble)
        return sentence

    def _deliver(self, works: Works) -> None:
        """Open the camera and deliver its frames, until it fails or its source ends."""
        self._camera.open()
        exposure = self._exposure
        self._note(is_fresh=False, is_late=False)
        automatic = self._camera.automatic if isinstance(self._camera, AutomaticCamera) else ()
        self._call_in_loop(self._report.opened, automatic)
        last: int | None = None
        stamps = StampCheck()
        if exposure is not None:
            exposure.opened(self._camera)
        while not self.stop.is_set():
            if exposure is not None and exposure.is_due:
                self._call_in_loop(self._report.exposure_set, exposure.apply(self._camera))
            try:
                frame = self._camera.next_frame(FRAME_TIMEOUT_S)
            except CameraTimeoutError:
                self._note(is_fresh=False, is_late=True)
                self._call_in_loop(self._report.update, self.deliveries)
                continue
            except CameraMistimedError as error:
                last = error.sequence
                self._count(mistimed=1, remark=str(error))
                continue
            lost = 0 if last is None else max(frame.sequence - last - 1, 0)
            last = frame.sequence
            works()
            if not self._camera.waits and (sentence := stamps.refusal(frame, self._clock.monotonic_ns())):
                self._count(mistimed=1, remark=sentence)
                continue
            if exposure is not None:
                frame = exposure.mark(frame)
            self._count(frames=1, lost=lost, remark=self.deliveries.remark)
            self._sink.put(frame, wait=self._camera.waits)

    def _count(self, *, frames: int = 0, lost: int = 0, mistimed: int = 0, remark: str) -> None:
        """Count a frame and the ``lost`` ones before it; a mistimed one is not measured."""
        before = self.deliveries
        self._note(
            frame_ns=self._clock.monotonic_ns(),
            frames=before.frames + frames,
            lost=before.lost + lost,
            mistimed=before.mistimed + mistimed,
            remark=remark,
            is_fresh=True,
            is_late=False,
        )

    def _note(self, **changes: Any) -> None:
        self.deliveries = replace(self.deliveries, returned_ns=self._clock.monotonic_ns(), **changes)

    def _call_in_loop(self, function: Callable[..., object], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            self.stop.set()  # the loop is closed: the process is ending
