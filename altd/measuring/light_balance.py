"""The light of the targets' spots against each other: one beam lights them all."""

from __future__ import annotations

import math

import numpy as np

from altd.records import FloatArray, MeanSpots, SpotShape

_USUAL = 0.02
"""A change of the logarithm of the ratio that needs no cause: at rest 0.008 at most (clean, dusty and shaking
units, simulated, and the recorded one), steps of the cameras' exposure 0.01."""
_PER_RADIUS = 0.02
"""Change of the ratio per 1/e² radius that the spots move, by the lenses' fall-off: 0.018 at most."""
_PER_S = 0.2 / 3600
"""Dust and ageing are slower; after a window was cleaned it takes some time until sigma is as before."""
_STEP_RADII = 0.5
"""Vibration, which moves the spots by less, does not add up."""
_NOISE_SIGMAS = 6.0


class LightBalance:
    """Follows the ratio of each target's light to the first one's, and finds quick changes.

    A second light that lies near the spot of one target shifts it, and hardly changes its shape: only the
    light grows. Light on all targets alike does not show, nor does light that was there from the start.
    """

    def __init__(self) -> None:
        self._ratios: FloatArray | None = None
        self._px = np.empty((0, 2))
        self._t_ns = 0

    def changed_light(self, mean: MeanSpots) -> tuple[float, ...]:
        """The share by which the mean light of each target has changed against the first one's.

        0 where no exposure differs more than is usual. Empty where a spot's light or shape is not known.
        """
        if mean.log_lights is None or not np.isfinite(mean.log_lights).all() or None in mean.shapes:
            return ()
        logs, sigmas = np.moveaxis(mean.log_lights, 2, 0)
        ratios = logs[:, 1:] - logs[:, :1]
        mean_ratios = ratios.mean(axis=0)
        since_s = (mean.t_ns - self._t_ns) * 1e-9
        if self._ratios is None or since_s < 0:
            self._ratios, self._px, since_s = mean_ratios, mean.px, 0.0
        self._t_ns = mean.t_ns
        radii_px = np.array([_radius_px(shape) for shape in mean.shapes if shape is not None])
        moved_radii = np.linalg.norm(mean.px - self._px, axis=1) / radii_px
        by_place = _PER_RADIUS * (moved_radii[1:] + moved_radii[0])
        follow = np.full_like(mean_ratios, _PER_S * since_s)
        if moved_radii.max() > _STEP_RADII:
            follow += by_place
            self._px, by_place = mean.px, 0.0 * by_place
        self._ratios = self._ratios + np.clip(mean_ratios - self._ratios, -follow, follow)
        usual = _USUAL + by_place + _NOISE_SIGMAS * np.hypot(sigmas[:, 1:], sigmas[:, :1]).mean(axis=0)
        largest = np.maximum(np.abs(ratios - self._ratios).max(axis=0), usual)
        share = np.sqrt(1 - np.square(usual / largest))
        changed = np.expm1(np.abs(mean_ratios - self._ratios)) * share
        return (0.0, *changed.tolist())


def _radius_px(shape: SpotShape) -> float:
    """The mean 1/e² radius."""
    return math.sqrt(2 * 2 ** (1 / shape.order) / math.sqrt(shape.a * shape.c - shape.b**2))
