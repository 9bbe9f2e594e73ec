"""The devices beside the cameras: frame LEDs, lamps on the housing, inclinometer, xy stage."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.table import Device, GpioLineName, Name, StageMillimetres, Table, complaint


class GpiodLampsSettings(Table):
    """The frame LEDs on lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """The lines by name, or by number where the chip has no names; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""


class CameraLampsSettings(Table):
    """The frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue)."""

    driver: Literal["camera"]
    cameras: Annotated[tuple[Name, ...], Field(min_length=1)]
    """The cameras, names under ``[cameras]``, whose output switches LEDs; all are switched together."""
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's own name of the output line."""


AnyLampsSettings = Annotated[GpiodLampsSettings | CameraLampsSettings, Field(discriminator="driver")]


class IndicatorsSettings(Table):
    """The four lamps on the housing, on lines of a GPIO chip. A lamp without a line is left out."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    data: GpioLineName | None = None
    """The line of the lamp that flashes when a client was given data."""
    error: GpioLineName | None = None
    """Lit while nothing valid is measured; blinks while it is and a part has failed or wants maintenance."""
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
            raise complaint(((), "no lamp has a line; possible: data, error, power, ok, or no table at all"))
        return self


class InclinometerSettings(Table):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Roll is sign_roll · angle + offset_roll_deg, brought to ±180°; the direction and offset that the sensor
    itself can be set to must be 0.
    """

    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485"]
    """The sensor: Balluff BSI R11A0-…-CXP360 (one axis) or WitMotion WT901C485 (two axes)."""
    device: Device
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Bits per second; without it the sensor's default: 19200 (Balluff), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; without it the sensor's default: 1 (Balluff), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time from one reading to the next."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """An older reading is not shown any more."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """When all that is read stays the same to the last digit for so long, the sensor no longer measures."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """A larger scatter of the readings (standard deviation) is no measurement."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    """Roll beyond ± this is out of range."""
    sign_roll: Literal[-1, 1] = 1
    """-1 where the sensor counts against the unit: roll is positive clockwise as seen along the beam."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Added after the sign, for how the sensor is mounted."""
    sign_pitch: Literal[-1, 1] = 1
    """The same of the second axis, where there is one; positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    max_divergence_deg: Annotated[float, Field(gt=0, le=10)] = 0.5
    """With two axes: a slow change of the beam's inclination against gravity by more is warned of."""


class GrblStageSettings(Table):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    In the controller's coordinates the stage is sent to sign · position + offset.
    """

    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Device
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
    """``serpentine`` runs every second row backwards, the shortest way; ``rows`` begins each row at the
    smallest x, so that a stage with play comes to every node from the same side."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 2
    """Exposures a node."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Time from standstill, or from switching the LEDs, until exposures count."""
    led_pairs: Annotated[int, Field(ge=0, le=100)] = 2
    """LED reference pairs (off, on) before the grid, and as many after it. Those before it are a self-check
    against the calibration so far."""
    when_bad: Literal["stop", "warning"] = "stop"
    """What follows where that self-check is bad; ``warning`` calibrates the unit as it is now."""
    retries: Annotated[int, Field(ge=0, le=100)] = 2
    """How often a node with a bad spot is exposed again before it is refused."""
