"""From nodes to a target's maps: which model, what checks it, which nodes do not lie where they should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from altd.calibration.cross_check import CrossCheck
from altd.calibration.evidence import Candidate
from altd.mapping.hull import convex_hull_mm
from altd.mapping.lens import fit_lens_maps
from altd.mapping.marks import Marks
from altd.mapping.tensor_map import Fit, fit_tensor_map, fit_tensor_maps
from altd.records import FloatArray

_OUTLIER_SIGMAS = 6.0
_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two components scatter by 1."""
_GAIN_OF_FAR, _GAIN_OF_ANY = 0.8, 0.5
"""A node is dropped when the map then misses the others by less than this share of what it did. One that
lies at a corner bends the map after itself and need not look far off: without it the map is far better."""
_BEND_GAIN = 0.8
"""A polynomial on top of a lens must miss a left-out node by less than this share of what others do: it has
twice a lens's parameters, and the smallest of many like figures is often small by chance."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetFit:
    """The fit that is the map, the map that checks it, all that were tried, the rows that were dropped."""

    fit: Fit
    cross_check: CrossCheck
    candidates: tuple[Candidate, ...]
    dropped: list[int]


@dataclass(frozen=True, slots=True, eq=False)
class _Families:
    """All fits of one set of nodes; the tensor polynomial's degree is chosen by cross-validation."""

    tensors: list[Fit]
    lenses: list[Fit]

    @property
    def tensor(self) -> Fit:
        return min(self.tensors, key=lambda fit: fit.gcv_px)

    @property
    def lens(self) -> Fit:
        return min(self.lenses, key=_handicapped_px)

    @property
    def best(self) -> Fit:
        """Whichever misses a node less that it was not shown."""
        return min(self.tensor, self.lens, key=_handicapped_px)

    @property
    def other(self) -> Fit:
        """The best of the family that did not win."""
        return self.lens if self.best is self.tensor else self.tensor


def fit_nodes(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    image_size: tuple[int, int],
    degree: tuple[int, int] | None,
    most_dropped: int,
    marks: Marks | None = None,
) -> TargetFit:
    """Fit nodes (n, 2) mm at (n, 2) px by every model; the best is the map, the other family's checks it.

    A node without which the map of the others is clearly better, such as one at which the stage was bumped,
    is left out; one after the other, at most ``most_dropped``. ``marks`` of a print guide the lens models.
    Raises ValueError when the nodes are no grid or too few.
    """
    kept = np.arange(len(nodes_mm))
    families = _fit_families(nodes_mm, nodes_px, image_size, degree, marks)
    while len(nodes_mm) - len(kept) < most_dropped:
        trials = []
        for row, gain in _suspects(families).items():
            others = np.delete(kept, row)
            try:
                without = _fit_families(nodes_mm[others], nodes_px[others], image_size, degree, marks)
            except ValueError:
                continue
            if without.best.left_out_px < gain * families.best.left_out_px:
                trials.append((others, without))
        if not trials:
            break
        kept, families = min(trials, key=lambda trial: trial[1].best.left_out_px)
    return TargetFit(
        families.best,
        CrossCheck.between(families.best, families.other),
        tuple(_candidate(fit) for fit in families.tensors + families.lenses),
        sorted(set(range(len(nodes_mm))) - set(kept.tolist())),
    )


def _suspects(families: _Families) -> dict[int, float]:
    """The rows that lie farthest off either family's map, and what share of the misses may stay without them.

    Both are asked: at a corner, or beside missing nodes, the tensor polynomial follows a displaced node.
    """
    suspects: dict[int, float] = {}
    for fit in (families.tensor, families.lens):
        off_px = np.linalg.norm(fit.standard_px, axis=1)
        worst = int(off_px.argmax())
        far = off_px[worst] > _OUTLIER_SIGMAS * float(np.median(off_px)) / _RAYLEIGH_MEDIAN
        suspects[worst] = max(suspects.get(worst, 0.0), _GAIN_OF_FAR if far else _GAIN_OF_ANY)
    return suspects


def _fit_families(
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    image_size: tuple[int, int],
    degree: tuple[int, int] | None,
    marks: Marks | None,
) -> _Families:
    hull_mm = convex_hull_mm(nodes_mm)
    if degree is None:
        tensors = fit_tensor_maps(nodes_mm, nodes_px, hull_mm)
    else:
        tensors = [fit_tensor_map(nodes_mm, nodes_px, hull_mm, degree)]
    lenses = fit_lens_maps(nodes_mm, nodes_px, hull_mm, image_size, marks)
    return _Families(_unfolded(tensors), _unfolded(lenses))


def _handicapped_px(fit: Fit) -> float:
    return fit.left_out_px / (_BEND_GAIN if fit.map.model.endswith("+tensor") else 1.0)


def _unfolded(fits: list[Fit]) -> list[Fit]:
    kept = [fit for fit in fits if not fit.map.folds]
    if not kept:
        raise ValueError("every map through the nodes folds over on itself")
    return kept


def _candidate(fit: Fit) -> Candidate:
    return Candidate(
        model=fit.map.model,
        degree=fit.degree,
        parameters=fit.parameters,
        gcv_px=fit.gcv_px,
        left_out_px=fit.left_out_px,
        map_sigma_px=fit.map.spread_sigma_px,
    )
