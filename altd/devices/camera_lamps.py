"""Frame LEDs on the output lines of cameras."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping

from altd.ports import CameraError, LampsError, SwitchingCamera


class CameraLamps:
    """See ``altd.ports.Lamps``: one output line of each camera, all switched together.

    The code that takes the cameras' frames opens and closes them; with ``alone`` this driver does. A camera
    that is not open, or was lost, is a LampsError that names it.
    """

    def __init__(self, cameras: Mapping[str, SwitchingCamera], line: str, alone: bool = False) -> None:
        self._cameras = dict(cameras)
        self._line = line
        self._alone = alone

    def open(self) -> None:
        """Darken the LEDs, whatever they were before; raises LampsError."""
        if self._alone:
            self._each(lambda camera: camera.open())
        self.switch(False)

    def switch(self, on: bool) -> None:
        """Light or darken all LEDs; raises LampsError."""
        self._each(lambda camera: camera.switch_output(self._line, on))

    def close(self) -> None:
        """Darken the LEDs of the cameras that are still there."""
        with contextlib.suppress(LampsError):
            self.switch(False)
        if self._alone:
            for camera in self._cameras.values():
                camera.close()

    def _each(self, act: Callable[[SwitchingCamera], None]) -> None:
        """Act on every camera, on those too that come after one that fails."""
        complaints = []
        for name, camera in self._cameras.items():
            try:
                act(camera)
            except CameraError as error:
                complaints.append(f"{self._line} of camera {name}: {error}")
        if complaints:
            raise LampsError("; ".join(complaints))
