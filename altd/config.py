"""``altd.toml`` as pydantic models: frozen, unknown keys refused, units in the keys."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from altd.errors import BadInputError

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=32)]
TcpPort = Annotated[int, Field(ge=0, le=65535)]


class Table(BaseModel):
    """A table of the file: its keys are all known, its values do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Unit(Table):
    """Which unit this is."""

    serial: Annotated[str, Field(min_length=1, max_length=64)]
    """Serial number; the calibration file must carry the same."""
    calibration: Path
    """The calibration file, relative to the config file."""


class Target(Table):
    """One target that the beam meets, in beam order."""

    name: Name
    """The name in the calibration file and in all outputs; small letters, digits and _."""
    z_mm: float
    """Distance from the front target's printed face along the beam."""
    camera: Name
    """The camera that looks at it: a name under ``[cameras]``."""


class RecordingCamera(Table):
    """A camera that plays a recording; every output then says ``playback``."""

    driver: Literal["recording"]
    """The only driver of this release."""
    path: Path
    """The recording's folder, relative to the config file."""
    pace: Literal["realtime", "fast"] = "realtime"
    """``realtime`` keeps the recording's times, ``fast`` delivers as soon as a frame was taken."""
    repeat: bool = False
    """Start again at the end."""


class Measuring(Table):
    """How exposures become measurements."""

    window: Annotated[int, Field(ge=1, le=1000)] = 20
    """Exposures that are averaged."""
    every: Annotated[int, Field(ge=1, le=1000)] = 1
    """A measurement after this many exposures: 1 is the sliding mean."""
    pair_by: Literal["sequence", "time"] = "sequence"
    """What makes one exposure of two frames: triggered cameras count together, free ones do not."""
    max_skew_ms: Annotated[float, Field(gt=0, le=1000)] = 10.0
    """Largest difference in time between the frames of one exposure."""
    max_sigma_mm: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """A displacement less certain than this is ``unsteady``; half of the accuracy that A.1 demands."""
    max_sigma_mm_per_m: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """The same for yaw and pitch."""
    silent_after_s: Annotated[float, Field(gt=0, le=2)] = 0.4
    """A camera is silent when no frame came for this long."""
    stale_after_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    """A value that was not followed by a new one for this long is not shown any more. Keep it longer than
    ``every`` exposures take."""


class Installation(Table):
    """How the controller wants the numbers: sign first, then offset."""

    reference_plane_mm: float = 0.0
    """The plane z in which the displacement is given."""
    sign_x: Literal[-1, 1] = 1
    """-1 turns the axis round."""
    sign_y: Literal[-1, 1] = 1
    sign_yaw: Literal[-1, 1] = 1
    sign_pitch: Literal[-1, 1] = 1
    offset_x_mm: float = 0.0
    """Added after the sign."""
    offset_y_mm: float = 0.0
    offset_yaw_deg: float = 0.0
    offset_pitch_deg: float = 0.0


class ModbusTcp(Table):
    """Modbus TCP server."""

    host: str = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The address to listen on; 0.0.0.0 is every address of the unit."""
    port: TcpPort = 502
    """TCP port; below 1024 the daemon needs CAP_NET_BIND_SERVICE, which the systemd unit grants."""
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus unit identifier; 0 and 255 are answered too."""


class Http(Table):
    """HTTP server: measurement, status and a stream."""

    host: str = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The address to listen on; 0.0.0.0 is every address of the unit."""
    port: TcpPort = 8080
    """TCP port."""


class SerialPort(Table):
    """One serial port and what it speaks."""

    device: Path
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    speaks: Literal["telegram", "console", "modbus_rtu"]
    """What travels on it."""
    baud: Literal[1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400] = 9600
    """Bits per second."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus RTU only."""
    interval_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Telegram only: time from one telegram to the next."""


class GrblStage(Table):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    In the controller's coordinates the stage is sent to sign · position + offset.
    """

    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Path
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = 115200
    """Bits per second."""
    start: Literal["home", "unlock"] = "home"
    """``home`` runs to the limit switches each time (`$H`); ``unlock`` takes the position that the controller
    has (`$X` when it is locked), for a stage without switches whose zero was set by hand."""
    coordinates: Literal["work", "machine"] = "work"
    """Whose zero counts: that of the work coordinates in use (G54) or the machine's."""
    sign_x: Literal[-1, 1] = 1
    """-1 where the stage's axis runs against the unit's, or the stage carries the unit and not the laser."""
    sign_y: Literal[-1, 1] = 1
    offset_x_mm: float = 0.0
    """The controller's x where the beam meets x = 0 of the unit frame."""
    offset_y_mm: float = 0.0
    feed_mm_per_min: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    """Speed; the controller keeps its own limits."""
    answer_within_s: Annotated[float, Field(ge=0.1, le=60)] = 2.0
    """A command that is not answered for this long is sent again, twice."""
    home_within_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    """Longest time that homing may take."""


