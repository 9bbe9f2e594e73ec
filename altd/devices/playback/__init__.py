"""Cameras that play a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from altd.devices.settings import CameraSettings
from altd.ports import Camera, Clock


class RecordingCameraSettings(CameraSettings):
    """A camera that plays a recording; every output is marked ``playback``. Made by `altd record`."""

    driver: Literal["recording"]
    path: Path
    """Folder of the recording."""
    pace: Literal["realtime", "fast"] = "realtime"
    """``realtime`` keeps the recording's times, ``fast`` does not wait."""
    repeat: bool = False
    """Start again at the end."""

    def camera(self, name: str, clock: Clock, shared: dict[object, Any]) -> Camera:
        """Return a camera of the recording; raises BadInputError that names the recording."""
        from altd.devices.playback.player import Playback, PlaybackCamera
        from altd.recording.reader import open_recording

        if self.path not in shared:
            recording, in_real_time = open_recording(self.path), self.pace == "realtime"
            shared[self.path] = Playback(recording, clock, in_real_time, self.repeat)
        return PlaybackCamera(name, shared[self.path])
