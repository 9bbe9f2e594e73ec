"""Settings of measuring: averaging, self-checks, and the limits of maintenance."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.table import Celsius, Name, Table, complaint


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
    """Largest time difference between paired frames, ms, after a steady lag is subtracted (`time`)."""
    max_lag_ms: Annotated[float, Field(gt=0, le=1000)] = 30.0
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


class HwmonThermometerSettings(Table):
    """A temperature of the kernel's hwmon."""

    driver: Literal["hwmon"]
    name: Name
    """Name in all outputs."""
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Content of the chip's file `name`, as in `/sys/class/hwmon/hwmon0/name`."""
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    """Number of the channel, as in `temp1_input`."""
    min_celsius: Celsius = -10.0
    """Temperature below which the unit is out of specification, °C."""
    max_celsius: Celsius = 60.0
    """Temperature above which the unit is out of specification, °C. A processor may be allowed more."""
