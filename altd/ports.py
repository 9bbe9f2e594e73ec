"""What the unit needs of the outside, as protocols; drivers and simulators stand behind them."""

from __future__ import annotations

from datetime import datetime
from typing import Protocol

from altd.records import Frame, Origin


class CameraError(Exception):
    """A camera that cannot deliver; the service closes it, says so and opens it again."""


class CameraTimeoutError(CameraError):
    """No frame came in time; the camera stays open."""


class CameraEndedError(CameraError):
    """The source is at its end and will not deliver again (a recording that was played)."""


class Camera(Protocol):
    """A source of frames. The calls block and are made from one thread that belongs to this camera."""

    @property
    def name(self) -> str:
        """The name under which the config and the frames know this camera."""

    @property
    def origin(self) -> Origin:
        """Where the frames come from; what is not a camera is marked in every output."""

    @property
    def waits(self) -> bool:
        """Whether the source waits until a frame was taken; otherwise an untaken frame is dropped."""

    def open(self) -> None:
        """Get ready to deliver; raises CameraError."""

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame, waiting at most ``timeout_s``; raises CameraError or one of its kinds."""

    def close(self) -> None:
        """Let go of the camera; harmless when it is not open."""


class Clock(Protocol):
    """Time, so that a test can run an hour in a second."""

    def monotonic_ns(self) -> int:
        """The clock on which frames are stamped."""

    def utc(self, t_ns: int) -> datetime | None:
        """The UTC of an instant on the monotonic clock; None when it is not known."""

    async def sleep(self, seconds: float) -> None:
        """Let ``seconds`` pass on this clock."""