class Scan(Table):
    """The grid of `altd scan` and what is exposed at its nodes."""

    columns: Annotated[int, Field(ge=4, le=64)] = 6
    """Nodes along x."""
    rows: Annotated[int, Field(ge=4, le=64)] = 5
    """Nodes along y."""
    pitch_mm: Annotated[float, Field(ge=1, le=1000)] = 25.0
    """Distance from node to node."""
    centre_x_mm: float = 0.0
    """The middle of the grid in the unit frame."""
    centre_y_mm: float = 0.0
    order: Literal["serpentine", "rows"] = "serpentine"
    """``serpentine`` runs to and fro, the shortest way; ``rows`` begins each row at the smallest x, so that a
    stage with play comes to every node from the same side."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 2
    """Exposures a node."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Time from standstill, or from switching the LEDs, until exposures count."""
    led_pairs: Annotated[int, Field(ge=0, le=100)] = 2
    """LED reference pairs (off, on) before the grid, and as many after it."""
    retries: Annotated[int, Field(ge=0, le=100)] = 2
    """How often a node with a bad spot is exposed again before it is refused."""


class Config(Table):
    """The whole of ``altd.toml``."""

    unit: Unit
    targets: Annotated[tuple[Target, ...], Field(min_length=2)]
    cameras: dict[Name, RecordingCamera] = {}
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    modbus_tcp: ModbusTcp | None = None
    http: Http | None = None
    serial: tuple[SerialPort, ...] = ()
    stage: GrblStage | None = None
    scan: Scan = Scan()

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        for what, names in (
            ("name", [target.name for target in self.targets]),
            ("camera", [target.camera for target in self.targets]),
            ("z_mm", [target.z_mm for target in self.targets]),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"targets: two targets have the same {what}")
        missing = [target.camera for target in self.targets if target.camera not in self.cameras]
        if self.cameras and missing:
            raise ValueError(f"targets: no [cameras.{missing[0]}] for camera {missing[0]!r}")
        devices = [port.device for port in self.serial]
        if len(set(devices)) < len(devices):
            raise ValueError("serial: two ports have the same device")
        if self.stage is not None and self.stage.device in devices:
            raise ValueError("stage: a [[serial]] port has the same device")
        return self


def load_config(path: Path) -> Config:
    """Read and check a config file; paths in it become relative to its folder.

    Raises BadInputError that names the file and the key.
    """
    try:
        text = path.read_bytes().decode()
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be read") from error
    except UnicodeDecodeError as error:
        raise BadInputError(path, "is not UTF-8 text") from error
    try:
        return Config.model_validate(_anchored(tomllib.loads(text), path.parent))
    except tomllib.TOMLDecodeError as error:
        raise BadInputError(path, f"not TOML: {error}") from error
    except ValidationError as error:
        raise BadInputError(path, _first_fault(error)) from error


def _anchored(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document with the paths of its files relative to ``folder``; wrong types are left to the models."""
    tables: list[tuple[Any, str]] = [(document.get("unit"), "calibration")]
    cameras = document.get("cameras")
    if isinstance(cameras, dict):
        tables += [(camera, "path") for camera in cameras.values()]
    for table, key in tables:
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(folder / table[key])
    return document


def _first_fault(error: ValidationError) -> str:
    faults = error.errors(include_url=False, include_context=False)
    first = faults[0]
    place = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "unknown key"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{place}: {message}{more}" if place else f"{message}{more}"
