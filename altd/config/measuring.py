"""How exposures become measurements, how the unit checks itself, and when it asks for maintenance."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.table import Celsius, Name, Table, complaint


class Measuring(Table):
    """How exposures become measurements."""

    window: Annotated[int, Field(ge=1, le=1000)] = 20
    """Exposures that are averaged."""
    every: Annotated[int, Field(ge=1, le=1000)] = 1
    """A measurement after this many exposures: 1 is the sliding mean."""
    output: Literal["mean", "now"] = "mean"
    """`mean` of the window, about half a second old when it is new; or where its steady motion is `now`, at
    the newest exposure: no lag, more noise (`accuracy.md`)."""
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


LimitMillimetres = Annotated[float, Field(gt=0, le=10)]
LimitDegrees = Annotated[float, Field(gt=0, le=10)]


class SelfCheckSettings(Table):
    """The self-check: LEDs on for some exposures between the others."""

    enabled: bool = True
    """Check at the start, on a schedule and after a shock; false: only when asked."""
    interval_s: Annotated[float, Field(ge=10, le=86_400)] = 600.0
    """From one check to the next."""
    exposures: Annotated[int, Field(ge=2, le=20)] = 4
    """Exposures with the LEDs on, and as many with them off before and after. One or two more are lost while
    the LEDs are switched; those with the LEDs off are measured as ever."""
    suspect_mm: LimitMillimetres = 0.03
    """A drift that would move a place on a target by more is worth a warning."""
    suspect_deg: LimitDegrees = 0.01
    """The same for yaw and pitch."""
    bad_mm: LimitMillimetres = 0.1
    """A drift that would move a place on a target by more is bad."""
    bad_deg: LimitDegrees = 0.03
    """The same for yaw and pitch."""
    when_bad: Literal["invalid", "warning"] = "invalid"
    """What a bad verdict makes of the measurements."""
    when_unknown: Literal["invalid", "warning"] = "warning"
    """What a check that ends without a verdict, or without one on a part of the unit, makes of them; also a
    shock until the check after it has ended."""
    compensate: bool = False
    """Take out of the measurement what drift a check has proven; the measurement carries a warning. Ends
    when no check has had a verdict for three times ``interval_s``."""
    compensate_mm: LimitMillimetres = 0.5
    """No place is corrected by more than that; with a larger drift nothing is corrected."""

    @model_validator(mode="after")
    def _suspect_before_bad(self) -> Self:
        for suspect, bad in (("suspect_mm", "bad_mm"), ("suspect_deg", "bad_deg")):
            low, high = getattr(self, suspect), getattr(self, bad)
            if low > high:
                raise complaint(((suspect,), f"{low:g} is above {bad}; possible: up to {high:g}"))
        return self


class Maintenance(Table):
    """When the unit asks for maintenance."""

    calibration_due_days: Annotated[float, Field(gt=0, le=36500)] = 365.0
    """A calibration that is older than this is due."""
    min_light_share: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """A spot with less than this share of its reference's light, for equal exposure and gain, has a weak
    laser or a dirty window. The reference is the first half hour since the daemon started; 0 switches this
    off."""
    max_dust_share: Annotated[float, Field(gt=0, le=1)] = 0.0005
    """How much of the area under a spot dust may cover that was not there at the calibration."""
    max_residual_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    """How near to what makes a spot `distorted` the residuals of its fit may come."""


class HwmonThermometerSettings(Table):
    """A temperature that the kernel's hwmon tells."""

    driver: Literal["hwmon"]
    name: Name
    """The name in all outputs; small letters, digits and _."""
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """What the file `name` of the chip says, as in `/sys/class/hwmon/hwmon0/name`."""
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    """The number in `temp1_input`."""
    min_celsius: Celsius = -10.0
    """Below this the unit is out of its specification; App. A.1.5 for the air around it."""
    max_celsius: Celsius = 60.0
    """Above this, likewise. A processor's own temperature may be allowed more."""
