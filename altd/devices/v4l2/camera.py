"""A Video4Linux camera behind the camera port."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterator

from linuxpy.video.raw import BufferFlag, v4l2_buffer

from altd.config import V4l2Camera as Settings
from altd.devices.counting import FrameCounter
from altd.devices.v4l2.controls import controls_of, set_controls
from altd.devices.v4l2.exposure import ExposureTime
from altd.devices.v4l2.image import PIXEL_FORMATS, Layout, Stamp, middle_of_exposure_ns
from altd.devices.v4l2.node import Node
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
from altd.records import Frame, Origin

_TEST_DRIVERS = ("vivid", "v4l2 loopback")
"""Drivers of the kernel that make pictures up, or pass on those of another program."""
_LARGEST_SEQUENCE = 2**32 - 1


class V4l2Camera:
    """One camera; see ``altd.ports.Camera``. Its path is followed anew at each opening."""

    def __init__(self, name: str, settings: Settings) -> None:
        self.name = name
        self.origin = Origin.CAMERA
        self.waits = False
        self._settings = settings
        self._counter = FrameCounter(0, _LARGEST_SEQUENCE)
        self._running: _Running | None = None

    @property
    def exposure_range(self) -> ExposureRange | None:
        """What the exposure can be set to, where the camera counts it in a unit of time; never a gain."""
        exposure = self._running.exposure if self._running else None
        return exposure.range if exposure else None

    def open(self) -> None:
        """Take hold of the camera and let it run in the config's format, rate and controls."""
        self.close()
        with self._failing_to_open():
            node = Node(self._settings.device)
            try:
                self._running = self._run(node)
            except BaseException:
                node.close()
                raise
        self.origin = Origin.SIMULATED if node.driver in _TEST_DRIVERS else Origin.CAMERA
        self._counter.reopened()

    def next_frame(self, timeout_s: float) -> Frame:
        """The next whole frame; one that came damaged shows as a gap in the numbers."""
        running = self._open_camera()
        deadline_s = time.monotonic() + timeout_s
        with self._losing():
            while buffer := running.stream.take(deadline_s):
                frame = self._frame(running, buffer)
                running.stream.give_back(buffer)
                if frame is not None:
                    return frame
        raise CameraTimeoutError(f"{self._settings.device}: no frame within {timeout_s:g} s")

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Expose so long; the gain is left alone, for the kernel's has no unit."""
        running = self._open_camera()
        if running.exposure is None:
            raise CameraRefusedError(f"{self._settings.device}: has no exposure in a unit of time")
        with self._losing():
            running.exposure_ms = running.exposure.set(running.node, exposure_ms)

    def close(self) -> None:
        """Let go of the camera; the kernel ends the stream."""
        running, self._running = self._running, None
        if running is not None:
            running.stream.close()
            running.node.close()
