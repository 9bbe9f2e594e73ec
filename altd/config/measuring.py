"""Settings of measuring: averaging, self-checks, the limits of maintenance, and ``altd scan``."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.files.table import Celsius, StageMillimetres, Table, complaint
from altd.records.limits import MAX_LIMIT, Limits


class Measuring(Table):
    """Averaging of exposures into measurements."""

    window: Annotated[int, Field(ge=1, le=1000)] = 20
    """Number of averaged exposures."""
    every: Annotated[int, Field(ge=1, le=1000)] = 1
    """Exposures from one measurement to the next; 1: sliding mean."""
    output: Literal["mean", "now"] = "mean"
    """`mean`: mean of the window, about 0.5 s old; `now`: value at the newest exposure, no lag, more noise
    (`accuracy.md`)."""
    pair_by: Literal["sequence", "time"] = "sequence"
    """Pair frames by number (``sequence``: recordings) or by time (``time``: live cameras, their default)."""
    max_skew_ms: Annotated[float, Field(gt=0, le=1000)] = 10.0
    """Largest time difference between paired frames, ms, after a steady lag is subtracted (`time`). Jitter of
    free-running cameras may exceed it (`cameras.md`)."""
    max_lag_ms: Annotated[float, Field(gt=0, le=1000)] = 40.0
    """Largest steady lag of one camera, ms; free-running cameras: up to half a period."""

    @property
    def max_skew_ns(self) -> int:
        """``max_skew_ms`` in ns, the unit of the frames' times."""
        return round(self.max_skew_ms * 1e6)

    @property
    def max_lag_ns(self) -> int:
        """``max_lag_ms`` in ns, the unit of the frames' times."""
        return round(self.max_lag_ms * 1e6)

    max_sigma_mm: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """Limit of a displacement's scatter (`sigma_random`), mm; above it: ``unsteady``, or ``distorted`` by its
    light."""
    max_sigma_mm_per_m: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """Limit of the scatter of yaw and pitch, mm/m, as for ``max_sigma_mm``."""
    vibration_mm: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Amplitude of the machine's vibration in x and in y, mm; 0: none stated. It is in sigma while the unit
    samples evenly, as a vibration near a multiple of the frame rate then shows no scatter (`accuracy.md`)."""
    vibration_mrad: Annotated[float, Field(ge=0, le=10)] = 0.0
    """The same of yaw and pitch, mrad."""
    silent_after_s: Annotated[float, Field(gt=0, le=2)] = 0.4
    """Time without frames after which a camera is silent, s."""
    stale_after_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    """Age of its last exposure, s, above which a value is withdrawn. Must exceed the time of ``every``
    exposures."""


LimitMillimetres = Annotated[float, Field(gt=0, le=10)]
LimitDegrees = Annotated[float, Field(gt=0, le=10)]


class SelfCheckSettings(Table):
    """The self-check: frame LEDs are lit for some exposures."""

    enabled: bool = True
    """Check at the start, on a schedule and after a shock; false: on request only."""
    interval_s: Annotated[float, Field(ge=10, le=86_400)] = 600.0
    """Time between checks, s."""
    exposures: Annotated[int, Field(ge=2, le=20)] = 4
    """Exposures with the LEDs on, and as many off before and after. Exposures with LEDs on, and one or two
    while switching, are not measured."""
    suspect_mm: LimitMillimetres = 0.03
    """Drift of a point on a target, mm, above which there is a warning."""
    suspect_deg: LimitDegrees = 0.01
    """Drift of yaw or pitch, degrees, above which there is a warning."""
    bad_mm: LimitMillimetres = 0.1
    """Drift of a point on a target, mm, above which the verdict is bad."""
    bad_deg: LimitDegrees = 0.03
    """Drift of yaw or pitch, degrees, above which the verdict is bad."""
    when_bad: Literal["invalid", "warning"] = "invalid"
    """Effect of a bad verdict on measurements."""
    when_unknown: Literal["invalid", "warning"] = "warning"
    """Effect of a missing verdict, and of a shock until the check after it has ended."""
    compensate: bool = False
    """Correct the measurement by a proven drift, with a warning. Ends after three ``interval_s`` without a
    verdict."""
    compensate_mm: LimitMillimetres = 0.5
    """Largest correction, mm; a larger drift is not corrected."""

    @model_validator(mode="after")
    def _suspect_before_bad(self) -> Self:
        for suspect, bad in (("suspect_mm", "bad_mm"), ("suspect_deg", "bad_deg")):
            low, high = getattr(self, suspect), getattr(self, bad)
            if low > high:
                raise complaint(((suspect,), f"{low:g} is above {bad}; possible: up to {high:g}"))
        return self


class Maintenance(Table):
    """Limits above or below which the unit requires maintenance."""

    calibration_due_days: Annotated[float, Field(gt=0, le=36500)] = 365.0
    """Age at which a calibration is due, days."""
    min_light_share: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Lower limit of a spot's light as a share of the first half hour since the start; 0: off."""
    max_dust_share: Annotated[float, Field(gt=0, le=1)] = 0.0005
    """Upper limit of the share of the area under a spot that new dust covers."""
    max_residual_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Upper limit of the residuals as a share of those that make a spot `distorted`."""


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
    seat_mm_per_m: Uncertainty = None
    """Scatter of the unit's z axis from one seating to the next, mm/m, 1 sigma per axis (`verify.md`)."""
    deflection_yaw_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Known deflection of the beam to +x of the stage, degrees, as by a wedge. For a verification only
    (`verify.md`)."""
    deflection_pitch_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """The same to +y, degrees."""
    deflection_sigma_deg: Uncertainty = None
    """Standard uncertainty of the deflection, per axis, degrees."""
    temperature_c: Celsius | None = None
    """Temperature of the frame in the scan, °C, if it is known."""
    limits: ScanLimits = ScanLimits()
    """Uncertainties that the scan cannot measure."""
    flat_pitch_mm: Annotated[float, Field(ge=1, le=20)] = 2.5
    """Step of ``altd scan --flat``, mm: a quarter of the spot's diameter, at most half of it."""
    flat_margin_mm: Annotated[float, Field(ge=0, le=100)] = 10.0
    """Reach of ``altd scan --flat`` beyond the grid, mm: three quarters of a spot diameter, where
    possible."""
