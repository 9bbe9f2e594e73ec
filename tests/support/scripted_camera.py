"""Cameras that do what a test's script says."""

import threading
from dataclasses import replace

import numpy as np

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.config import ExposureSettings
from altd.ports import CameraTimeoutError, ExposureRange
from altd.records import Frame, Origin
from support.clock import FakeClock
from support.frames import Blob, frame, light

PERIOD_S = 0.05
PIXELS = frame(light(Blob(300, 200))).pixels


class ScriptedCamera:
    """Each call of next_frame does what the next line of the script says; then 20 frames a second.

    A number lets so many frames be lost.
    """

    name = "front"
    origin = Origin.CAMERA
    playback = False
    waits = False
    exposure_range = None
    identity = None
    automatic: tuple[str, ...] = ()

    def __init__(self, clock: FakeClock, *script: Exception | str | int) -> None:
        self.clock = clock
        self.script = list(script)
        self.calls: list[str] = []
        self.hang = threading.Event()
        self.number = 0
        self._never = threading.Event()

    def open(self) -> None:
        self.calls.append("open")

    def next_frame(self, timeout_s: float) -> Frame:
        step = self.script.pop(0) if self.script else "frame"
        if isinstance(step, CameraTimeoutError):
            self.clock.wait(self._never, timeout_s)
        if isinstance(step, Exception):
            raise step
        if step == "hang":
            self.clock.hold(self.hang)
        if isinstance(step, int):
            self.number += step
        self.clock.wait(self._never, PERIOD_S)
        self.number += 1
        return Frame("front", self.number, self.clock.monotonic_ns(), PIXELS)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        self.calls.append(f"expose {exposure_ms:g} ms {gain_db:g} dB")

    def close(self) -> None:
        self.calls.append("close")


class LyingCamera(ScriptedCamera):
    """Stamps each frame off by what the next line of the script says, s."""

    def __init__(self, clock: FakeClock, *off_s: float) -> None:
        super().__init__(clock)
        self.off_s = list(off_s)

    def next_frame(self, timeout_s: float) -> Frame:
        frame = super().next_frame(timeout_s)
        off_s = self.off_s.pop(0) if self.off_s else 0.0
        return replace(frame, t_ns=frame.t_ns + round(off_s * 1e9))


class SettableCamera(ScriptedCamera):
    """Uses a setting from the third frame after it on, and writes into the pixels how many ms it had."""

    exposure_range = ExposureRange(1.0, 200.0, 0.0, 0.0)

    def __init__(self, clock: FakeClock, *script: Exception | str | int) -> None:
        super().__init__(clock, *script)
        self.used_ms = 1.0
        self.coming: list[float] = [1.0] * 2
        self.refusal: Exception | None = None

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        super().set_exposure(exposure_ms, gain_db)
        if self.refusal is not None:
            raise self.refusal
        self.used_ms = exposure_ms

    def next_frame(self, timeout_s: float) -> Frame:
        taken = super().next_frame(timeout_s)
        self.coming.append(self.used_ms)
        pixels = np.full((4, 4), round(self.coming.pop(0)), np.uint8)
        return Frame("front", taken.sequence, taken.t_ns, pixels)


class AllFrames:
    """Keeps every frame that was not taken."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def put(self, frame: Frame, wait: bool) -> None:
        self.frames.append(frame)

    def close(self) -> None: ...

    async def take(self, clock: FakeClock) -> list[Frame]:
        """The frames put since the last call; time passes until there is one."""
        await clock.until(lambda: self.frames)
        taken, self.frames = self.frames, []
        return taken


def exposure_of(exposure_ms: float = 10.0) -> ExposureControl:
    return ExposureControl(ExposureSettings(control="fixed", exposure_ms=exposure_ms), 4.0, 20)
