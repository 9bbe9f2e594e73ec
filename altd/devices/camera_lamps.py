"""Frame LEDs, and glasses of a row, on output lines of cameras."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from altd.devices.settings import DeviceTable, Visits
from altd.errors import BadInputError
from altd.files.table import Name
from altd.ports import Camera, CameraError, Lamps, LampsError, Switches, SwitchingCamera


class CameraLampsSettings(DeviceTable):
    """Frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue).

    Instead of the table above.
    """

    driver: Literal["camera"]
    cameras: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Cameras whose output switches LEDs; all are switched together."""
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of the output line."""

    def lamps(self, cameras: Mapping[str, Camera], place: Path, alone: bool = False) -> Lamps:
        """Return the lamps; raises BadInputError that names ``place`` for a camera without outputs."""
        return CameraLamps(_switching(cameras, self.cameras, place, "lamps"), self.line, alone)


class CameraSwitchesSettings(Visits):
    """Voltage of the glasses, switched by an output line of each switched target's own camera.

    Instead of the table above.
    """

    driver: Literal["camera"]
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of the output line; on: the glass has voltage and is clear."""

    def switches(self, camera_of: Mapping[str, str], cameras: Mapping[str, Camera], place: Path) -> Switches:
        """Return the switches of targets with these cameras; raises BadInputError as ``lamps``."""
        switching = _switching(cameras, camera_of.values(), place, "switches")
        return CameraSwitches(switching, camera_of, self.line)


def _switching(
    cameras: Mapping[str, Camera], names: Iterable[str], place: Path, table: str
) -> dict[str, SwitchingCamera]:
    switching = {}
    for name in names:
        camera = cameras[name]
        if not isinstance(camera, SwitchingCamera):
            raise BadInputError(place, f"{table}: camera {name!r} has no output to switch")
        switching[name] = camera
    return switching


class CameraLamps:
    """See ``altd.ports.Lamps``: one output line of each camera, all switched together.

    The code that reads the cameras' frames opens and closes the cameras; with ``alone``, this driver does. A
    camera that is not open or was lost raises a LampsError that names it.
    """

    def __init__(self, cameras: Mapping[str, SwitchingCamera], line: str, alone: bool = False) -> None:
        self._cameras = dict(cameras)
        self._line = line
        self._alone = alone

    def open(self) -> None:
        """Switch the LEDs off, whatever their state was; raises LampsError."""
        if self._alone:
            self._each(lambda camera: camera.open())
        self.switch(False)

    def switch(self, on: bool) -> None:
        """Switch all LEDs on or off; raises LampsError."""
        self._each(lambda camera: camera.switch_output(self._line, on))

    def close(self) -> None:
        """Switch off the LEDs of the cameras that still respond."""
        with contextlib.suppress(LampsError):
            self.switch(False)
        if self._alone:
            for camera in self._cameras.values():
                camera.close()

    def _each(self, act: Callable[[SwitchingCamera], None]) -> None:
        _act_on_each(self._cameras, self._line, lambda _, camera: act(camera))


class CameraSwitches:
    """See ``altd.ports.Switches``: output line of each target's camera; on means voltage on its glass.

    The code that reads the cameras' frames opens and closes the cameras. ``camera_of`` maps targets to
    cameras.
    """

    def __init__(
        self, cameras: Mapping[str, SwitchingCamera], camera_of: Mapping[str, str], line: str
    ) -> None:
        self._cameras = dict(cameras)
        self._camera_of = dict(camera_of)
        self._line = line

    def open(self) -> None:
        """Switch off the voltage of all glasses; raises LampsError."""
        self.show("")

    def show(self, opaque: str) -> None:
        """Apply voltage to all glasses but this one; empty: to none. Raises LampsError."""
        without = self._camera_of.get(opaque)
        _act_on_each(
            self._cameras,
            self._line,
            lambda name, camera: camera.switch_output(self._line, bool(opaque) and name != without),
        )

    def close(self) -> None:
        """Switch off the voltage of the glasses whose cameras still respond."""
        with contextlib.suppress(LampsError):
            self.show("")


def _act_on_each(
    cameras: Mapping[str, SwitchingCamera], line: str, act: Callable[[str, SwitchingCamera], None]
) -> None:
    """Act on every camera, even after one has failed."""
    complaints = []
    for name, camera in cameras.items():
        try:
            act(name, camera)
        except CameraError as error:
            complaints.append(f"{line} of camera {name}: {error}")
    if complaints:
        raise LampsError("; ".join(complaints))
