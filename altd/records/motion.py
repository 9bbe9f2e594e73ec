"""How a beam moves: that of the mean spots in their pictures, and that of a quantity, with what may follow.

A value is the mean of a window that lies in the past. What is said here is how far the truth may be from it
since (``Motion.variance_since``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True, eq=False)
class SpotMotion:
    """How the mean spots of a window move, u and v of one target after the other, (2 · targets,).

    ``rate_px_per_s`` is the steady motion, ``rate_covariance`` its covariance, px²/s². ``vibration_px2`` is
    the covariance of a single exposure about the steady motion without the spots' own noise: an estimate, of
    which a variance may come out negative. ``onset_px_per_s`` is how fast the newest exposure left the others
    if it is an outlier, else zero, and ``onset_s`` when the last of the others was; ``spread_s2`` is the mean
    square of the exposures' times. Times count from the middle of the exposures, ``span_s`` is from the first
    to the last.
    """

    rate_px_per_s: npt.NDArray[np.float64]
    rate_covariance: npt.NDArray[np.float64]
    vibration_px2: npt.NDArray[np.float64]
    onset_px_per_s: npt.NDArray[np.float64]
    onset_s: float
    spread_s2: float
    span_s: float


@dataclass(frozen=True, slots=True)
class Motion:
    """How one quantity moves, in its own unit and per second.

    ``rate`` with ``sigma_rate`` is that of the window. ``vibration`` is the standard deviation of the truth
    about the steady motion. ``probable_rate`` is the root mean square of what the rate may be,
    ``acceleration`` of its change in a second, both by the windows before; None: not known yet. ``onset``,
    ``onset_s`` and ``spread_s2`` are as in ``SpotMotion``.
    """

    rate: float
    sigma_rate: float
    vibration: float
    onset: float
    onset_s: float
    spread_s2: float
    probable_rate: float | None = None
    acceleration: float | None = None

    def variance_since(self, age_s: float) -> float | None:
        """Mean square of how far the truth is from the window's mean, ``age_s`` after its middle.

        Beyond the variance of the mean itself. None: not known. A mean of uniformly accelerated motion is
        ahead of the middle by half the acceleration times ``spread_s2``. Vibration counts in full at any age:
        at some 20 exposures a second nobody can tell 2 Hz from 22, so its phase is not known. Rate and
        acceleration are taken as independent, for one may end or turn at any time.
        """
        if self.probable_rate is None or self.acceleration is None:
            return None
        return (
            self.vibration**2
            + (self.probable_rate * age_s) ** 2
            + (0.5 * self.acceleration * (age_s**2 - self.spread_s2)) ** 2
            + (self.onset * max(age_s - self.onset_s, 0.0)) ** 2
        )
