"""Uncertainties of a calibration that a scan cannot measure (docs/budget.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class Limits:
    """Standard uncertainties (1 sigma) of stage, beam and targets, per axis; None: not stated, counts as 0.

    ``stage_mm`` is independent from node to node, each of the others is one value for the whole scan:
    ``stage_scale_ppm`` of the stage's length, ``stage_square_mrad`` of the angle between its axes,
    ``beam_normal_mm_per_m`` of the beam against the targets' normal, ``target_distance_mm`` of the distance
    from the first target to another one, ``temperature_k`` of the frame's temperature against that of the
    scan. Raises ValueError for a number that is not a possible uncertainty.
    """

    stage_mm: float | None = None
    stage_scale_ppm: float | None = None
    stage_square_mrad: float | None = None
    beam_normal_mm_per_m: float | None = None
    target_distance_mm: float | None = None
    temperature_k: float | None = None

    def __post_init__(self) -> None:
        for key in LIMIT_KEYS:
            sigma = getattr(self, key)
            if sigma is not None and not (math.isfinite(sigma) and 0.0 <= sigma <= MAX_LIMIT):
                raise ValueError(f"{key}: {sigma:g} is not an uncertainty; possible: 0 to {MAX_LIMIT:g}")

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Keys of the uncertainties that are None."""
        return tuple(key for key in LIMIT_KEYS if getattr(self, key) is None)


LIMIT_KEYS = tuple(field.name for field in fields(Limits))
ALUMINIUM_PER_K = 23.6e-6
"""Linear expansion of aluminium 6061 (Callister, Materials Science and Engineering, Table B.6)."""
MAX_LIMIT = 1000.0
"""Maximum of each uncertainty in its own unit; a larger value is a mistake of the unit."""

NO_LIMITS = Limits()
"""Uncertainties of which none is stated."""
