"""What a scan's good spots are like: the reference that later spots of a target are held against."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from altd.calibration.node_cache import NodeCache
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap
from altd.measuring.spot_shape import shape_in_mm
from altd.records import FloatArray, Frame, SpotShape
from altd.statistics.robust import MAD_TO_SIGMA, median
from altd.vision.flat import Flat
from altd.vision.localise import fitted_profile
from altd.vision.misfit import misfit_of
from altd.vision.reference import ShapeReference, ShapeVector, SpotReference
from altd.vision.settings import SpotSettings

_MIN_SPOTS = 8
"""Fewer say too little of what is usual."""


def spot_reference(
    frame_of: Callable[[int], Frame],
    nodes: int,
    localiser: SpotSettings,
    flat: Flat | None,
    fitted: TensorMap,
    noise_px: float,
) -> SpotReference | None:
    """The reference of a target from a frame of each of its nodes; None where too few show a whole spot.

    ``frame_of`` gives the frame of a node by its number. ``noise_px`` is what print and speckle do to a
    centre about the map ``fitted``. Medians over the nodes: single bad spots do not count.
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
        spots.append((profile.centre.u_px, profile.centre.v_px, *profile.form, profile.order))
    grain = float(np.median(grains))
    misfits = [misfit for p in profiles if (misfit := misfit_of(p.residuals, grain)) is not None]
    if len(misfits) < _MIN_SPOTS:
        return None
    chi2 = np.array([misfit.chi2 for misfit in misfits])
    degrees_of_freedom = np.array([misfit.degrees_of_freedom for misfit in misfits])
    medians = (
        degrees_of_freedom * (1 - 2 / (9 * degrees_of_freedom)) ** 3
    )  # of chi-square, by Wilson and Hilferty
    return SpotReference(
        grain=grain,
        misfit_ratio=max(float(np.median(chi2 / medians)), 1.0),
        pattern_px=float(np.median([misfit.pattern_px for misfit in misfits])),
        noise_px=noise_px,
        shape=_shape_reference(np.array(spots), fitted),
    )


def _shape_reference(spots: FloatArray, fitted: TensorMap) -> ShapeReference | None:
    """Median shape in the unit frame, and the standard deviation by the median absolute deviation.

    ``spots`` (n, 6): centre (u, v) px, form a, b, c and order of each.
    """
    points_mm, jacobians, _ = InverseMap.of(fitted).to_mm(spots[:, :2])
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
