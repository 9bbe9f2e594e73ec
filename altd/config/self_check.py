"""The self-check: when the frame LEDs are lit, what is allowed, and what follows from the verdict."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.complaints import complaint
from altd.config.table import Table

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
