"""A Video4Linux camera that implements the camera port."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

from altd.devices.counting import FrameCounter
from altd.devices.pixels import PIXEL_FORMATS
from altd.devices.v4l2 import V4l2CameraSettings, abi
from altd.devices.v4l2.controls import (
    MANUAL_EXPOSURE,
    Control,
    automatic_modes,
    controls_of,
    set_controls,
    switch_off,
)
from altd.devices.v4l2.image import Layout, Stamp, middle_of_exposure_ns
from altd.devices.v4l2.node import VideoNode
from altd.devices.v4l2.stream import Stream, set_format, set_rate
from altd.ports import (
    CameraBusyError,
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    CameraRefusedError,
    CameraTimeoutError,
    ExposureRange,
)
from altd.records import CameraIdentity, Frame, Origin

_EXPOSURE_UNIT_MS = 0.1
_KEEP_RATE = 0


@dataclass(frozen=True, slots=True)
class ExposureTime:
    """``V4L2_CID_EXPOSURE_ABSOLUTE``, in units of 100 µs, and the automatic controls that override it.

    ``V4L2_CID_EXPOSURE`` is not used, because it counts lines or another unit of the driver. Gain controls
    are not used, because they have no unit.
    """

    time: Control
    automatic: Control | None
    may_slow_down: Control | None

    @classmethod
    def of(cls, controls: Iterable[Control]) -> Self | None:
        """Create from a camera's controls; None when its exposure cannot be set in milliseconds."""
        by_number = {control.number: control for control in controls}
        time = by_number.get(abi.V4L2_CID_EXPOSURE_ABSOLUTE)
        if time is None or not time.writes or time.maximum < 1:
            return None
        automatic = by_number.get(abi.V4L2_CID_EXPOSURE_AUTO)
        return cls(time, automatic, by_number.get(abi.V4L2_CID_EXPOSURE_AUTO_PRIORITY))

    @property
    def range(self) -> ExposureRange:
        """Range from the shortest to the longest exposure, without a gain."""
        return ExposureRange(
            max(1, self.time.minimum) * _EXPOSURE_UNIT_MS, self.time.maximum * _EXPOSURE_UNIT_MS, 0.0, 0.0
        )

    def now_ms(self, node: VideoNode) -> float | None:
        """Current exposure, ms; None while the camera chooses it automatically. Raises OSError."""
        if self.automatic is not None and self.automatic.value(node) != MANUAL_EXPOSURE:
            return None
        return self.time.value(node) * _EXPOSURE_UNIT_MS

    def set(self, node: VideoNode, exposure_ms: float) -> float:
        """Set the nearest possible exposure and return it, ms; raises CameraRefusedError, OSError."""
        if self.automatic is not None and self.automatic.value(node) != MANUAL_EXPOSURE:
            self.automatic.set(node, MANUAL_EXPOSURE)
        if self.may_slow_down is not None and self.may_slow_down.writes:
            self.may_slow_down.set(node, _KEEP_RATE)
        units = self.units(exposure_ms)
        self.time.set(node, units)
        return units * _EXPOSURE_UNIT_MS

    def units(self, exposure_ms: float) -> int:
        """Nearest value that the control accepts."""
        first, step = max(1, self.time.minimum), max(1, self.time.step)
        last = first + (self.time.maximum - first) // step * step
        nearest = first + round((exposure_ms / _EXPOSURE_UNIT_MS - first) / step) * step
        return min(max(nearest, first), last)


_TEST_DRIVERS = ("vivid", "v4l2 loopback")
"""Kernel drivers that generate pictures, or forward those of another program."""
_MAX_SEQUENCE = 2**32 - 1
_OPENING_FAILURES: tuple[tuple[tuple[int, ...], type[CameraError], str], ...] = (
    ((errno.ENOENT, errno.ENODEV, errno.ENXIO), CameraNotFoundError, "there is no such camera now"),
    ((errno.EBUSY,), CameraBusyError, "another program uses the camera"),
    ((errno.EACCES, errno.EPERM), CameraRefusedError, "no permission; it belongs to the group video"),
    ((errno.ENOTTY, errno.EISDIR), CameraRefusedError, "is not a Video4Linux device"),
)


@dataclass(slots=True)
class _Running:
    """Parts of an open camera."""

    node: VideoNode
    layout: Layout
    stream: Stream
    exposure: ExposureTime | None
    exposure_ms: float | None
    automatic: tuple[str, ...]


