"""What a calibration was made from, kept for the person who must believe it; the report shows it."""

from __future__ import annotations

from dataclasses import dataclass

from altd.records import FloatArray


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model that was tried on a target's nodes.

    ``model`` is its name as in the calibration file (``tensor``, ``lens`` …), ``degree`` along x and y of a
    tensor polynomial, ``parameters`` how many numbers per target were fitted. ``gcv_px`` is the root of the
    generalised cross-validation score, ``leave_one_out_px`` the rms of the leave-one-out residuals,
    ``map_sigma_px`` the rms over the hull of what the nodes' noise leaves in the map: it grows with the
    degree while the misfit falls (thesis 3.5.6).
    """

    model: str
    degree: tuple[int, int] | None
    parameters: int
    gcv_px: float
    leave_one_out_px: float
    map_sigma_px: float


@dataclass(frozen=True, slots=True, eq=False)
class TargetEvidence:
    """A target's nodes and the models that were tried on them.

    ``nodes_mm`` (n, 2) and ``nodes_px`` (n, 2) are the nodes that were used, ``residuals_px`` (n, 2) measured
    minus mapped, ``leave_one_out_residuals_px`` (n, 2) measured minus mapped without the node,
    ``scatter_px`` (n, 2) the standard deviation of single exposures at the node (NaN where it has one),
    ``exposures`` (n,) their number. ``relative_sigma`` (n,) is 1 for a node whose spot is known as well as
    most, more for one that is known worse and counts less. ``excluded`` holds the nodes (x, y) mm that were
    not used, each with the reason, ``leds_dropped`` in words the frame LEDs that shine and could not be
    located.
    """

    name: str
    nodes_mm: FloatArray
    nodes_px: FloatArray
    residuals_px: FloatArray
    leave_one_out_residuals_px: FloatArray
    relative_sigma: FloatArray
    scatter_px: FloatArray
    exposures: tuple[int, ...]
    excluded: tuple[tuple[tuple[float, float], str], ...]
    leds_dropped: tuple[str, ...]
    candidates: tuple[Candidate, ...]
