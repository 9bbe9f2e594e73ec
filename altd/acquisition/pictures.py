"""The newest frame of each camera and its result, as a picture for display.

Frames are encoded only if there is a viewer, once for all viewers, and at most at ``MAX_RATE_HZ``.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from altd.measuring.calibration import TargetCalibration
from altd.ports import Clock
from altd.records import FloatArray, Frame, NoSpot, Spot, SpotShape
from altd.runtime.threads import DeviceThread
from altd.status.services import NoPictureError, Picture, Points, SpotContour, TargetView

MAX_RATE_HZ = 10.0
"""Maximum number of pictures per camera and second."""
MAX_WIDTH_PX = 800
_JPEG_QUALITY = 75
_ENCODE_TIMEOUT_S = 2.0
_END_TIMEOUT_S = 1.0
_POINTS_PER_EDGE = 8
"""Number of points per edge of the outline: lenses bend straight edges."""
_SHADES = np.round(255 * np.sqrt(np.arange(256) / 255)).astype(np.uint8)
"""Displayed brightness, its square root: the target's print and frame are far darker than the spot."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    number: int
    frame: Frame
    spot: Spot | NoSpot | str


class Pictures:
    """Encodes each camera's frames. ``views`` has the data of the targets' calibration, in beam order."""

    def __init__(self, views: Sequence[TargetView], clock: Clock) -> None:
        self._clock = clock
        self._targets = {view.camera: view.target for view in views}
        self._views = tuple(views)
        self._newest: dict[str, _Seen] = {}
        self._made: dict[str, asyncio.Task[Picture]] = {}
        """Task of the last picture of each camera, done or running."""
        self._made_of: dict[str, tuple[int, int]] = {}
        """Number of the last picture's frame and start time of its encoding, ns, by camera."""
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._looking = threading.Event()
        """Whether a viewer waits for a frame."""
        self._thread: DeviceThread | None = None

    @property
    def views(self) -> Sequence[TargetView]:
        """The targets, in beam order."""
        return self._views

    def put(self, frame: Frame, spot: Spot | NoSpot | str) -> None:
        """Take a frame and its result, from the thread that located it."""
        last = self._newest.get(frame.camera)
        self._newest[frame.camera] = _Seen(last.number + 1 if last else 1, frame, spot)
        if self._looking.is_set():
            self._looking.clear()
            try:
                self._loop.call_soon_threadsafe(self._arrived.set)
            except RuntimeError:
                return  # the loop is closed: the process is ending

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        """Wait for and return the newest picture of each target with a number above that in ``seen``."""
        while True:
            self._arrived.clear()
            self._looking.set()
            ready = [each for each in self._newest.values() if each.number > self._seen_of(each, seen)]
            if ready and (wait_s := self._wait_s(ready)) <= 0:
                return await asyncio.gather(*(self._picture(each) for each in ready))
            if ready:
                await self._clock.sleep(wait_s)
            else:
                await self._arrived.wait()

    async def run(self) -> None:
        """Provide the encoding thread until cancelled."""
        self._thread = thread = DeviceThread("pictures")
        try:
            await asyncio.Event().wait()
        finally:
            self._thread = None
            for made in self._made.values():
                made.cancel()
            await asyncio.gather(*self._made.values(), return_exceptions=True)
            await thread.end(lambda: None, _END_TIMEOUT_S)

    def _seen_of(self, newest: _Seen, seen: dict[str, int]) -> int:
        return seen.get(self._targets[newest.frame.camera], 0)

    def _wait_s(self, ready: Sequence[_Seen]) -> float:
        """Return the time until these may be encoded, s; pictures already encoded need no wait."""
        now_ns = self._clock.monotonic_ns()
        begun = [
            begun_ns
            for each in ready
            for number, begun_ns in [self._made_of.get(each.frame.camera, (0, 0))]
            if number and number < each.number
        ]
        return max(begun, default=now_ns - 10**10) * 1e-9 + 1 / MAX_RATE_HZ - now_ns * 1e-9

    async def _picture(self, seen: _Seen) -> Picture:
        camera = seen.frame.camera
        if self._made_of.get(camera, (0, 0))[0] != seen.number:
            self._made_of[camera] = seen.number, self._clock.monotonic_ns()
            self._made[camera] = made = asyncio.create_task(self._encoded(seen), name=f"picture {camera}")
            made.add_done_callback(lambda _: made.cancelled() or made.exception())  # it may never be awaited
        return await asyncio.shield(self._made[camera])

    async def _encoded(self, seen: _Seen) -> Picture:
        target = self._targets[seen.frame.camera]
        if self._thread is None:
            raise NoPictureError("the unit starts or ends")
        try:
            return await self._thread.call(partial(_picture_of, target, seen), within_s=_ENCODE_TIMEOUT_S)
        except (TimeoutError, cv2.error) as error:
            raise NoPictureError(f"the frame of {target} cannot be encoded") from error


