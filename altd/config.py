"""``altd.toml`` as pydantic models: frozen, unknown keys refused, units in the keys."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from altd.errors import BadInputError
from altd.files.documents import parse_toml
from altd.files.reading import read_file

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=32)]
GpioLineName = Annotated[str, Field(min_length=1, max_length=64)]
TcpPort = Annotated[int, Field(ge=0, le=65535)]
Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A place or an offset: 100 m reach from a unit to the head of its machine, and fit the registers."""
StageMillimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
OffsetDegrees = Annotated[float, Field(ge=-45, le=45)]
"""With the beam's own 14° it stays well below 90°, where mm/m has no end."""
ControlValue = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
"""What the kernel's largest control holds."""

_LARGEST_BYTES = 1 << 16


def _address(host: str) -> str:
    """An address to listen on. No other name: to look it up could hold the unit up for seconds."""
    if host != "localhost":
        try:
            ipaddress.ip_address(host)
        except ValueError as error:
            every = "every address of the unit is 0.0.0.0"
            raise ValueError(f"{host!r} is no IP address ({every})") from error
    return host


Host = Annotated[str, AfterValidator(_address)]


class Table(BaseModel):
    """A table of the file: its keys are all known, its values do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


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
    z_mm: Millimetres
    """Distance from the front target's printed face along the beam."""
    camera: Name
    """The camera that looks at it: a name under ``[cameras]``."""


class RecordingCamera(Table):
    """A camera that plays a recording; every output then says ``playback``."""

    driver: Literal["recording"]
    path: Path
    """The recording's folder, relative to the config file."""
    pace: Literal["realtime", "fast"] = "realtime"
    """``realtime`` keeps the recording's times, ``fast`` delivers as soon as a frame was taken."""
    repeat: bool = False
    """Start again at the end."""


class ExposureControl(Table):
    """Exposure and gain of one camera."""

    control: Literal["auto", "fixed", "camera"] = "auto"
    """``auto`` keeps the spot's peak in a band between starvation and saturation; ``fixed`` sets
    ``exposure_ms`` and ``gain_db`` and leaves them; ``camera`` sets nothing at all. A camera that has nothing
    to set is left alone, and its health says so."""
    exposure_ms: Annotated[float, Field(gt=0, le=1000)] = 2.0
    """Where ``auto`` begins, or what is ``fixed``. `altd record` and `altd scan` hold it in both cases."""
    gain_db: Annotated[float, Field(ge=0, le=48)] = 0.0
    """The same for the gain."""
    shortest_ms: Annotated[float, Field(gt=0, le=1000)] = 0.02
    """``auto`` goes no lower, nor lower than the camera can."""
    longest_ms: Annotated[float, Field(gt=0, le=1000)] = 20.0
    """``auto`` goes no higher, nor to more than nine tenths of the time between two frames. A long exposure
    smears vibration."""
    largest_gain_db: Annotated[float, Field(ge=0, le=48)] = 12.0
    """``auto`` adds gain only once ``longest_ms`` does not suffice, and no more than this."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.shortest_ms <= self.exposure_ms <= self.longest_ms and self.control == "auto":
            raise ValueError("exposure_ms: not between shortest_ms and longest_ms")
        if self.gain_db > self.largest_gain_db and self.control == "auto":
            raise ValueError("gain_db: larger than largest_gain_db")
        return self


class LiveCamera(Table):
    """What every camera that is no recording has."""

    width: Annotated[int, Field(ge=64, le=16384)] = 752
    """Columns of a frame; the calibration must have been made with the same."""
    height: Annotated[int, Field(ge=64, le=16384)] = 480
    """Rows of a frame."""
    fps: Annotated[float, Field(ge=1, le=1000)] = 20.0
    """Frames a second."""
    exposure: ExposureControl = ExposureControl()
    """A table of its own, see below."""
    serial: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """The camera's serial number, as `altd devices` shows it: another one in its place is
    ``wrong_camera``. The serial number in the calibration counts as well."""


class V4l2Camera(LiveCamera):
    """A USB or MIPI camera through the kernel's Video4Linux."""

    driver: Literal["v4l2"]
    device: Path
    """The camera's device, best by its stable name, such as /dev/v4l/by-path/…: `altd devices` shows it."""
    pixel_format: Literal["GREY", "Y10", "Y12", "Y16"] = "GREY"
    """What the camera sends: 8, 10, 12 or 16 bits of grey."""
    controls: dict[str, ControlValue] = {}
    """Controls of this camera to set when it is opened, by the names that `altd devices` shows: a trigger
    input, for instance, which every maker calls something else."""


