"""The beam: its power on each target, and its movement by the stable targets, in time and along the row."""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from altd.config import RowSettings
from altd.instruments.row.places import BeamPlace
from altd.records import FloatArray

_MIN_JUMP_SIGMAS = 3.0
"""Minimum deviation from smooth movement that counts as a jump; less is the scatter of the visits."""
_JUMP_VARIANCE = 1.3
"""Variance of a parabola through three visits, per f (1 − f) of the square of a jump between two of them."""


def powers_mw(settings: RowSettings, targets: int) -> tuple[float, ...]:
    """Power on each target in beam order, with all glasses before it clear: P τⁿ."""
    return tuple(settings.laser_mw * settings.transmission**before for before in range(targets))


def at_instant(places: Sequence[BeamPlace], t_ns: int) -> BeamPlace | None:
    """Spot of a target at ``t_ns``, on the parabola through three visits around it; None without a visit.

    With two visits, or before or after all of three, it is on the line through two. Where the next visit
    deviates from that curve by J, beyond scatter, the spot may have jumped by J at any moment between two
    visits. At the fraction f of the way the variance is then larger by 1.3 f |1 − f| J².
    """
    if not places:
        return None
    times = [place.t_ns for place in places]
    if len(places) == 1 or t_ns in times:
        return places[times.index(t_ns) if t_ns in times else 0]
    last = len(places) - 1
    first = min(max(bisect.bisect_right(times, t_ns) - 1, 0), last - 1)
    is_between = times[0] < t_ns < times[-1]
    size = 3 if is_between or last >= 3 else 2
    start = min(max(first - 1, 0), max(last + 1 - size, 0))
    mm, random = _on_curve(places[start : start + size], t_ns)
    f = (t_ns - times[first]) / (times[first + 1] - times[first])
    starts = range(max(first - size + 1, 0), min(first, last - size) + 1)
    jumps = [_jump_mm2(places[start : start + size + 1]) for start in starts]
    if jumps:
        random = random + _JUMP_VARIANCE * abs(f * (1.0 - f)) * np.diag(np.max(jumps, axis=0))
    nearest = places[first] if f < 0.5 else places[first + 1]
    return replace(nearest, t_ns=t_ns, mm=mm, random_mm2=random)


def _on_curve(places: Sequence[BeamPlace], t_ns: int) -> tuple[FloatArray, FloatArray]:
    """Point (2,) at ``t_ns`` on the polynomial through all these places, with its covariance."""
    mm, random = np.zeros(2), np.zeros((2, 2))
    for place in places:
        others = [other.t_ns for other in places if other is not place]
        weight = math.prod((t_ns - other) / (place.t_ns - other) for other in others)
        mm, random = mm + weight * place.mm, random + weight**2 * place.random_mm2
    return mm, random


def _jump_mm2(places: Sequence[BeamPlace]) -> FloatArray:
    """Squared deviation (2,) of the last place from the curve through the others; 0: scatter explains it."""
    mm, random = _on_curve(places[:-1], places[-1].t_ns)
    off_mm = places[-1].mm - mm
    variances = np.diag(random + places[-1].random_mm2)
    squares: FloatArray = off_mm**2 * (off_mm**2 > _MIN_JUMP_SIGMAS**2 * variances)
    return squares


def gain_at(z_mm: Sequence[float], covariances_mm2: Sequence[FloatArray], at_mm: float) -> FloatArray:
    """Derivatives (2, 2 S) of the beam's movement at ``at_mm`` by the movements of the S stable targets.

    A line through two or more targets, weighted by their covariances (2, 2); with one target, its offset
    only.
    """
    count = len(z_mm)
    if count == 1:
        return np.eye(2)
    design = np.zeros((2 * count, 4))
    weighted = np.zeros((2 * count, 4))
    for index, (z, covariance) in enumerate(zip(z_mm, covariances_mm2, strict=True)):
        block = slice(2 * index, 2 * index + 2)
        design[block, :2], design[block, 2:] = np.eye(2), (z - at_mm) * 1e-3 * np.eye(2)
        weighted[block] = np.linalg.solve(covariance, design[block])
    return np.asarray(np.linalg.solve(design.T @ weighted, weighted.T)[:2], dtype=np.float64)


def moved_stable(
    z_mm: Mapping[str, float], moved_mm: Mapping[str, FloatArray], covariances_mm2: Mapping[str, FloatArray]
) -> tuple[str, ...] | None:
    """Stable targets that do not fit one beam: none, one, or None where it cannot be identified.

    Two targets fit any beam. Of three, one that moved is detected but not identified. Of four or more, it is
    the one without which the others agree.
    """
    names = list(moved_mm)
    if _agree(names, z_mm, moved_mm, covariances_mm2):
        return ()
    without = [
        name
        for name in names
        if len(names) > 3
        and _agree([other for other in names if other != name], z_mm, moved_mm, covariances_mm2)
    ]
    return (without[0],) if len(without) == 1 else None


def _agree(
    names: Sequence[str],
    z_mm: Mapping[str, float],
    moved_mm: Mapping[str, FloatArray],
    covariances_mm2: Mapping[str, FloatArray],
) -> bool:
    """Whether chi-square of the line's residuals is at most 20 + 2 · degrees of freedom: p < 2e-5."""
    degrees_of_freedom = 2 * (len(names) - 2)
    if degrees_of_freedom <= 0:
        return True
    z, covariances = [z_mm[name] for name in names], [covariances_mm2[name] for name in names]
    moved = np.concatenate([moved_mm[name] for name in names])
    chi_square = 0.0
    for name, covariance in zip(names, covariances, strict=True):
        residual = moved_mm[name] - gain_at(z, covariances, z_mm[name]) @ moved
        chi_square += float(residual @ np.linalg.solve(covariance, residual))
    return chi_square <= 2 * degrees_of_freedom + 20.0
