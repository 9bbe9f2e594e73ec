"""What a window of exposures shows of the motion of its spots."""

from __future__ import annotations

import numpy as np

from altd.records import FloatArray
from altd.records.motion import SpotMotion


def spot_motion(
    deviations_px: FloatArray,
    since_middle_s: FloatArray,
    exposure_covariance_px2: FloatArray,
    noise_px: FloatArray,
    newest: tuple[FloatArray, float] | None,
) -> SpotMotion:
    """The motion of n exposures without outliers.

    ``deviations_px`` (n, coordinates) are from their mean, at ``since_middle_s`` (n,) from the mean of their
    times; ``exposure_covariance_px2`` is that of one exposure about steady motion, ``noise_px`` the spots'
    own. ``newest`` holds deviation and time of the newest exposure where that is an outlier: a beam that
    begins to move is first seen as one, and the mean stands still meanwhile.
    """
    square_s2 = float(since_middle_s @ since_middle_s)
    rate = since_middle_s @ deviations_px / square_s2
    last_s = float(since_middle_s[-1])
    onset = np.zeros_like(rate)
    if newest is not None:
        newest_px, newest_s = newest
        onset = (newest_px - rate * newest_s) / (newest_s - last_s)
    return SpotMotion(
        rate_px_per_s=rate,
        rate_covariance=exposure_covariance_px2 / square_s2,
        vibration_px2=exposure_covariance_px2 - np.diag(np.square(noise_px)),
        onset_px_per_s=onset,
        onset_s=last_s,
        spread_s2=square_s2 / len(since_middle_s),
        span_s=last_s - float(since_middle_s[0]),
    )
