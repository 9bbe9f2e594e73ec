"""Light of the targets' spots relative to each other: one beam lights them all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray, MeanSpots, SpotShape

_USUAL = 0.02
"""Change of the logarithm of the ratio that needs no cause: at most 0.008 at rest (clean, dusty and shaking
units, simulated, and the recorded one), 0.01 with steps of the cameras' exposure time."""
_PER_RADIUS = 0.02
"""Change of the ratio per 1/e² radius that the spots move, by the lenses' fall-off: 0.018 at most."""
_PER_S = 0.2 / 3600
"""Allowed change, 1/s. Dust and ageing are slower; after cleaning a window sigma takes time to recover."""
_STEP_RADII = 0.5
"""Minimum motion of the spots, in radii, that is added up; vibration moves them by less."""
_NOISE_SIGMAS = 6.0
_RESTART_S = 10.0
"""Minimum step back in time of another recording, s; outliers set the middle of a window back by less."""


class LightBalance:
    """Follows the ratio of each target's light to the first one's, and finds quick changes.

    A second light near the spot of one target shifts it, and hardly changes its shape: only the light
    increases. Light on all targets alike, and light that was present from the start, cannot be detected.
    """

    def __init__(self) -> None:
        self._seen: _Seen | None = None
        """Last window that was measured, with the ratios as followed up to then."""

    def changed_light(self, mean: MeanSpots) -> tuple[float, ...]:
        """Return the share by which the mean light of each target changed relative to the first one's.

        0 if no frame set differs more than usual; empty if a spot's light or shape is not known.
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

    def update(self, mean: MeanSpots) -> None:
        """Follow the light of a window that gave a valid measurement.

        From others the ratio would adapt to what it must reveal: a lamp in place of the beam.
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
    """Logarithms of the ratios (targets − 1,), and the spots' positions and radii when last followed."""

    t_ns: int
    ratios: FloatArray
    px: FloatArray
    radii_px: FloatArray

    def by_place(self, mean: MeanSpots) -> FloatArray:
        """Return the change of the ratios that the motion since then may have caused."""
        moved_radii = np.linalg.norm(mean.px - self.px, axis=1) / self.radii_px
        changed: FloatArray = _PER_RADIUS * (moved_radii[1:] + moved_radii[0])
        return changed

    def by_time(self, mean: MeanSpots) -> float:
        """Return the change of the ratios that the time since then may have caused."""
        return _PER_S * 1e-9 * max(mean.t_ns - self.t_ns, 0)

    def is_of_another_run(self, mean: MeanSpots) -> bool:
        """Return whether the time has restarted since then."""
        return mean.t_ns < self.t_ns - _RESTART_S * 1e9


def _known(mean: MeanSpots) -> FloatArray:
    """Return the lights (frame sets, targets, 2) of frame sets with all known; none without shapes."""
    if mean.log_lights is None or None in mean.shapes:
        return np.empty((0, len(mean.targets), 2))
    known: FloatArray = mean.log_lights[np.isfinite(mean.log_lights).all(axis=(1, 2))]
    return known


def _radius_px(shape: SpotShape) -> float:
    """Return the mean 1/e² radius of a shape, px."""
    return math.sqrt(2 * 2 ** (1 / shape.order) / math.sqrt(shape.a * shape.c - shape.b**2))
