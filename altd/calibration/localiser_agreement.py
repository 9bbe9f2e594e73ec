"""How far the two localisers of a target differ over the nodes of its scan (App. A.4)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from altd.records import Frame, Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate, locate_ellipse
from altd.vision.settings import SpotSettings

_MIN_NODES = 6
_LIMIT_SIGMAS = 3.0
_LIMIT_PATTERNS = 4.0
"""Speckle moves the ellipse farther than the profile: on the grainy plates of five simulated units and of
unit-a the two scatter 1.6 to 2.5 times the profile's pattern about each other."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """The distances between a target's main localiser and the ellipse, px, root mean square over ``nodes``.

    ``difference_px`` is all of it. ``scatter_px`` is left when what is the same everywhere or changes evenly
    over the target is taken off: perspective draws the foot of a spot further than its half height, and the
    map of either localiser takes that in. ``sigma_px`` is what read and shot noise make of the distance if
    they disturb both independently.
    """

    nodes: int
    difference_px: float
    scatter_px: float
    sigma_px: float

    def limit_px(self, pattern_px: float) -> float:
        """The scatter up to which noise and a pattern excuse them.

        ``pattern_px`` is that of the main localiser an axis, as the nodes show it about the map.
        """
        return math.hypot(_LIMIT_SIGMAS * self.sigma_px, _LIMIT_PATTERNS * math.sqrt(2) * pattern_px)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a person should know of the two localisers of a target, and what is doubtful about them."""

    remark: str
    doubt: str | None = None


def localiser_agreement(
    frames: Iterable[Frame], localiser: SpotSettings, flat: Flat | None
) -> Agreement | None:
    """Locate the spot of each node's frame twice; None when both find it on fewer than six nodes."""
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


def verdict(name: str, method: str, both: Agreement | None, pattern_px: float | None) -> Verdict:
    """Words on a target's localisers; they may differ by a pattern of ``pattern_px``, None: by anything."""
    if both is None:
        return Verdict(f"{name}: the ellipse found too few spots to be held against the {method}")
    remark = (
        f"{name}: {method} and ellipse lie {both.difference_px:.3f} px apart (rms of {both.nodes} nodes), "
        f"scatter {both.scatter_px:.3f} px"
    )
    if pattern_px is None:
        return Verdict(f"{remark}; print moves them differently")
    limit_px = both.limit_px(pattern_px)
    remark += f", bound {limit_px:.3f} px"
    if both.scatter_px <= limit_px:
        return Verdict(remark)
    return Verdict(
        remark,
        f"{name}: {method} and ellipse scatter {both.scatter_px:.3f} px about each other, noise explains "
        f"{limit_px:.3f} px: dirt, a reflection, or a flat that is not this target's",
    )
