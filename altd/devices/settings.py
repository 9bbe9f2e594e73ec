"""Base of all drivers: their tables of ``altd.toml``, and the search and check before a driver is used.

The package of a driver holds its tables; its other modules are imported only if the driver is used.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from altd.files.table import Table, complaint
from altd.ports import Camera, Clock
from altd.process.machine import Finding, Machine
from altd.records.frames import MAX_ROW_TIME_US

_DETAIL_LETTERS = 102


@dataclass(frozen=True, eq=False)
class Driver:
    """Search and check of a driver's devices before they are used."""

    module: str
    """Module with ``lines()`` and ``check(tables, machine)``, imported only for these."""
    heading: str
    """Heading of its section in ``altd devices``."""
    nodes: tuple[str, ...] = ()
    """Word for a device, and the patterns of its nodes' paths."""
    library: Callable[[bool], Finding] | None = None
    """Checks its library; the argument is whether the config has a table of this driver."""

    def found(self) -> Iterator[str]:
        """Yield the lines of ``altd devices``: settings of the connected devices, and ``details`` of each."""
        try:
            yield from import_module(self.module).lines()
        except ImportError as error:
            yield f"  search failed: {error}"

    def check(self, tables: Mapping[str, Any], machine: Machine) -> Iterator[Finding]:
        """Check the devices of the config's tables of this driver, by the key or the camera's name."""
        yield from import_module(self.module).check(tables, machine)


def details(text: str) -> Iterator[str]:
    """Yield a text below a device of ``altd devices``, in as many lines as it needs."""
    for number, line in enumerate(wrap(text, _DETAIL_LETTERS, break_on_hyphens=False)):
        yield f"{'' if number == 0 else '  '}      {line}"


SERIAL = Driver(
    "altd.devices.nodes",
    "Serial ports: [[serial]], [inclinometer], [stage]",
    ("serial", "/dev/ttyUSB*", "/dev/ttyACM*", "/dev/ttyAMA*", "/dev/ttyS[0-9]*"),
)
"""Serial ports, with any device."""


class DeviceTable(Table):
    """Base of the tables of all drivers."""

    about: ClassVar[Driver | None] = None


class CameraSettings(DeviceTable):
    """Base of all cameras' tables."""

    has_outputs: ClassVar[bool] = False
    """Whether the cameras have output lines for lamps and glasses."""

    @property
    def trigger_input(self) -> str | None:
        """Input line whose signal triggers the camera."""
        return None

    @property
    def software_triggered(self) -> bool:
        """Whether altd triggers the camera."""
        return False

    @property
    def celsius_limits(self) -> tuple[float, float] | None:
        """Temperatures inside the camera between which the unit is in specification, °C."""
        return None

    @abstractmethod
    def camera(self, name: str, clock: Clock, shared: dict[object, Any]) -> Camera:
        """Return the camera, not open; raises BadInputError that names the file or key to correct.

        ``shared`` is empty for the first camera of a config: a driver keeps there what its cameras share.
        """


READOUT_SHARE = 0.1
"""Share of the time between two frames that a camera may need in addition to the exposure."""


class ExposureSettings(Table):
    """Exposure and gain of one camera."""

    control: Literal["auto", "fixed", "camera"] = "auto"
    """``auto`` controls the spot's peak; ``fixed`` sets ``exposure_ms`` and ``gain_db``; ``camera`` sets
    nothing."""
    exposure_ms: Annotated[float, Field(gt=0, le=1000)] = 2.0
    """Exposure time, ms: initial value of ``auto``, or ``fixed`` value. `altd record` and `altd scan` use it
    for both."""
    gain_db: Annotated[float, Field(ge=0, le=48)] = 0.0
    """Initial gain of ``auto``, or the ``fixed`` one, dB."""
    shortest_ms: Annotated[float, Field(gt=0, le=1000)] = 0.02
    """Lower limit of the exposure time of ``auto``, ms."""
    longest_ms: Annotated[float, Field(gt=0, le=1000)] = 20.0
    """Upper limit of the exposure time of ``auto``, ms, also 90 % of the frame interval. Long exposures smear
    vibration."""
    largest_gain_db: Annotated[float, Field(ge=0, le=48)] = 12.0
    """Upper limit of the gain of ``auto``, dB; ``auto`` adds gain only at ``longest_ms``."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.control != "auto":
            return self
        faults: list[tuple[tuple[str], str]] = []
        if not self.shortest_ms <= self.exposure_ms <= self.longest_ms:
            limits = f"from shortest_ms {self.shortest_ms:g} to longest_ms {self.longest_ms:g}"
            faults.append(
                (("exposure_ms",), f"{self.exposure_ms:g} is not where auto may begin; possible: {limits}")
            )
        if self.gain_db > self.largest_gain_db:
            limits = f"up to largest_gain_db {self.largest_gain_db:g}"
            faults.append((("gain_db",), f"{self.gain_db:g} is not where auto may begin; possible: {limits}"))
        if faults:
            raise complaint(*faults)
        return self


class LiveCameraSettings(CameraSettings):
    """Keys of all live cameras."""

    device: Path | str
    """Camera to open; its form depends on the driver."""
    width: Annotated[int, Field(ge=64, le=16384)] = 752
    """Columns of a frame, as in the calibration."""
    height: Annotated[int, Field(ge=64, le=16384)] = 480
    """Rows of a frame."""
    fps: Annotated[float, Field(ge=1, le=1000)] = 20.0
    """Frames per second."""
    row_time_us: Annotated[float, Field(ge=-MAX_ROW_TIME_US, le=MAX_ROW_TIME_US)] = 0.0
    """Rolling shutter: delay of a row's exposure after the row above, µs; below 0 if rows are read upwards.
    0: global shutter, or not known."""
    exposure: ExposureSettings = ExposureSettings()
    """Exposure and gain, a separate table (below)."""
    serial: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """The camera's serial number (`altd devices`). Another camera is ``wrong_camera``."""

    @model_validator(mode="after")
    def _check_readout(self) -> Self:
        if self.readout_ms > 1000 / self.fps:
            said = f"{self.row_time_us:g} makes {self.height} rows last longer than a frame; possible: up to "
            raise complaint((("row_time_us",), f"{said}{1e6 / self.fps / (self.height - 1):.1f} either way"))
        return self

    @property
    def readout_ms(self) -> float:
        """Time from the exposure of the first row to that of the last one, ms."""
        return abs(self.row_time_us) * (self.height - 1) * 1e-3

    @property
    def longest_exposure_ms(self) -> float:
        """Longest exposure time that the settings allow, ms; assumed if the camera controls it."""
        exposure = self.exposure
        if exposure.control == "fixed":
            return exposure.exposure_ms
        return min(exposure.longest_ms, (1 - READOUT_SHARE) * 1000 / self.fps)

    @property
    def busy_ms(self) -> float:
        """Longest time from a trigger until the camera can take the next, ms."""
        return self.longest_exposure_ms + READOUT_SHARE * 1000 / self.fps


class Visits(DeviceTable):
    """Visits of a beam's switched targets; a row has these keys in `[chain]`."""

    exposures: Annotated[int, Field(ge=2, le=100)] = 5
    """Exposures of each target before the next one is shown."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Settling time of the glasses after switching, s. Before each switching, a random time of up to half of
    it is added."""
