"""Devices beside the cameras: frame LEDs, lamps on the housing, inclinometer, xy stage."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.table import Celsius, Device, GpioLineName, Name, StageMillimetres, Table, complaint
from altd.records.limits import MAX_LIMIT, Limits


class GpiodLampsSettings(Table):
    """Frame LEDs on lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip (`altd devices`)."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """Names or numbers of the lines; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""


class CameraLampsSettings(Table):
    """Frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue)."""

    driver: Literal["camera"]
    cameras: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Cameras whose output switches LEDs; all are switched together."""
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of the output line."""


AnyLampsSettings = Annotated[GpiodLampsSettings | CameraLampsSettings, Field(discriminator="driver")]


class Visits(Table):
    """Visits of a beam's switched targets; a row has these keys in `[chain]`."""

    exposures: Annotated[int, Field(ge=2, le=100)] = 5
    """Exposures of each target before the next one is shown."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Settling time of the glasses after switching, s. Before each switching, a random time of up to half of
    it is added."""


class GpiodSwitchesSettings(Visits):
    """Voltage of the glasses, switched by lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip, as in `[lamps]`."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """One line per switched target, in their order; active: the glass has voltage and is clear."""
    active_low: bool = False
    """A glass has voltage when its line is low."""


class CameraSwitchesSettings(Visits):
    """Voltage of the glasses, switched by an output line of each switched target's own camera."""

    driver: Literal["camera"]
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of the output line; on: the glass has voltage and is clear."""


AnySwitchesSettings = Annotated[GpiodSwitchesSettings | CameraSwitchesSettings, Field(discriminator="driver")]


class IndicatorsSettings(Table):
    """The four lamps on the housing, on lines of a GPIO chip. Lamps without a line are not used."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip, as in `[lamps]`."""
    data: GpioLineName | None = None
    """Data lamp: flashes when a client gets data."""
    error: GpioLineName | None = None
    """Error lamp, lit: nothing valid; blinking: valid, but a part has failed or needs maintenance."""
    power: GpioLineName | None = None
    """Power lamp: lit while the daemon runs."""
    ok: GpioLineName | None = None
    """OK lamp, lit: valid; blinking: warming up, or valid with a warning."""
    active_low: bool = False
    """The lamps are lit when the line is low."""

    @property
    def lines(self) -> dict[str, str]:
        """Lines of the lamps that have one, by the lamp's key."""
        named = {"data": self.data, "error": self.error, "power": self.power, "ok": self.ok}
        return {lamp: line for lamp, line in named.items() if line is not None}

    @model_validator(mode="after")
    def _has_a_line(self) -> Self:
        if not self.lines:
            raise complaint(((), "no lamp has a line; possible: data, error, power, ok, or no table at all"))
        return self


class InclinometerSettings(Table):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Roll is sign_roll · angle + offset_roll_deg, within ±180°. Direction and offset inside the sensor must be
    0.
    """

    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485"]
    """Balluff BSI R11A0-…-CXP360 (one axis) or WitMotion WT901C485 (two axes)."""
    device: Device
    """Serial device, as in `[[serial]]`."""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Bits per second; default: 19200 (Balluff), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; default: 1 (Balluff), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time between readings, s."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """Maximum age of a reading that is shown, s."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """A reading that stays equal to the last digit for this time, s, is ``frozen``."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """Readings with a larger standard deviation, degrees, are ``noisy``."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    """Roll beyond ± this angle, degrees, is out of range."""
    sign_roll: Literal[-1, 1] = 1
    """Sign of the angle. Roll is positive clockwise as seen along the beam; -1 reverses it."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of roll, degrees, added after the sign."""
    sign_pitch: Literal[-1, 1] = 1
    """Sign of the second axis. Pitch is positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of pitch, degrees, added after the sign."""
    max_divergence_deg: Annotated[float, Field(gt=0, le=10)] = 0.5
    """Two axes: limit of a slow change between the beam's pitch and gravity's, degrees."""


