"""Properties of a scan's good spots, and the difference between the two localisers on them (App. A.4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from typing import cast

import numpy as np

from altd.calibration.scan_nodes import NodeCache
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import TargetCalibration
from altd.measuring.spot_shape import shape_in_mm, unlike_a_laser
from altd.reasons import Reason
from altd.records import FloatArray, Frame, NoSpot, Spot, SpotShape
from altd.statistics import MAD_TO_SIGMA, median
from altd.vision.flat import Flat
from altd.vision.localise import fitted_profile, locate, locate_ellipse
from altd.vision.misfit import misfit_of
from altd.vision.settings import (
    LightReference,
    ShapeReference,
    ShapeVector,
    SpotReference,
    SpotSettings,
)

_MIN_NODES = 6
_LIMIT_SIGMAS = 3.0
_LIMIT_PATTERNS = 4.0
"""Limit of the difference in units of the pattern. Speckle moves the ellipse more than the profile: on grainy
plates of five simulated units and of unit-a, they scatter 1.6 to 2.5 times the profile's pattern."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Differences between a target's main localiser and the ellipse, px, root mean square over ``nodes``.

    ``difference_px`` is the whole difference. ``scatter_px`` is without the part that is constant or linear
    over the target: perspective shifts the foot of a spot more than its half height, and the map of either
    localiser contains that. ``sigma_px`` is the difference caused by read and shot noise if they disturb both
    independently.
    """

    nodes: int
    difference_px: float
    scatter_px: float
    sigma_px: float

    def limit_px(self, pattern_px: float) -> float:
        """Maximum scatter that noise and a pattern explain.

        ``pattern_px`` is the pattern of the main localiser per axis, as the nodes show it about the map.
        """
        return math.hypot(_LIMIT_SIGMAS * self.sigma_px, _LIMIT_PATTERNS * math.sqrt(2) * pattern_px)


@dataclass(frozen=True, slots=True)
class LocaliserVerdict:
    """Remark on the two localisers of a target, and a doubt about them."""

    remark: str
    doubt: str | None = None


def localiser_agreement(
    frames: Iterable[Frame], localiser: SpotSettings, flat: Flat | None
) -> Agreement | None:
    """Locate each frame's spot by both localisers; None if both find it at fewer than six nodes."""
    both = []
    for frame in frames:
        spot, second = locate(frame, localiser, flat), locate_ellipse(frame, localiser, flat)
        if isinstance(spot, Spot) and second is not None:
            both.append((spot, second))
    if len(both) < _MIN_NODES:
        return None
    difference = np.array([(first.u_px - second.u_px, first.v_px - second.v_px) for first, second in both])
    plane = np.array([(1.0, second.u_px, second.v_px) for _, second in both])
    rest = difference - plane @ np.linalg.lstsq(plane, difference, rcond=None)[0]
    variances = [first.sigma_px**2 + second.sigma_px**2 for first, second in both]
    return Agreement(
        nodes=len(both),
        difference_px=math.sqrt(float(np.square(difference).sum()) / len(both)),
        scatter_px=math.sqrt(float(np.square(rest).sum()) / (len(both) - plane.shape[1])),
        sigma_px=math.sqrt(2 * float(np.mean(variances))),
    )


def verdict(name: str, method: str, both: Agreement | None, pattern_px: float | None) -> LocaliserVerdict:
    """Compare a target's localisers; they may differ by a pattern of ``pattern_px``, None: by any amount."""
    if both is None:
        return LocaliserVerdict(f"{name}: the ellipse found too few spots to compare it with the {method}")
    remark = (
        f"{name}: {method} and ellipse lie {both.difference_px:.3f} px apart (rms of {both.nodes} nodes), "
        f"scatter {both.scatter_px:.3f} px"
    )
    if pattern_px is None:
        return LocaliserVerdict(f"{remark}; print moves them differently")
    limit_px = both.limit_px(pattern_px)
    remark += f", bound {limit_px:.3f} px"
    if both.scatter_px <= limit_px:
        return LocaliserVerdict(remark)
    return LocaliserVerdict(
        remark,
        f"{name}: {method} and ellipse scatter {both.scatter_px:.3f} px about each other, noise explains "
        f"{limit_px:.3f} px: dirt, a reflection, or a flat that is not this target's",
    )


_MIN_SPOTS = 8
"""Minimum number of spots; fewer are not representative."""
_MIN_LIGHTS = 12
"""Minimum number of spots for the six terms of the light."""
_MIN_LIGHT_SIGMA = 0.004
"""Minimum scatter of the light: steps of the exposure time change the ratio of two by 0.01 at most."""


