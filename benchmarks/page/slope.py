"""How fast something grows, with the uncertainty of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_BLOCKS = 10
_SIGMAS = 3.0
_NOTEWORTHY_SHARE = 0.01


@dataclass(frozen=True, slots=True)
class Slope:
    """Per hour, with its standard error; ``median`` and ``highest`` of the values themselves."""

    per_h: float
    sigma_per_h: float
    median: float
    highest: float

    @property
    def grows(self) -> bool:
        """Whether it grows beyond chance, and by more than 1 % of itself an hour."""
        return self.per_h > max(_SIGMAS * self.sigma_per_h, _NOTEWORTHY_SHARE * self.median)


def slope_of(t_s: Sequence[float], values: Sequence[float]) -> Slope:
    """The straight line of least squares through the means of up to ten spans; it takes six values at least.

    Neighbouring values are no chance of their own: a heap fills and is emptied. So the scatter of means about
    the line gives the standard error (GUM, H.3.3), not that of single values.
    """
    if len(values) < 6:
        raise ValueError(f"{len(values)} values show no slope")
    blocks = min(_BLOCKS, len(values) // 2)
    t_h = np.array([part.mean() for part in np.array_split(np.asarray(t_s) / 3600, blocks)])
    means = np.array([part.mean() for part in np.array_split(np.asarray(values, float), blocks)])
    about_h = t_h - t_h.mean()
    per_h = float(about_h @ means / (about_h @ about_h))
    residuals = means - means.mean() - per_h * about_h
    variance = float(residuals @ residuals) / (blocks - 2)
    sigma = float(np.sqrt(variance / (about_h @ about_h)))
    return Slope(per_h, sigma, float(np.median(values)), float(np.max(values)))