class GrblStageSettings(Table):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    Its target coordinates are sign · position + offset.
    """

    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Device
    """Serial device, as in `[[serial]]`."""
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = 115200
    """Bits per second."""
    start: Literal["home", "unlock"] = "home"
    """``home`` runs to the limit switches (`$H`); ``unlock`` keeps the controller's position (`$X`), for a
    stage without switches."""
    coordinates: Literal["work", "machine"] = "work"
    """Work coordinates (G54) or machine coordinates."""
    sign_x: Literal[-1, 1] = 1
    """-1 if the stage's axis is opposite to the unit's, or the stage carries the unit."""
    sign_y: Literal[-1, 1] = 1
    offset_x_mm: StageMillimetres = 0.0
    """The controller's coordinates where the beam meets (0, 0) of the unit frame, mm."""
    offset_y_mm: StageMillimetres = 0.0
    feed_mm_per_min: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    """Speed, mm/min, within the controller's limits."""
    answer_within_s: Annotated[float, Field(ge=0.1, le=60)] = 2.0
    """Time limit of a response, s; after it, a command is sent again, twice."""
    home_within_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    """Longest time of homing, s."""


Uncertainty = Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None


class ScanLimits(Table):
    """Standard uncertainties (1 sigma, per axis) of stage, beam and targets that a scan cannot measure.

    A missing key counts as 0, and the report lists it as not stated.
    """

    stage_mm: Uncertainty = None
    """Positioning of the stage, mm, independent from node to node."""
    stage_scale_ppm: Uncertainty = None
    """Scale of the stage, ppm, as on its certificate."""
    stage_square_mrad: Uncertainty = None
    """Angle between the stage's axes, mrad."""
    beam_normal_mm_per_m: Uncertainty = None
    """Direction of the beam relative to the normal of the targets, mm/m."""
    target_distance_mm: Uncertainty = None
    """Distance from the first target to another one, mm."""
    temperature_k: Uncertainty = None
    """Temperature of the frame in service, against that of the scan, K."""

    @property
    def record(self) -> Limits | None:
        """These limits for a recording's header; None: nothing is stated."""
        stated = self.model_dump(exclude_none=True)
        return Limits(**stated) if stated else None


class Scan(Table):
    """The grid of `altd scan` and the exposures at its nodes."""

    columns: Annotated[int, Field(ge=4, le=64)] = 6
    """Nodes along x."""
    rows: Annotated[int, Field(ge=4, le=64)] = 5
    """Nodes along y."""
    pitch_mm: Annotated[float, Field(ge=1, le=1000)] = 28.0
    """Distance between nodes, mm. 6 × 5 nodes at 28 mm cover 140 × 110 mm."""
    centre_x_mm: StageMillimetres = 0.0
    """Middle of the grid in the unit frame, mm."""
    centre_y_mm: StageMillimetres = 0.0
    order: Literal["serpentine", "rows"] = "serpentine"
    """``serpentine``: every second row backwards; ``rows``: all rows from the smallest x, for a stage with
    backlash."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 2
    """Exposures per node."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Time from standstill, or from switching LEDs, to the first exposure, s."""
    led_pairs: Annotated[int, Field(ge=0, le=100)] = 2
    """LED reference pairs (off, on) before the grid and after it; the first are a self-check."""
    when_bad: Literal["stop", "warning"] = "stop"
    """Action after a bad self-check: ``stop`` ends the scan, ``warning`` calibrates the unit as it is."""
    retries: Annotated[int, Field(ge=0, le=100)] = 2
    """Repetitions of a node with a bad spot."""
    turned_deg: Literal[0, 180] = 0
    """Turn of the unit about its own z axis, degrees. For 180, stage and beam are as in the scan before."""
    temperature_c: Celsius | None = None
    """Temperature of the frame in the scan, °C, if it is known."""
    limits: ScanLimits = ScanLimits()
    """Uncertainties that the scan cannot measure."""
    flat_pitch_mm: Annotated[float, Field(ge=1, le=20)] = 2.5
    """Step of ``altd scan --flat``, mm: a quarter of the spot's diameter, at most half of it."""
    flat_margin_mm: Annotated[float, Field(ge=0, le=100)] = 10.0
    """Reach of ``altd scan --flat`` beyond the grid, mm: three quarters of a spot diameter, where
    possible."""
