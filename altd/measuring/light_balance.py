"""Light of the targets' spots relative to each other: one beam lights them all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray, MeanSpots, SpotShape
from altd.vision.settings import LightReference

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
_MAP_SIGMAS, _MAP_NOISE_SIGMAS = 1.5, 2.0
"""Change that needs no cause where the calibration contains the light over the targets, in sigmas of a place
and of the noise. Behind films errors are then 1.1 to 1.3 sigmas rms, and one undisturbed sigma in ten or
twenty is three times as large; from 2 sigmas of a place on, 1.2 to 1.5, and hardly any."""
_PER_RADIUS_OF_MAP = 0.004
"""Change per radius that is followed there: the light that a target scatters depends on the beam's angle."""
_RESTART_S = 10.0
"""Minimum step back in time of another recording, s; outliers set the middle of a window back by less."""


class LightBalance:
    """Follows the ratio of each target's light to the first one's, and finds quick changes.

    A second light near the spot of one target shifts it, and hardly changes its shape: only the light
    increases. A film on one target shifts its spot, and takes light. What is on all targets alike cannot be
    detected, nor what was present from the start, unless the calibration contains the light over each target
    (``references``): then the ratio starts at the calibrated one.
    """

    def __init__(self, references: Sequence[LightReference | None] = ()) -> None:
        known = [reference for reference in references if reference is not None]
        self._maps = np.array([reference.log_light for reference in known if len(known) == len(references)])
        sigma = np.array([reference.sigma for reference in known])
        self._usual = _MAP_SIGMAS * np.hypot(sigma[1:], sigma[:1])
        self._per_radius = _PER_RADIUS_OF_MAP if len(self._maps) else _PER_RADIUS
        self._seen: _Seen | None = None
        """Last window that was measured, with the ratios as followed up to then."""

    def changed_light(self, mean: MeanSpots) -> tuple[float, ...]:
        """Return the share by which the mean light of each target changed relative to the first one's.

        0 if no frame set differs more than usual; empty if a spot's light or shape is not known.
        """
        lights = self._known(mean)
        if not len(lights):
            return ()
        logs, sigmas = np.moveaxis(lights, 2, 0)
        differences = logs[:, 1:] - logs[:, :1]
        noise = np.hypot(sigmas[:, 1:], sigmas[:, :1]).mean(axis=0)
        if len(self._maps):
            usual = np.hypot(self._usual, _MAP_NOISE_SIGMAS * noise)
        else:
            usual = _USUAL + _NOISE_SIGMAS * noise
        seen = self._seen
        if seen is not None and not seen.is_of_another_run(mean):
            differences = differences - seen.ratios
            usual = usual + self._per_radius * seen.moved_radii(mean) + seen.by_time(mean)
        elif not len(self._maps):
            return (0.0,) * len(mean.targets)
        mean_change, largest = np.abs(differences.mean(axis=0)), np.abs(differences).max(axis=0)
        if len(self._maps):  # the limit is near the noise of single exposures
            largest = np.maximum(largest - _NOISE_SIGMAS * noise, mean_change)
        share = np.sqrt(1 - np.square(usual / np.maximum(largest, usual)))
        changed = np.expm1(mean_change) * share
        return (0.0, *changed.tolist())

    def update(self, mean: MeanSpots) -> None:
        """Follow the light of a window that gave a valid measurement.

        From others the ratio would adapt to what it must reveal: a lamp in place of the beam.
        """
        lights = self._known(mean)
        if not len(lights):
            return
        logs = lights[:, :, 0].mean(axis=0)
        ratios, px, t_ns, seen = logs[1:] - logs[0], mean.px, mean.t_ns, self._seen
        if seen is None or seen.is_of_another_run(mean):
            ratios = np.zeros_like(ratios) if len(self._maps) else ratios
        else:
            t_ns = max(t_ns, seen.t_ns)
            by_place = self._per_radius * seen.moved_radii(mean)
            follow = np.full_like(by_place, seen.by_time(mean))
            if by_place.max() > self._per_radius * _STEP_RADII:
                follow += by_place
            else:
                px = seen.px
            ratios = seen.ratios + np.clip(ratios - seen.ratios, -follow, follow)
        radii_px = np.array([_radius_px(shape) for shape in mean.shapes if shape is not None])
        self._seen = _Seen(t_ns, ratios, px, radii_px)

    def _known(self, mean: MeanSpots) -> FloatArray:
        """Return the lights (frame sets, targets, 2) of frame sets with all known; none without shapes.

        They are relative to the calibration's at the spots' places if it contains them.
        """
        if mean.log_lights is None or None in mean.shapes:
            return np.empty((0, len(mean.targets), 2))
        known: FloatArray = mean.log_lights[np.isfinite(mean.log_lights).all(axis=(1, 2))]
        if len(self._maps):
            expected = (LightReference.powers(mean.px) * self._maps).sum(axis=1)
            known = known - np.stack([expected, np.zeros_like(expected)], axis=1)
        return known


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Logarithms of the ratios (targets − 1,), and the spots' positions and radii when last followed."""

    t_ns: int
    ratios: FloatArray
    px: FloatArray
    radii_px: FloatArray

    def moved_radii(self, mean: MeanSpots) -> FloatArray:
        """Return by how many radii each target's spot and the first one have moved since then, in sum."""
        moved_radii = np.linalg.norm(mean.px - self.px, axis=1) / self.radii_px
        both: FloatArray = moved_radii[1:] + moved_radii[0]
        return both

    def by_time(self, mean: MeanSpots) -> float:
        """Return the change of the ratios that the time since then may have caused."""
        return _PER_S * 1e-9 * max(mean.t_ns - self.t_ns, 0)

    def is_of_another_run(self, mean: MeanSpots) -> bool:
        """Return whether the time has restarted since then."""
        return mean.t_ns < self.t_ns - _RESTART_S * 1e9


def _radius_px(shape: SpotShape) -> float:
    """Return the mean 1/e² radius of a shape, px."""
    return math.sqrt(2 * 2 ** (1 / shape.order) / math.sqrt(shape.a * shape.c - shape.b**2))