class AravisCamera(LiveCamera):
    """A GigE Vision camera through Aravis."""

    driver: Literal["aravis"]
    device: Annotated[str, Field(min_length=1, max_length=128)]
    """The camera's serial number, IP address, id or user-defined name, as `altd devices` shows it."""
    pixel_format: Literal["Mono8", "Mono10", "Mono12", "Mono16"] = "Mono8"
    """What the camera sends: 8, 10, 12 or 16 bits of grey."""
    offset_x_px: Annotated[int, Field(ge=0, le=16384)] = 0
    """First column of the sensor that is read. The calibration holds for one offset only."""
    offset_y_px: Annotated[int, Field(ge=0, le=16384)] = 0
    trigger: Literal["free", "software", "line"] = "free"
    """``free``: the camera's own rate; ``software``: altd triggers all such cameras at the same instants;
    ``line``: an electrical signal at ``trigger_line``."""
    trigger_line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's own name of its trigger input."""
    packet_bytes: Annotated[int, Field(ge=0, le=16384)] = 0
    """Size of a network packet; 0 finds the largest that gets through."""
    resend: bool = True
    """Ask the camera again for packets that were lost."""
    features: dict[str, bool | ControlValue | float | str] = {}
    """GenICam features of this camera to set when it is opened, in this order."""


CameraTable = Annotated[RecordingCamera | V4l2Camera | AravisCamera, Field(discriminator="driver")]


class GpiodLamps(Table):
    """The frame LEDs on lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """The lines by name, or by number where the chip has no names; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""


class CameraLamps(Table):
    """The frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue)."""

    driver: Literal["camera"]
    cameras: Annotated[tuple[Name, ...], Field(min_length=1)]
    """The cameras, names under ``[cameras]``, whose output switches LEDs; all are switched together."""
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's own name of the output line."""


LampsTable = Annotated[GpiodLamps | CameraLamps, Field(discriminator="driver")]


class IndicatorLamps(Table):
    """The four lamps on the housing, on lines of a GPIO chip. A lamp without a line is left out."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    data: GpioLineName | None = None
    """The line of the lamp that flashes when data was given to whoever asked for it."""
    error: GpioLineName | None = None
    """Lit while nothing valid is measured; blinks while a part has failed although it is."""
    power: GpioLineName | None = None
    """Lit while the daemon runs."""
    ok: GpioLineName | None = None
    """Lit while the measurement is valid; blinks while it warms up, or is valid with a warning."""
    active_low: bool = False
    """The lamps are lit when the line is low."""

    @property
    def lines(self) -> dict[str, str]:
        """The lines of the lamps that have one, by the lamp's key."""
        named = {"data": self.data, "error": self.error, "power": self.power, "ok": self.ok}
        return {lamp: line for lamp, line in named.items() if line is not None}

    @model_validator(mode="after")
    def _has_a_line(self) -> Self:
        if not self.lines:
            raise ValueError("no line: give data, error, power or ok, or leave the table out")
        return self


class Measuring(Table):
    """How exposures become measurements."""

    window: Annotated[int, Field(ge=1, le=1000)] = 20
    """Exposures that are averaged."""
    every: Annotated[int, Field(ge=1, le=1000)] = 1
    """A measurement after this many exposures: 1 is the sliding mean."""
    pair_by: Literal["sequence", "time"] = "sequence"
    """What makes one exposure of two frames: their number, in recordings, or their time, with all others."""
    max_skew_ms: Annotated[float, Field(gt=0, le=1000)] = 10.0
    """Largest difference in time between the frames of one exposure. By time, a steady lag of one camera
    behind another is measured and taken off first."""
    max_lag_ms: Annotated[float, Field(gt=0, le=1000)] = 30.0
    """Largest steady lag: free-running cameras expose up to half a period apart, 25 ms at 20 a second."""

    @property
    def max_skew_ns(self) -> int:
        """``max_skew_ms`` in the unit of the frames' times."""
        return round(self.max_skew_ms * 1e6)

    @property
    def max_lag_ns(self) -> int:
        """``max_lag_ms`` in the unit of the frames' times."""
        return round(self.max_lag_ms * 1e6)

    max_sigma_mm: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """A displacement less certain than this is ``unsteady``; half of the accuracy that A.1 demands."""
    max_sigma_mm_per_m: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """The same for yaw and pitch."""
    silent_after_s: Annotated[float, Field(gt=0, le=2)] = 0.4
    """A camera is silent when no frame came for this long."""
    stale_after_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    """A value whose last exposure is older than this is not shown any more. Keep it longer than ``every``
    exposures take."""


class Installation(Table):
    """How the controller wants the numbers: sign first, then offset."""

    reference_plane_mm: Millimetres = 0.0
    """The plane z in which the displacement is given."""
    sign_x: Literal[-1, 1] = 1
    """-1 turns the axis round."""
    sign_y: Literal[-1, 1] = 1
    sign_yaw: Literal[-1, 1] = 1
    sign_pitch: Literal[-1, 1] = 1
    offset_x_mm: Millimetres = 0.0
    """Added after the sign."""
    offset_y_mm: Millimetres = 0.0
    offset_yaw_deg: OffsetDegrees = 0.0
    offset_pitch_deg: OffsetDegrees = 0.0


