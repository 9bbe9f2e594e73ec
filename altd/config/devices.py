"""The devices beside the cameras: frame LEDs, lamps on the housing, inclinometer, xy stage."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.table import Device, GpioLineName, Name, StageMillimetres, Table, complaint
from altd.records.limits import MAX_LIMIT, Limits


class GpiodLampsSettings(Table):
    """The frame LEDs on lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip (`altd devices`)."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """Names or numbers of the lines; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""


class CameraLampsSettings(Table):
    """The frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue)."""

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
    """From switching until the glasses have settled. Before each switching, up to half of it is added by
    chance."""


class GpiodSwitchesSettings(Visits):
    """The voltage of the glasses, switched by lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """As in `[lamps]`."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """One line for each switched target, in their order: active, its glass has voltage and is clear."""
    active_low: bool = False
    """A glass has voltage when its line is low."""


class CameraSwitchesSettings(Visits):
    """The voltage of the glasses, switched by an output line of each switched target's own camera."""

    driver: Literal["camera"]
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's name of the output line: on, the glass has voltage and is clear."""


AnySwitchesSettings = Annotated[GpiodSwitchesSettings | CameraSwitchesSettings, Field(discriminator="driver")]


class IndicatorsSettings(Table):
    """The four lamps on the housing, on lines of a GPIO chip. Lamps without a line are left out."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """As in `[lamps]`."""
    data: GpioLineName | None = None
    """Flashes when a client gets data."""
    error: GpioLineName | None = None
    """Lit: nothing valid; blinking: valid, but a part has failed or needs maintenance."""
    power: GpioLineName | None = None
    """Lit while the daemon runs."""
    ok: GpioLineName | None = None
    """Lit: valid; blinking: warming up, or valid with a warning."""
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
            raise complaint(((), "no lamp has a line; possible: data, error, power, ok, or no table at all"))
        return self


class InclinometerSettings(Table):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Roll is sign_roll · angle + offset_roll_deg, within ±180°; direction and offset inside the sensor must
    be 0.
    """

    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485"]
    """Balluff BSI R11A0-…-CXP360 (one axis) or WitMotion WT901C485 (two axes)."""
    device: Device
    """As in `[[serial]]`."""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Default: 19200 (Balluff), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; default: 1 (Balluff), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time between readings."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """Older readings are not shown."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """A reading that stays equal to the last digit for this time is ``frozen``."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """Readings with a larger standard deviation are ``noisy``."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    """Roll beyond ± this is out of range."""
    sign_roll: Literal[-1, 1] = 1
    """Roll is positive clockwise as seen along the beam; -1 reverses it."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Added after the sign."""
    sign_pitch: Literal[-1, 1] = 1
    """Second axis: positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Added after the sign."""
    max_divergence_deg: Annotated[float, Field(gt=0, le=10)] = 0.5
    """Two axes: limit of a slow change between the beam's pitch and gravity's."""


class GrblStageSettings(Table):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    It is sent to sign · position + offset.
    """

    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Device
    """As in `[[serial]]`."""
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = 115200
    """Bits per second."""
    start: Literal["home", "unlock"] = "home"
    """``home`` runs to the limit switches (`$H`); ``unlock`` keeps the controller's position (`$X`), for a
    stage without switches."""
    coordinates: Literal["work", "machine"] = "work"
    """Work coordinates (G54) or machine coordinates."""
    sign_x: Literal[-1, 1] = 1
    """-1 if the stage's axis runs against the unit's, or the stage carries the unit."""
    sign_y: Literal[-1, 1] = 1
    offset_x_mm: StageMillimetres = 0.0
    """The controller's coordinates where the beam meets (0, 0) of the unit frame."""
    offset_y_mm: StageMillimetres = 0.0
    feed_mm_per_min: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    """Speed, within the controller's limits."""
    answer_within_s: Annotated[float, Field(ge=0.1, le=60)] = 2.0
    """Then a command is sent again, twice."""
    home_within_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    """Longest time of homing."""


Uncertainty = Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None


class ScanLimits(Table):
    """Standard uncertainties (1 sigma, per axis) of stage, beam and targets that no scan shows in itself.

    A key that is absent counts as 0, and the report lists it as not stated.
    """

    stage_mm: Uncertainty = None
    """The stage's positioning, independent from node to node."""
    stage_scale_ppm: Uncertainty = None
    """The stage's scale, as on its certificate."""
    stage_square_mrad: Uncertainty = None
    """The angle between the stage's axes."""
    beam_normal_mm_per_m: Uncertainty = None
    """The beam against the normal of the targets."""
    target_distance_mm: Uncertainty = None
    """The distance from the first target to another one."""

    @property
    def record(self) -> Limits | None:
        """The same for a recording's header; None: nothing is stated."""
        stated = self.model_dump(exclude_none=True)
        return Limits(**stated) if stated else None


class Scan(Table):
    """The grid of `altd scan` and what is exposed at its nodes."""

    columns: Annotated[int, Field(ge=4, le=64)] = 6
    """Nodes along x."""
    rows: Annotated[int, Field(ge=4, le=64)] = 5
    """Nodes along y."""
    pitch_mm: Annotated[float, Field(ge=1, le=1000)] = 28.0
    """Distance between nodes. 6 × 5 nodes at 28 mm cover 140 × 110 mm."""
    centre_x_mm: StageMillimetres = 0.0
    """Middle of the grid in the unit frame."""
    centre_y_mm: StageMillimetres = 0.0
    order: Literal["serpentine", "rows"] = "serpentine"
    """``serpentine``: every second row backwards; ``rows``: all rows from the smallest x, for a stage with
    backlash."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 2
    """Exposures per node."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """From standstill, or from switching LEDs, to the first exposure."""
    led_pairs: Annotated[int, Field(ge=0, le=100)] = 2
    """LED reference pairs (off, on) before the grid and after it; the first are a self-check."""
    when_bad: Literal["stop", "warning"] = "stop"
    """After a bad self-check; ``warning`` calibrates the unit as it is."""
    retries: Annotated[int, Field(ge=0, le=100)] = 2
    """Repetitions of a node with a bad spot."""
    turned_deg: Literal[0, 180] = 0
    """180: the unit is turned about its own z axis; stage and beam are as for the scan before."""
    limits: ScanLimits = ScanLimits()
    """Uncertainties that the scan does not show."""
    flat_pitch_mm: Annotated[float, Field(ge=1, le=20)] = 2.5
    """Steps of ``altd scan --flat``: a quarter of the spot's diameter, at most half of it."""
    flat_margin_mm: Annotated[float, Field(ge=0, le=100)] = 10.0
    """Its reach beyond the grid: three quarters of the spot's diameter, where the stage can."""
