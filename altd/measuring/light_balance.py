"""The light of the targets' spots against each other: one beam lights them all."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
_RESTART_S = 10.0
"""Outliers may set the middle of a window back by less; another recording begins earlier by more."""


class LightBalance:
    """Follows the ratio of each target's light to the first one's, and finds quick changes.

    A second light that lies near the spot of one target shifts it, and hardly changes its shape: only the
    light grows. Light on all targets alike does not show, nor does light that was there from the start.
    """

    def __init__(self) -> None:
        self._seen: _Seen | None = None
        """The last window that was measured, with the ratios as followed up to there."""

    def changed_light(self, mean: MeanSpots) -> tuple[float, ...]:
        """The share by which the mean light of each target has changed against the first one's.

        0 where no exposure differs more than is usual. Empty where a spot's light or shape is not known.
        """
        lights = _known(mean)
        if not len(lights):
            return ()
        seen = self._seen
        if seen is None or seen.is_of_another_run(mean):
            return (0.0,) * len(mean.targets)
        logs, sigmas = np.moveaxis(lights, 2, 0)
        differences = logs[:, 1:] - logs[:, :1] - seen.ratios
        noise = np.hypot(sigmas[:, 1:], sigmas[:, :1]).mean(axis=0)
        usual = _USUAL + seen.by_place(mean) + seen.by_time(mean) + _NOISE_SIGMAS * noise
        largest = np.maximum(np.abs(differences).max(axis=0), usual)
        share = np.sqrt(1 - np.square(usual / largest))
        changed = np.expm1(np.abs(differences.mean(axis=0))) * share
        return (0.0, *changed.tolist())

    def learn(self, mean: MeanSpots) -> None:
        """Follow the light of a window that gave a valid measurement.

        From others the ratio would learn what it is to reveal: a lamp in place of the beam.
        """
        lights = _known(mean)
        if not len(lights):
            return
        logs = lights[:, :, 0].mean(axis=0)
        ratios, px, t_ns, seen = logs[1:] - logs[0], mean.px, mean.t_ns, self._seen
        if seen is not None and not seen.is_of_another_run(mean):
            t_ns = max(t_ns, seen.t_ns)
            by_place = seen.by_place(mean)
            follow = np.full_like(by_place, seen.by_time(mean))
            if by_place.max() > _PER_RADIUS * _STEP_RADII:
                follow += by_place
            else:
                px = seen.px
            ratios = seen.ratios + np.clip(ratios - seen.ratios, -follow, follow)
        radii_px = np.array([_radius_px(shape) for shape in mean.shapes if shape is not None])
        self._seen = _Seen(t_ns, ratios, px, radii_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The logarithms of the ratios (targets − 1,), and where the spots were when they were last followed."""

    t_ns: int
    ratios: FloatArray
    px: FloatArray
    radii_px: FloatArray

    def by_place(self, mean: MeanSpots) -> FloatArray:
        """The change of the ratios that the motion since then may have made."""
        moved_radii = np.linalg.norm(mean.px - self.px, axis=1) / self.radii_px
        changed: FloatArray = _PER_RADIUS * (moved_radii[1:] + moved_radii[0])
        return changed

    def by_time(self, mean: MeanSpots) -> float:
        """The same of the time since then."""
        return _PER_S * 1e-9 * max(mean.t_ns - self.t_ns, 0)

    def is_of_another_run(self, mean: MeanSpots) -> bool:
        """Whether time has begun again since then."""
        return mean.t_ns < self.t_ns - _RESTART_S * 1e9


def _known(mean: MeanSpots) -> FloatArray:
    """The lights (exposures, targets, 2) of the exposures in which all are known; none without the shapes."""
    if mean.log_lights is None or None in mean.shapes:
        return np.empty((0, len(mean.targets), 2))
    known: FloatArray = mean.log_lights[np.isfinite(mean.log_lights).all(axis=(1, 2))]
    return known


def _radius_px(shape: SpotShape) -> float:
    """The mean 1/e² radius."""
    return math.sqrt(2 * 2 ** (1 / shape.order) / math.sqrt(shape.a * shape.c - shape.b**2))
