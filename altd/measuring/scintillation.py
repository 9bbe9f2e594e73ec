"""Scintillation: turbulent air moves the light within the beam, at random from exposure to exposure.

Each exposure has another distortion, and their mean nearly none. Dirt, reflections and lamps are the same in
all exposures, or change slowly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from altd.reasons import Reason
from altd.records import Fault, FrameSet, MeanSpots, NoSpot, Spot
from altd.vision.localise import MIN_DISTORTION_DIAMETERS

_MIN_EXPOSURES = 10
_MIN_SHARE = 0.5
"""Minimum share of the exposures with unexplained light; with fewer the others alone are measured."""
_MIN_EXCESS_DIAMETERS = 0.2 * MIN_DISTORTION_DIAMETERS
"""Minimum excess of the mean that is worth an examination."""
_MIN_SCATTER = 0.5
"""Minimum scatter of the exposures, a chi-square, as a share of the usual one. At rest it is 0.2 to 0.3, in
air that makes the light scatter by 10 % over 6 mm 0.7 to 1.4."""
_MAX_COMMON = 0.15
"""Maximum chi-square of what the exposures have in common, beyond the usual one, as a share of scatter."""
_MAX_CORRELATION = 0.25
"""Maximum correlation of successive exposures; what moves has more. By chance 0.1 is usual."""


def averaged_residuals(
    frame_sets: Sequence[FrameSet], mean: MeanSpots | tuple[Fault, ...]
) -> tuple[FrameSet, ...] | None:
    """Return the frame sets of a window with distorted spots too; None if there is no scintillation.

    The excess of each spot is then that of what the exposures have in common; the scatter of the centres
    shows the rest. ``mean`` is that without the distorted spots. One beam lights all targets, so all of them
    must show scintillation.
    """
    if isinstance(mean, MeanSpots):
        diameters_px = [spot.diameter_px for spot in map(_seen, frame_sets[-1].spots.values()) if spot]
        is_doubtful = max(mean.excess_px) > _MIN_EXCESS_DIAMETERS * max(diameters_px, default=0.0)
    else:
        is_doubtful = any(fault.reason is Reason.DISTORTED for fault in mean)
    if not is_doubtful:
        return None
    excesses_px2 = {}
    for target in frame_sets[-1].spots:
        seen = [_seen(frame_set.spots[target]) for frame_set in frame_sets]
        common_px2 = _common_px2([spot for spot in seen if spot is not None])
        if common_px2 is None:
            return None
        excesses_px2[target] = common_px2
    spots_of = [
        {t: _with_excess(spot, excesses_px2[t]) for t, spot in one.spots.items()} for one in frame_sets
    ]
    return tuple(replace(one, spots=spots) for one, spots in zip(frame_sets, spots_of, strict=True))


def _common_px2(spots: Sequence[Spot]) -> float | None:
    """Return the square of the displacement by what the exposures have in common; None: no scintillation."""
    known = [spot.unexplained for spot in spots if spot.unexplained is not None]
    is_few = len(known) < max(_MIN_EXPOSURES, _MIN_SHARE * len(spots))
    if is_few or len({one.scores.shape for one in known}) > 1:
        return None
    scores = np.array([one.scores for one in known])
    common = scores.mean(axis=0)
    score, amplitude = np.moveaxis(scores - common, 1, 0)
    total = float((score * amplitude).sum())
    scatter = total / (len(known) - 1)
    chi2 = float(common[0] @ common[1]) - scatter / len(known)
    usual, bias_px = np.mean([(one.usual, one.bias_px) for one in known], axis=0).tolist()
    is_random = float((score[1:] * amplitude[:-1]).sum()) <= _MAX_CORRELATION * total
    is_alike = scatter < _MIN_SCATTER * usual or chi2 - usual > _MAX_COMMON * scatter
    return float(bias_px**2 * max(chi2 - usual, 0.0)) if is_random and not is_alike else None


def _seen(spot: Spot | NoSpot) -> Spot | None:
    return spot if isinstance(spot, Spot) else spot.spot


def _with_excess(spot: Spot | NoSpot, common_px2: float) -> Spot | NoSpot:
    """Return a spot with the common displacement in place of its own one by unexplained light."""
    if (seen := _seen(spot)) is None:
        return spot
    own_px = 0.0 if seen.unexplained is None else seen.unexplained.displacement_px
    return replace(seen, excess_px=math.sqrt(max(seen.excess_px**2 - own_px**2, 0.0) + common_px2))
