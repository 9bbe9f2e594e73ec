"""How exposures become measurements."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from altd.config.table import Table


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