def _picture_of(target: str, seen: _Seen) -> Picture:
    frame, found = seen.frame, seen.spot
    image = _image(frame)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        raise NoPictureError(f"the frame of {target} cannot be encoded")
    return Picture(
        target,
        seen.number,
        frame.sequence,
        frame.t_ns,
        image.shape[1],
        image.shape[0],
        contour_of(found) if isinstance(found, Spot) else None,
        _words(target, found),
        frame.leds_on,
        data.tobytes(),
    )


def _words(target: str, found: Spot | NoSpot | str) -> str:
    """Return the result as text if it is not a spot; else empty."""
    if isinstance(found, str):
        return found
    return str(found.fault(target)) if isinstance(found, NoSpot) else ""


def _image(frame: Frame) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return the frame in 8 bits, at most ``MAX_WIDTH_PX`` wide."""
    rows, columns = frame.pixels.shape
    pixels = np.asarray(frame.pixels)
    if columns > MAX_WIDTH_PX:
        size = MAX_WIDTH_PX, max(round(rows * MAX_WIDTH_PX / columns), 1)
        pixels = np.asarray(cv2.resize(frame.pixels, size, interpolation=cv2.INTER_AREA))
    dark = np.right_shift(pixels, frame.bits - 8).astype(np.uint8)
    return np.asarray(cv2.LUT(dark, _SHADES), dtype=np.uint8)


def contour_of(spot: Spot) -> SpotContour:
    """Return the ellipse at 1/e² of a spot's peak; a circle if its shape was not fitted."""
    semi_px = spot.diameter_px / 2
    axes = (semi_px, semi_px, 0.0) if spot.shape is None else _axes(spot.shape)
    return SpotContour(spot.u_px, spot.v_px, *axes)


def _axes(shape: SpotShape) -> tuple[float, float, float]:
    """Return the semi-axes, px, and the major one's angle, degrees, of q = 2^(1/order) (``SpotShape``)."""
    mean, half = (shape.a + shape.c) / 2, math.hypot((shape.a - shape.c) / 2, shape.b)
    twice_q = 2 * 2 ** (1 / shape.order)
    turn_deg = math.degrees(math.atan2(-2 * shape.b, shape.c - shape.a)) / 2
    return math.sqrt(twice_q / (mean - half)), math.sqrt(twice_q / (mean + half)), turn_deg


def view_of(camera: str, target: TargetCalibration) -> TargetView:
    """Return the view of a target's camera from its calibration."""
    size = target.width, target.height
    return outlined(target.name, camera, size, target.map.hull_mm, target.map.to_px, target.leds_px)


def outlined(
    target: str,
    camera: str,
    size: tuple[int, int],
    hull_mm: FloatArray,
    to_px: Callable[[FloatArray], FloatArray],
    leds_px: FloatArray,
) -> TargetView:
    """Return a view with the image of an area's outline, ``hull_mm`` (n, 2), and of the axes."""
    share = (np.arange(_POINTS_PER_EDGE) / _POINTS_PER_EDGE)[:, None]
    edges = [
        here + share * (there - here)
        for here, there in zip(hull_mm, np.roll(hull_mm, -1, axis=0), strict=True)
    ]
    outline = to_px(np.concatenate(edges))
    about_mm = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    middle, right, up = to_px(about_mm)
    (middle_px,), (x_axis, y_axis) = _points(middle[None]), _points(np.array([right, up]) - middle)
    return TargetView(
        target,
        camera,
        *size,
        _points(outline),
        _points(leds_px),
        middle_px,
        x_axis,
        y_axis,
    )


def _points(points_px: FloatArray) -> Points:
    return tuple((round(float(u_px), 2), round(float(v_px), 2)) for u_px, v_px in points_px)
