"""Fit a target's maps to its nodes: choice of the model, cross-check and outliers.

Outside the hull, a map's covariance contains the nodes' noise, but not the error of the model itself. So
each outer row of nodes is left out in turn, the others are fitted again, and the row is predicted. Residuals
that exceed the covariance are the error of the model one pitch outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.calibration.result import Candidate
from altd.mapping.camera_model import Optics
from altd.mapping.grid import Axis, convex_hull_mm
from altd.mapping.lens import fit_lens_map, fit_lens_maps
from altd.mapping.nodes import Fiducials, Nodes
from altd.mapping.tensor_map import Fit, TensorMap, fit_tensor_map, fit_tensor_maps
from altd.measuring.cross_check import CrossCheck
from altd.records import FloatArray

_MARGIN_PITCHES = 0.5
"""The margin in pitches: half the distance that was tested."""


@dataclass(frozen=True, slots=True, eq=False)
class OuterRow:
    """The nodes at one end of a grid, as rows of the arrays, and the distance to the next ones."""

    rows: npt.NDArray[np.intp]
    pitch_mm: float


def outer_rows(nodes_mm: FloatArray) -> list[OuterRow]:
    """Return the outer columns and rows of a grid (n, 2); raises ValueError if the nodes form no grid."""
    outer: list[OuterRow] = []
    for along in nodes_mm.T:
        pitch_mm = Axis.through(along).step_mm
        outer += [
            OuterRow(np.flatnonzero(np.abs(along - end) < pitch_mm / 2), pitch_mm)
            for end in (along.min(), along.max())
        ]
    return outer


def with_margin(
    fit: Fit,
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    rows: Sequence[OuterRow],
    fits_without: Sequence[Fit],
) -> Fit:
    """Return the fit of nodes (n, 2) mm at (n, 2) px with the margin of its map.

    ``fits_without`` are the fits of the nodes without each of the outer ``rows``.
    """
    excess = []
    for outer, without in zip(rows, fits_without, strict=True):
        there = outer.rows
        of_row = _excess_px2(without.map, nodes_mm[there], nodes_px[there], fit.relative_sigma[there])
        excess.append(of_row / outer.pitch_mm**2)
    px_per_mm = math.sqrt(max(float(np.concatenate(excess).mean()), 0.0))
    margin_mm = _MARGIN_PITCHES * min(outer.pitch_mm for outer in rows)
    return replace(fit, map=replace(fit.map, margin_mm=margin_mm, beyond_px_per_mm=px_per_mm))


def _excess_px2(
    without: TensorMap, nodes_mm: FloatArray, nodes_px: FloatArray, relative_sigma: FloatArray
) -> FloatArray:
    """Squared residuals (n, 2) of nodes, minus their expectation by the map's covariance."""
    residuals = nodes_px - without.to_px(nodes_mm)
    expected = (without.noise_px * relative_sigma[:, None]) ** 2 + without.variance_px2(nodes_mm)
    excess: FloatArray = np.square(residuals) - expected
    return excess


_OUTLIER_SIGMAS = 6.0
_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two components have a standard deviation of 1."""
_MAX_RATIO_OF_FAR, _MAX_RATIO_OF_ANY = 0.8, 0.5
"""A node is dropped if the leave-one-out rms then falls below this share: of a node far from the map, of any.
One at a corner bends the map towards itself and may be close to it; without it, the map is far better."""
_BEND_PENALTY = 0.8
"""Share of the other models' leave-one-out rms that a polynomial on top of a lens must stay below. It has
twice a lens's parameters, and the smallest of many similar figures is often small by chance."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetFit:
    """The chosen fit, the map that checks it, all models tried, and the dropped rows."""

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
        return min(self.lenses, key=_penalised_score_px)

    @property
    def best(self) -> Fit:
        """The fit with the smaller penalised leave-one-out rms."""
        return min(self.tensor, self.lens, key=_penalised_score_px)

    @property
    def other(self) -> Fit:
        """The best fit of the family that was not chosen."""
        return self.lens if self.best is self.tensor else self.tensor


