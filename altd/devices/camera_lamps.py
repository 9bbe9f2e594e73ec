"""Frame LEDs, and glasses of a row, on the output lines of cameras."""

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
        _act_on_each(self._cameras, self._line, lambda _, camera: act(camera))


class CameraSwitches:
    """See ``altd.ports.Switches``: the output line of each target's camera, on: its glass has voltage.

    The code that takes the cameras' frames opens and closes them. ``camera_of`` names that of each target.
    """

    def __init__(
        self, cameras: Mapping[str, SwitchingCamera], camera_of: Mapping[str, str], line: str
    ) -> None:
        self._cameras = dict(cameras)
        self._camera_of = dict(camera_of)
        self._line = line

    def open(self) -> None:
        """Take the voltage off all glasses; raises LampsError."""
        self.show("")

    def show(self, opaque: str) -> None:
        """Voltage on all glasses but this one; empty: on none. Raises LampsError."""
        without = self._camera_of.get(opaque)
        _act_on_each(
            self._cameras,
            self._line,
            lambda name, camera: camera.switch_output(self._line, bool(opaque) and name != without),
        )

    def close(self) -> None:
        """Take the voltage off the glasses of the cameras that are still there."""
        with contextlib.suppress(LampsError):
            self.show("")


def _act_on_each(
    cameras: Mapping[str, SwitchingCamera], line: str, act: Callable[[str, SwitchingCamera], None]
) -> None:
    """Act on every camera, on those too that come after one that fails."""
    complaints = []
    for name, camera in cameras.items():
        try:
            act(name, camera)
        except CameraError as error:
            complaints.append(f"{line} of camera {name}: {error}")
    if complaints:
        raise LampsError("; ".join(complaints))
