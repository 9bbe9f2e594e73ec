"""The Cramér-Rao bound: how well anybody could locate a spot in given noise."""

from collections.abc import Callable, Sequence

import numpy as np

from altd.records import FloatArray

_STEP = 1e-4


def cramer_rao(
    mean: Callable[[FloatArray], FloatArray], parameters: Sequence[float], variance: FloatArray
) -> FloatArray:
    """Smallest covariance (n, n) of any unbiased estimate of ``parameters`` (n,).

    ``mean`` gives the expected picture (any shape) for parameters; ``variance`` (same shape) is that of each
    pixel, noise independent and Gaussian with a variance taken as known. The inverse of the Fisher
    information Jᵀ V⁻¹ J, with the derivatives by central differences. Raises numpy.linalg.LinAlgError when
    the picture does not tell the parameters apart.
    """
    point = np.asarray(parameters, dtype=np.float64)
    jacobian = []
    for index, value in enumerate(point):
        step = np.zeros_like(point)
        step[index] = _STEP * max(1.0, abs(value))
        jacobian.append(((mean(point + step) - mean(point - step)) / (2 * step[index])).ravel())
    rows = np.array(jacobian)
    covariance: FloatArray = np.linalg.inv((rows / variance.ravel()) @ rows.T)
    return covariance
