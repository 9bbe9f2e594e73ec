"""What a scan's good spots are like: the reference that later spots of a target are held against."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np

from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap
from altd.records import Frame, SpotShape
from altd.spot_shape import shape_in_mm
from altd.vision.flat import Flat
from altd.vision.localise import fitted_profile
from altd.vision.misfit import misfit_of
from altd.vision.profile import Profile
from altd.vision.reference import Four, ShapeReference, SpotReference
from altd.vision.settings import SpotSettings

_MIN_SPOTS = 8
"""Fewer say too little of what is usual."""
_MAD_TO_SIGMA = 1.4826


def spot_reference(
    frames: Iterable[Frame], localiser: SpotSettings, flat: Flat | None, fitted: TensorMap, noise_px: float
) -> SpotReference | None:
    """The reference of a target from a frame of each of its nodes; None where too few show a whole spot.

    ``noise_px`` is what print and speckle do to a centre about the map ``fitted``. Medians over the nodes:
    single bad spots do not count.
    """
    profiles = [profile for f in frames if (profile := fitted_profile(f, localiser, flat)) is not None]
    if len(profiles) < _MIN_SPOTS:
        return None
    grain = float(np.median([profile.residuals.grain for profile in profiles]))
    misfits = [misfit for p in profiles if (misfit := misfit_of(p.residuals, grain)) is not None]
    if len(misfits) < _MIN_SPOTS:
        return None
    chi2 = np.array([misfit.chi2 for misfit in misfits])
    freedom = np.array([misfit.freedom for misfit in misfits])
    medians = freedom * (1 - 2 / (9 * freedom)) ** 3  # of chi-square, by Wilson and Hilferty
    return SpotReference(
        grain=grain,
        misfit_ratio=max(float(np.median(chi2 / medians)), 1.0),
        pattern_px=float(np.median([misfit.pattern_px for misfit in misfits])),
        noise_px=noise_px,
        shape=_shape_reference(profiles, fitted),
    )


def _shape_reference(profiles: list[Profile], fitted: TensorMap) -> ShapeReference | None:
    """Median shape in the unit frame, and the standard deviation by the median absolute deviation."""
    centres = np.array([(profile.centre.u_px, profile.centre.v_px) for profile in profiles])
    points_mm, jacobians, _ = InverseMap.of(fitted).to_mm(centres)
    shapes = np.array(
        [
            shape_in_mm(SpotShape(*profile.form, profile.order), jacobian)
            for profile, point, jacobian in zip(profiles, points_mm, jacobians, strict=True)
            if np.isfinite(point).all()
        ]
    )
    if len(shapes) < _MIN_SPOTS:
        return None
    mean = np.median(shapes, axis=0)
    sigma = _MAD_TO_SIGMA * np.median(np.abs(shapes - mean), axis=0)
    return ShapeReference(cast("Four", tuple(mean.tolist())), cast("Four", tuple(sigma.tolist())))