class V4l2Camera:
    """One camera; see ``altd.ports.Camera``. Its path is resolved again at each opening."""

    def __init__(self, name: str, settings: V4l2CameraSettings) -> None:
        self.name = name
        self.origin = Origin.CAMERA
        self.playback = False
        self.identity: CameraIdentity | None = None
        self.waits = False
        self._settings = settings
        self._counter = FrameCounter(0, _MAX_SEQUENCE)
        self._running: _Running | None = None

    @property
    def exposure_range(self) -> ExposureRange | None:
        """Range of the exposure, where the camera sets it in a unit of time; never a gain."""
        exposure = self._running.exposure if self._running else None
        return exposure.range if exposure else None

    @property
    def automatic(self) -> tuple[str, ...]:
        """Names of automatic modes that stay on although the config does not ask for them."""
        return self._running.automatic if self._running else ()

    def open(self) -> None:
        """Open the camera and start it with the format, rate and controls of the config."""
        self.close()
        with self._typed_opening_failures():
            node = VideoNode(self._settings.device)
            try:
                self._running = self._start(node)
            except BaseException:
                node.close()
                raise
        self.origin = Origin.SIMULATED if node.driver in _TEST_DRIVERS else Origin.CAMERA
        self.identity = CameraIdentity(node.serial, node.card or None, "v4l2")
        self._counter.reopened()

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next whole frame; a damaged one appears as a gap in the numbers."""
        running = self._open_camera()
        deadline_s = time.monotonic() + timeout_s
        with self._typed_losses():
            while buffer := running.stream.take(deadline_s):
                frame = self._frame(running, buffer)
                running.stream.requeue(buffer)
                if frame is not None:
                    return frame
                if time.monotonic() >= deadline_s:  # a driver may deliver damaged frames without end
                    break
        raise CameraTimeoutError(f"{self._settings.device}: no frame within {timeout_s:g} s")

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Set the exposure; the gain is unchanged, because the kernel's has no unit."""
        running = self._open_camera()
        if running.exposure is None:
            raise CameraRefusedError(f"{self._settings.device}: has no exposure in a unit of time")
        with self._typed_losses():
            running.exposure_ms = running.exposure.set(running.node, exposure_ms)

    def close(self) -> None:
        """Release the camera; the kernel ends the stream."""
        running, self._running = self._running, None
        if running is not None:
            running.stream.close()
            running.node.close()

    def _start(self, node: VideoNode) -> _Running:
        settings = self._settings
        if not node.streams:
            raise CameraRefusedError("is not a camera: it streams no frames")
        set_controls(node, settings.controls)  # first: on some cameras they determine the available formats
        layout = set_format(node, settings.width, settings.height, PIXEL_FORMATS[settings.pixel_format])
        set_rate(node, settings.fps, layout)
        exposure = ExposureTime.of(controls_of(node).values())
        for mode in tuple(automatic_modes(node, settings)):
            if exposure is not None or mode.number != abi.V4L2_CID_EXPOSURE_AUTO:  # else nothing would set it
                switch_off(node, mode)
        automatic = tuple(mode.name for mode in automatic_modes(node, settings))
        exposure_ms = exposure.now_ms(node) if exposure else None
        return _Running(node, layout, Stream(node, settings.fps), exposure, exposure_ms, automatic)

    def _open_camera(self) -> _Running:
        if self._running is None:
            raise CameraLostError(f"{self._settings.device}: is not open")
        return self._running

    def _frame(self, running: _Running, buffer: abi.v4l2_buffer) -> Frame | None:
        """Frame in a buffer; None when the driver reports it as damaged, or when it is too short."""
        flags = int(buffer.flags)
        with running.stream.data(buffer) as data:
            if flags & abi.V4L2_BUF_FLAG_ERROR or len(data) < running.layout.frame_bytes:
                return None
            try:
                pixels = running.layout.pixels(data)
            except ValueError:
                return None
        monotonic = flags & abi.V4L2_BUF_FLAG_TIMESTAMP_MASK == abi.V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC
        begun = flags & abi.V4L2_BUF_FLAG_TSTAMP_SRC_MASK == abi.V4L2_BUF_FLAG_TSTAMP_SRC_SOE
        t_ns = middle_of_exposure_ns(
            buffer.timestamp.tv_sec * 1_000_000_000 + buffer.timestamp.tv_usec * 1000,
            "monotonic" if monotonic else "unknown",
            Stamp.START_OF_EXPOSURE if begun else Stamp.END_OF_FRAME,
            (running.exposure_ms or 0.0) + self._settings.readout_ms,
            time.monotonic_ns(),
        )
        return Frame(
            self.name,
            self._counter.number(buffer.sequence),
            t_ns,
            pixels,
            running.layout.pixel_format.bits,
            exposure_ms=running.exposure_ms,
            row_time_us=self._settings.row_time_us,
        )

    @contextlib.contextmanager
    def _typed_opening_failures(self) -> Iterator[None]:
        """Convert the failure of an opening to the CameraError of its kind."""
        with self._typed_losses():
            try:
                yield
            except OSError as error:
                for numbers, kind, why in _OPENING_FAILURES:
                    if error.errno in numbers:
                        raise kind(why) from error
                raise

    @contextlib.contextmanager
    def _typed_losses(self) -> Iterator[None]:
        """Prefix errors with the device; any other OSError is a lost camera, which must be opened again."""
        device = self._settings.device
        try:
            yield
        except (CameraNotFoundError, CameraBusyError, CameraRefusedError) as error:
            raise type(error)(f"{device}: {error}") from error
        except OSError as error:
            raise CameraLostError(f"{device}: {_reason(error)}") from error


def _reason(error: OSError) -> str:
    if error.errno == errno.ENODEV:
        return "the camera is gone"
    if error.errno == errno.EIO:
        return "the driver broke off the stream"
    return os.strerror(error.errno) if error.errno else str(error)
