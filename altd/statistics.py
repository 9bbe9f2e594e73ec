"""Median, and the standard deviation by the median absolute deviation (MAD), of some hundred values."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian values over their median absolute deviation."""


def median(values: npt.NDArray[Any], axis: int = -1) -> npt.NDArray[Any]:
    """``np.median`` along one axis of finite values; that one spends ten times as long on its checks."""
    ordered = np.sort(values, axis=axis)
    count = values.shape[axis]
    both = ordered.take((count - 1) // 2, axis=axis) + ordered.take(count // 2, axis=axis)
    middle: npt.NDArray[Any] = both / values.dtype.type(2)
    return middle


def mad_sigma(magnitudes: npt.NDArray[Any]) -> float:
    """Standard deviation of values whose deviations have these magnitudes, (n,); outliers hardly count."""
    return MAD_TO_SIGMA * float(median(magnitudes))
