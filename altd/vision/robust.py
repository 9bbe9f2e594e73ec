"""Median, and the standard deviation by the median absolute deviation (MAD), of some hundred values."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian values over their median absolute deviation."""


def median(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """``np.median`` along the last axis; that one spends ten times as long on its checks."""
    ordered = np.sort(values, axis=-1)
    count = values.shape[-1]
    middle: npt.NDArray[Any] = (
        ordered[..., (count - 1) // 2] + ordered[..., count // 2]
    ) / values.dtype.type(2)
    return middle


def mad_sigma(magnitudes: npt.NDArray[Any]) -> float:
    """Standard deviation of values whose deviations have these magnitudes, (n,); outliers hardly count."""
    return MAD_TO_SIGMA * float(median(magnitudes))
