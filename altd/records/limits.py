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
    scan. ``plate_mm`` is the place of a plate on the first target, the zero of x and y. The others are of a
    plate on each target, independent from target to target: its turn about z, and its tilt over the distance
    of the camera.
    Raises ValueError for a number that is not a possible uncertainty.
    """

    stage_mm: float | None = None
    stage_scale_ppm: float | None = None
    stage_square_mrad: float | None = None
    beam_normal_mm_per_m: float | None = None
    target_distance_mm: float | None = None
    temperature_k: float | None = None
    plate_mm: float | None = None
    plate_turn_mrad: float | None = None
    plate_keystone_per_m: float | None = None

    def __post_init__(self) -> None:
        for key in LIMIT_KEYS:
            sigma = getattr(self, key)
            most = MAX_SCALE_PPM if key == "stage_scale_ppm" else MAX_LIMIT
            if sigma is not None and not (math.isfinite(sigma) and 0.0 <= sigma <= most):
                raise ValueError(f"{key}: {sigma:g} is not an uncertainty; possible: 0 to {most:g}")

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Keys of the uncertainties that are None; a scan has none of ``PLATE_KEYS``."""
        return tuple(key for key in LIMIT_KEYS if key not in PLATE_KEYS and getattr(self, key) is None)


LIMIT_KEYS = tuple(field.name for field in fields(Limits))
PLATE_KEYS = tuple(key for key in LIMIT_KEYS if key.startswith("plate_"))
ALUMINIUM_PER_K = 23.6e-6
"""Linear expansion of aluminium 6061 (Callister, Materials Science and Engineering, Table B.6)."""
MAX_LIMIT = 1000.0
"""Maximum of each uncertainty in its own unit; a larger value is a mistake of the unit."""
MAX_SCALE_PPM = 50_000.0
"""Maximum of ``stage_scale_ppm``: that of a plate may be measured with a ruler."""

NO_LIMITS = Limits()
"""Uncertainties of which none is stated."""