def fit_nodes(
    nodes: Nodes, image_size: tuple[int, int], max_dropped: int, fiducials: Fiducials | None = None
) -> TargetFit:
    """Fit nodes by every model; the best fit is the map, the best of the other family checks it.

    A node is dropped if the map without it is clearly better, as after a bump of the stage: one node at a
    time, at most ``max_dropped``. ``fiducials`` of a print guide the lens models. Raises ValueError when the
    nodes are no grid or too few.
    """

    def fit(rows: npt.NDArray[np.intp]) -> _Families:
        return _fit_families(nodes.select(rows), image_size, fiducials)

    kept = np.arange(len(nodes))
    families = fit(kept)
    while len(nodes) - len(kept) < max_dropped:
        trials = []
        for row, gain in _suspects(families).items():
            others = np.delete(kept, row)
            try:
                without = fit(others)
            except ValueError:
                continue
            if without.best.leave_one_out_px < gain * families.best.leave_one_out_px:
                trials.append((others, without))
        if not trials:
            break
        kept, families = min(trials, key=lambda trial: trial[1].best.leave_one_out_px)
    used = nodes.select(kept)
    tensor, lens = families.tensor, families.lens
    try:
        outer = outer_rows(used.mm)
        inner = [used.without(row.rows) for row in outer]
        tensors = [_tensor_again(others) for others in inner]
        lenses = [_lens_again(lens, others, image_size, fiducials) for others in inner]
        tensor = with_margin(tensor, used.mm, used.px, outer, tensors)
        lens = with_margin(lens, used.mm, used.px, outer, lenses)
    except ValueError:  # too few nodes to leave any out: the maps get no margin
        pass
    best, other = (tensor, lens) if families.best is families.tensor else (lens, tensor)
    return TargetFit(
        best,
        CrossCheck.between(best, other),
        tuple(_candidate(fit) for fit in families.tensors + families.lenses),
        sorted(set(range(len(nodes))) - set(kept.tolist())),
    )


def best_fit(nodes: Nodes, image_size: tuple[int, int], fiducials: Fiducials | None) -> Fit:
    """Return the best fit of all nodes by any model, without margin, cross-check and search for outliers."""
    return _fit_families(nodes, image_size, fiducials).best


def _suspects(families: _Families) -> dict[int, float]:
    """Find the row farthest from each family's map, and the share of the error that may remain without it.

    Both maps are checked: at a corner or next to missing nodes, the tensor polynomial follows a displaced
    node.
    """
    suspects: dict[int, float] = {}
    for fit in (families.tensor, families.lens):
        off_px = np.linalg.norm(fit.standardised_px, axis=1)
        worst = int(off_px.argmax())
        far = off_px[worst] > _OUTLIER_SIGMAS * float(np.median(off_px)) / _RAYLEIGH_MEDIAN
        suspects[worst] = max(suspects.get(worst, 0.0), _MAX_RATIO_OF_FAR if far else _MAX_RATIO_OF_ANY)
    return suspects


def _fit_families(nodes: Nodes, image_size: tuple[int, int], fiducials: Fiducials | None) -> _Families:
    hull_mm = convex_hull_mm(nodes.mm)
    tensors = fit_tensor_maps(nodes.mm, nodes.px, hull_mm, nodes.relative_sigma)
    lenses = fit_lens_maps(nodes, hull_mm, image_size, fiducials)
    return _Families(_unfolded(tensors), _unfolded(lenses))


def _tensor_again(nodes: Nodes) -> Fit:
    """Fit the tensor polynomial to other nodes; its degree is chosen again."""
    return fit_tensor_map(nodes.mm, nodes.px, convex_hull_mm(nodes.mm), None, nodes.relative_sigma)


def _lens_again(fit: Fit, nodes: Nodes, image_size: tuple[int, int], fiducials: Fiducials | None) -> Fit:
    """Fit the same lens model to other nodes."""
    optics: Optics = "fisheye" if fit.map.model.startswith("fisheye") else "brown"
    return fit_lens_map(
        nodes,
        convex_hull_mm(nodes.mm),
        image_size,
        optics,
        0 if fit.degree is None else fit.degree[0],
        fiducials,
    )


def _penalised_score_px(fit: Fit) -> float:
    return fit.leave_one_out_px / (_BEND_PENALTY if fit.map.model.endswith("+tensor") else 1.0)


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
        leave_one_out_px=fit.leave_one_out_px,
        map_sigma_px=fit.map.sigma_px,
    )