class ModbusTcp(Table):
    """Modbus TCP server."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The IP address to listen on, or localhost; 0.0.0.0 is every address of the unit, :: every IPv6 one."""
    port: TcpPort = 502
    """TCP port; below 1024 the daemon needs CAP_NET_BIND_SERVICE, which the systemd unit grants."""
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus unit identifier; 0 and 255 are answered too."""


class Http(Table):
    """HTTP server: measurement, status and a stream."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The IP address to listen on, or localhost; 0.0.0.0 is every address of the unit, :: every IPv6 one."""
    port: TcpPort = 8080
    """TCP port."""


class Rs485(Table):
    """The kernel's RS485 mode: the port switches the direction of its transceiver by itself, with RTS.

    For a port that the kernel can do this with; an adapter that switches by itself needs none of it.
    """

    rts_while_sending: Literal["high", "low"] = "high"
    """The level of RTS while the unit sends."""
    delay_before_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from switching to sending until the first bit."""
    delay_after_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from the last bit until switching back."""


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
    rs485: Rs485 | None = None
    """A table of its own, see below; without it the port is RS232, or an adapter does the rest."""
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
    offset_x_mm: StageMillimetres = 0.0
    """The controller's x where the beam meets x = 0 of the unit frame."""
    offset_y_mm: StageMillimetres = 0.0
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
    pitch_mm: Annotated[float, Field(ge=1, le=1000)] = 28.0
    """Distance from node to node. 6 × 5 nodes at 28 mm hold the 140 × 110 mm that the unit measures."""
    centre_x_mm: StageMillimetres = 0.0
    """The middle of the grid in the unit frame."""
    centre_y_mm: StageMillimetres = 0.0
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
    cameras: dict[Name, CameraTable] = {}
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    modbus_tcp: ModbusTcp | None = None
    http: Http | None = None
    serial: tuple[SerialPort, ...] = ()
    lamps: LampsTable | None = None
    indicators: IndicatorLamps | None = None
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
        live = any(isinstance(camera, LiveCamera) for camera in self.cameras.values())
        if live and self.measuring.pair_by == "sequence":
            raise ValueError('measuring.pair_by: must be "time", for cameras count each from its own start')
        devices = [port.device for port in self.serial]
        if len(set(devices)) < len(devices):
            raise ValueError("serial: two ports have the same device")
        if self.stage is not None and self.stage.device in devices:
            raise ValueError("stage: a [[serial]] port has the same device")
        self._lamps_fit()
        return self

    def _lamps_fit(self) -> None:
        if isinstance(self.lamps, CameraLamps):
            for name in self.lamps.cameras:
                if not isinstance(self.cameras.get(name), AravisCamera):
                    raise ValueError(f'lamps: camera {name!r} is no camera with driver "aravis"')
                if name not in [target.camera for target in self.targets]:
                    raise ValueError(f"lamps: camera {name!r} looks at no target and is not opened")
        named: list[tuple[str, str]] = []
        if isinstance(self.lamps, GpiodLamps):
            named += [(self.lamps.chip, line) for line in self.lamps.lines]
        if self.indicators is not None:
            named += [(self.indicators.chip, line) for line in self.indicators.lines.values()]
        if len(set(named)) < len(named):
            raise ValueError("lamps, indicators: two lamps are on the same line")


def load_config(path: Path) -> Config:
    """Read and check a config file; paths in it become relative to its folder.

    Raises BadInputError that names the file and the key.
    """
    content = read_file(path, _LARGEST_BYTES)
    try:
        document = _anchored(parse_toml(content), path.parent)
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
    try:
        return Config.model_validate(document)
    except ValidationError as error:
        raise BadInputError(path, _first_fault(error, document)) from error


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


def _first_fault(error: ValidationError, document: dict[str, Any]) -> str:
    faults = error.errors(include_url=False)
    first = faults[0]
    keys = _keys(first["loc"], document)
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "unknown key"
    elif first["type"] == "union_tag_invalid":
        keys.append("driver")
        message = f"{first['ctx']['tag']!r} is none of {first['ctx']['expected_tags']}"
    elif first["type"] == "union_tag_not_found":
        keys.append("driver")
        message = "Field required"
    elif isinstance(first["input"], int | float):
        message += f", not {first['input']}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{'.'.join(keys)}: {message}{more}" if keys else f"{message}{more}"


def _keys(location: tuple[int | str, ...], document: Any) -> list[str]:
    """Where in the file; pydantic puts the driver's name, which is no key, between a table and its key."""
    keys: list[str] = []
    for part in location[:-1]:
        table = document if isinstance(document, dict) else {}
        if part in table or isinstance(document, list):
            document = document[part]
        elif part == table.get("driver"):
            continue
        keys.append(str(part))
    return [*keys, *map(str, location[-1:])]
