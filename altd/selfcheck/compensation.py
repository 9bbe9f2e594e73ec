"""What a check found, taken out of the pixel coordinates before the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from altd.measuring.calibration import Calibration
from altd.records import MeanSpots
from altd.selfcheck.effect import worst_effect
from altd.selfcheck.records import Limits, SelfCheck, Similarity
from altd.vision.flat import Flat


@dataclass(frozen=True, slots=True, eq=False)
class Compensation:
    """The fitted transforms by target: from where a spot is seen now to where it would have been then.

    ``misfit_px`` is, by target, what the LEDs leave beside the transform: no place is known better.
    """

    transforms: Mapping[str, Similarity]
    misfit_px: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Refused:
    """Why nothing is corrected, in words for people."""

    detail: str


def compensation_of(check: SelfCheck, calibration: Calibration, limits: Limits) -> Compensation | Refused:
    """What takes a check's drift out; refused where it is unknown, no similarity, or beyond the limit.

    All targets are corrected or none: half a correction of a direction can be worse than none.
    """
    transforms, misfit_px = {}, {}
    for target in calibration.targets:
        drift = check.targets.get(target.name)
        if drift is None or drift.similarity is None or drift.rms_px is None:
            return Refused(f"{target.name}: the drift is not known")
        if not drift.is_similarity:
            return Refused(f"{target.name}: the drift is no shift, turn and scale")
        worst = worst_effect(target, drift.similarity)
        if worst.error_mm > limits.compensate_mm:
            return Refused(
                f"{target.name}: the picture moved by up to {worst.error_mm:.2f} mm, "
                f"{limits.compensate_mm:g} mm are corrected at most"
            )
        if worst.sigma_mm > limits.suspect_mm:
            return Refused(f"{target.name}: the drift is known to {worst.sigma_mm:.3f} mm only")
        transforms[target.name] = drift.similarity
        misfit_px[target.name] = drift.rms_px
    return Compensation(transforms, misfit_px)


def flat_now(flat: Flat, transform: Similarity) -> Flat:
    """A target's flat as the camera would record it now: print and texture moved with the target.

    A spot is to be located through it, for the print under it is where the picture is. A flat that is half a
    pixel off makes more pattern of the print than it removes (docs/selfcheck.md).
    """
    rows, columns = flat.levels.shape
    levels = cv2.warpAffine(
        flat.levels,
        transform.affine,
        (columns, rows),
        flags=cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return replace(flat, levels=np.asarray(levels, dtype=np.uint8))


def compensated(mean: MeanSpots, compensation: Compensation) -> MeanSpots:
    """The mean spots as the calibrated unit would have seen them, with the transform's covariance added.

    To be applied to uncorrected mean spots, between the window and the instrument; spots that a flat helps to
    locate want ``flat_now`` before. Shapes stay as they are:
    a turn of 1° changes them less than their own noise. Raises KeyError for a target without a transform.
    """
    px, covariance = mean.px.copy(), mean.covariance_px2.copy()
    for index, name in enumerate(mean.targets):
        transform = compensation.transforms[name]
        block = slice(2 * index, 2 * index + 2)
        covariance[block, block] += transform.covariance_at_px2(*mean.px[index].tolist())
        covariance[block, block] += np.eye(2) * compensation.misfit_px[name] ** 2
        px[index] = transform.then_px(mean.px[index : index + 1])[0]
    return replace(mean, px=px, covariance_px2=covariance)
