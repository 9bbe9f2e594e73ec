"""What a calibration was made from, kept for the person who must believe it; the report shows it."""

from __future__ import annotations

from dataclasses import dataclass

from altd.records import FloatArray


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model that was tried on a target's nodes.

    ``model`` is its name as in the calibration file (``tensor``, ``lens`` …), ``degree`` along x and y of a
    tensor polynomial, ``parameters`` how many numbers per target were fitted. ``gcv_px`` is the root of the
    generalised cross-validation score, ``left_out_px`` the rms by which a node misses the map fitted without
    it, ``map_sigma_px`` the rms over the hull of what the nodes' noise leaves in the map: it grows with the
    degree while the misfit falls (thesis 3.5.6).
    """

    model: str
    degree: tuple[int, int] | None
    parameters: int
    gcv_px: float
    left_out_px: float
    map_sigma_px: float


@dataclass(frozen=True, slots=True, eq=False)
class TargetEvidence:
    """A target's nodes and the models that were tried on them.

    ``nodes_mm`` (n, 2) and ``nodes_px`` (n, 2) are the nodes that were used, ``residuals_px`` (n, 2) measured
    minus mapped, ``missed_px`` (n, 2) by how much each misses the map made without it, ``scatter_px`` (n, 2)
    the standard deviation of single exposures at the node (NaN where it has one), ``exposures`` (n,) their
    number. ``relative_sigma`` (n,) is 1 for a node whose spot is known as well as most, more for one that
    is known worse and counts less. ``left_out`` holds the nodes (x, y) mm that were not used, each with the
    reason, ``leds_dropped`` in words the frame LEDs that shine and could not be located.
    """

    name: str
    nodes_mm: FloatArray
    nodes_px: FloatArray
    residuals_px: FloatArray
    missed_px: FloatArray
    relative_sigma: FloatArray
    scatter_px: FloatArray
    exposures: tuple[int, ...]
    left_out: tuple[tuple[tuple[float, float], str], ...]
    leds_dropped: tuple[str, ...]
    candidates: tuple[Candidate, ...]