def spot_reference(
    frame_of: Callable[[int], Frame],
    nodes: int,
    localiser: SpotSettings,
    flat: Flat | None,
    fitted: TensorMap,
) -> SpotReference | None:
    """Compute the reference of a target from one frame per node; None if too few show a whole spot.

    ``frame_of`` returns the frame of a node by its number, ``fitted`` is the target's map. ``noise_px`` is
    left to the caller. Values are medians over the nodes: single bad spots do not count.
    """
    profiles = NodeCache(
        nodes,
        lambda node: fitted_profile(frame_of(node), localiser, flat),
        lambda profile: profile.residuals.nbytes,
    )
    if len(profiles) < _MIN_SPOTS:
        return None
    grains, spots = [], []
    for profile in profiles:
        grains.append(profile.residuals.texture_contrast)
        spots.append((profile.centre.u_px, profile.centre.v_px, *astuple(profile.shape)))
    grain = float(np.median(grains))
    misfits = [misfit for p in profiles if (misfit := misfit_of(p.residuals, grain)) is not None]
    if len(misfits) < _MIN_SPOTS:
        return None
    chi2 = np.array([misfit.chi2 for misfit in misfits])
    degrees_of_freedom = np.array([misfit.degrees_of_freedom for misfit in misfits])
    medians = (
        degrees_of_freedom * (1 - 2 / (9 * degrees_of_freedom)) ** 3
    )  # medians of chi-square, by Wilson and Hilferty
    return SpotReference(
        grain=grain,
        misfit_ratio=max(float(np.median(chi2 / medians)), 1.0),
        pattern_px=float(np.median([misfit.pattern_px for misfit in misfits])),
        noise_px=0.0,
        shape=_shape_reference(np.array(spots), fitted),
        light=_light_reference(frame_of(profiles.nodes[0]), [p.light for p in profiles], np.array(spots)),
    )


def _light_reference(frame: Frame, lights: list[float], spots: FloatArray) -> LightReference | None:
    """Fit the light, counts · px², of spots at (n, 2+) px, exposed as ``frame``; None if it is not known."""
    per_ms = frame.per_ms
    if per_ms is None or len(lights) < _MIN_LIGHTS:
        return None
    terms, logs = LightReference.powers(spots[:, :2]), np.log(np.array(lights) * per_ms)
    of_terms = np.linalg.lstsq(terms, logs, rcond=None)[0]
    rest = np.square(logs - terms @ of_terms).sum() / (len(logs) - len(of_terms))
    return LightReference(tuple(of_terms.tolist()), max(math.sqrt(float(rest)), _MIN_LIGHT_SIGMA))


def refusal(frame: Frame, target: TargetCalibration) -> str | None:
    """Return why the calibrated unit would not measure the spot of a frame; None if it would.

    A spot that the picture's edge cuts is none of these: not its kind is refused, but its place.
    """
    spot = locate(frame, target.localiser, target.flat, target.spot)
    refused = spot if isinstance(spot, NoSpot) else None
    if isinstance(spot, Spot) and spot.shape is not None:
        point = target.point(spot.u_px, spot.v_px)
        if point is not None:
            refused = unlike_a_laser(shape_in_mm(spot.shape, point.jacobian_mm_per_px), target.spot.shape)
    if refused is None or refused.reason is Reason.CUT_BY_EDGE:
        return None
    return f"{refused.reason}: {refused.detail}"


def _shape_reference(spots: FloatArray, fitted: TensorMap) -> ShapeReference | None:
    """Median shape in the unit frame, and its MAD-based standard deviation.

    ``spots`` (n, 6): centre (u, v) px, form a, b, c and order of each.
    """
    points_mm, jacobians, _ = InverseMap(fitted).to_mm(spots[:, :2])
    shapes = np.array(
        [
            shape_in_mm(SpotShape(*form), jacobian)
            for form, point, jacobian in zip(spots[:, 2:].tolist(), points_mm, jacobians, strict=True)
            if np.isfinite(point).all()
        ]
    )
    if len(shapes) < _MIN_SPOTS:
        return None
    mean = median(shapes, axis=0)
    sigma = MAD_TO_SIGMA * median(np.abs(shapes - mean), axis=0)
    return ShapeReference(
        cast("ShapeVector", tuple(mean.tolist())), cast("ShapeVector", tuple(sigma.tolist()))
    )
