"""Where a print ends: spots that reach past it are dark there, so their moment lies too far inwards.

Smoothed over the dots, a spot is nearly a Gaussian whose form in mm is the same at all nodes, and the inner
nodes show it. With the form known the logarithm of the light is linear in the centre: a spot is found from
the part of it that is lit, and what is dark although it should be lit is where the print has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.fitting import fit_nodes
from altd.calibration.printed.sample import Plane
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap
from altd.records import FloatArray, Frame
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import gaussian_blur
from altd.vision.settings import SpotSettings

_CORE = 0.3
"""Share of the peak from which a smoothed pixel counts: below it a spot is no Gaussian."""
_MIN_INNER_NODES = 4
_CUT_SIGMA_RATIO = 3.0
"""How much worse a cut spot is known than a whole one."""
_PASSES = 3
"""Each with a map that is bent less."""
_ITERATIONS = 12
_DARK = 0.85
"""A pixel with less than this share of its expected light is left out of a spot's fit."""
_NEAR_DARK = 0.02
"""Of the smoothed mask of what is dark: about two sigmas of the smoothing beside it."""
_ENDED = 0.5
"""The share that a smoothed straight end has where it ends."""
_MAX_DARK_SHARE = 0.015
"""Share of a whole spot's expected light that may be missing by dots and texture."""
_MAX_TURN = 0.35
"""Radians by which a side of the print may be turned against the stage's axes."""
_MAX_STRAIGHTNESS_MM = 0.6
"""Rms of the places of a side about its line; dots that are cut or left out make up to half a pitch."""
_MIN_PLACES = 5
_MIN_EXPLAINED_SHARE = 0.6
"""Of the places; at a corner the smoothed light falls off in other directions, too."""
_MARGIN_MM = 1.0
"""Light this near the end is not used: the outermost dots may be incomplete."""


@dataclass(frozen=True, slots=True, eq=False)
class PrintEnd:
    """The sides at which a print ends, ``normals`` (n, 2) outwards and ``distances_mm`` (n,).

    A point is on the print where normal · point < distance.
    """

    normals: FloatArray
    distances_mm: FloatArray

    def flat(self, picture_mm: FloatArray) -> Flat:
        """Even where the pixels of a picture look at (rows, columns, 2) mm of print, unused elsewhere."""
        return Flat.of(self.holds(picture_mm).astype(np.float32), "print")

    def holds(self, places_mm: FloatArray) -> npt.NDArray[np.bool_]:
        """Which places (…, 2) mm are on the print and not too near its end."""
        inside = np.ones(places_mm.shape[:-1], dtype=np.bool_)
        for normal, distance_mm in zip(self.normals, self.distances_mm, strict=True):
            inside &= places_mm @ normal < distance_mm - _MARGIN_MM
        return inside


@dataclass(frozen=True, slots=True, eq=False)
class CutNodes:
    """The nodes whose spots reach past the print's end.

    ``rows`` are their numbers, ``nodes_px`` (n, 2) where the spots of all nodes are, those of the cut ones by
    their lit part, ``map`` goes through them. ``end`` is None where the places at which spots go dark do not
    lie on straight sides.
    """

    rows: tuple[int, ...]
    nodes_px: FloatArray
    map: TensorMap
    end: PrintEnd | None


def find_cut_nodes(
    frame_of: Callable[[int], Frame],
    nodes_mm: FloatArray,
    nodes_px: FloatArray,
    first_map: TensorMap,
    image_size: tuple[int, int],
    settings: SpotSettings,
) -> CutNodes | None:
    """The nodes of a scan whose spots reach past the end of the print; None where none does.

    ``frame_of`` gives one exposure of a node by its number, ``nodes_mm`` and ``nodes_px`` (n, 2) are the
    stage's positions and the spots by their moments, ``first_map`` is a map through them, bent by the spots
    that are cut.
    """
    spots = [_smoothed(frame_of(row), settings) for row in range(len(nodes_mm))]
    inner = np.flatnonzero(_is_inner(nodes_mm))
    found = CutNodes((), nodes_px, first_map, None)
    for _ in range(_PASSES):
        jacobians = _jacobians(found.map, nodes_mm)
        covariances_mm = [
            _covariance_mm(spots[row], jacobians[row]) for row in inner if spots[row] is not None
        ]
        if len(covariances_mm) < _MIN_INNER_NODES:
            return None
        covariance_mm = np.median(covariances_mm, axis=0)
        fitted = {
            row: spot.fitted(covariance_mm, jacobians[row])
            for row, spot in enumerate(spots)
            if spot is not None
        }
        cut = {
            row: spot
            for row, spot in fitted.items()
            if spot is not None and (row in found.rows or spot.dark_share > _MAX_DARK_SHARE)
        }
        if not cut:
            return None
        found = _mended(found, cut, nodes_mm, jacobians, image_size)
    return found


def _mended(
    found: CutNodes,
    cut: dict[int, _Fitted],
    nodes_mm: FloatArray,
    jacobians: FloatArray,
    image_size: tuple[int, int],
) -> CutNodes:
    """The cut nodes with better places and a better map."""
    nodes_px = found.nodes_px.copy()
    nodes_px[list(cut)] = [spot.centre_px for spot in cut.values()]
    relative = np.ones(len(nodes_mm))
    relative[list(cut)] = _CUT_SIGMA_RATIO
    better = fit_nodes(Nodes(nodes_mm, nodes_px, relative), image_size, None, 0).fit.map
    edges_mm = Plane(better).to_mm(np.concatenate([spot.edge_px for spot in cut.values()]))
    outwards = np.concatenate([spot.outwards_px @ jacobians[row] for row, spot in cut.items()])
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    return CutNodes(tuple(cut), nodes_px, better, _end(edges_mm, outwards))


def _is_inner(nodes_mm: FloatArray) -> npt.NDArray[np.bool_]:
    """Which nodes have others beside them in all four directions."""
    low, high = nodes_mm.min(axis=0) + 1.0, nodes_mm.max(axis=0) - 1.0
    inner: npt.NDArray[np.bool_] = ((nodes_mm > low) & (nodes_mm < high)).all(axis=1)
    return inner


def _jacobians(fitted: TensorMap, nodes_mm: FloatArray) -> FloatArray:
    """d(px)/d(mm) (n, 2, 2) at the nodes."""
    steps = [(fitted.to_px(nodes_mm + step) - fitted.to_px(nodes_mm - step)) / 2 for step in np.eye(2)]
    return np.stack(steps, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A spot by its lit part: its centre, the share of its light that is missing, where it goes dark, and
    in which direction (n, 2)."""

    centre_px: FloatArray
    dark_share: float
    edge_px: FloatArray
    outwards_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Smoothed:
    """The smoothed light of a spot (rows, columns), the picture's pixels at which it begins, the smoothing."""

    light: FloatArray
    left: int
    top: int
    smoothing_px: float

    def places(self) -> FloatArray:
        """The pixels' places (rows, columns, 2) px."""
        rows, columns = self.light.shape
        u, v = np.meshgrid(np.arange(columns) + self.left, np.arange(rows) + self.top)
        return np.stack([u, v], axis=-1).astype(np.float64)

    def fitted(self, covariance_mm: FloatArray, jacobian: FloatArray) -> _Fitted | None:
        """The spot of a known form, fitted without what is dark; None where too little is lit."""
        covariance = jacobian @ covariance_mm @ jacobian.T + self.smoothing_px**2 * np.eye(2)
        form = np.linalg.inv(covariance)
        places = self.places()
        core = self.light > _CORE * self.light.max()
        origin = places[core].mean(axis=0)
        from_origin = places - origin
        quadratic = 0.5 * np.einsum("...i,ij,...j->...", from_origin, form, from_origin)
        used = core
        for _ in range(_ITERATIONS):
            if np.count_nonzero(used) < 0.2 * np.count_nonzero(core):
                return None
            design = np.column_stack([np.ones(np.count_nonzero(used)), from_origin[used]])
            weight = self.light[used]
            target = np.log(weight) + quadratic[used]
            level, *slope = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)[0]
            expected = np.exp(level + from_origin @ np.array(slope) - quadratic)
            peak = float(np.exp(level + 0.5 * np.array(slope) @ covariance @ np.array(slope)))
            dark = (self.light < _DARK * expected) & (expected > _CORE / 2 * peak)
            used = core & (gaussian_blur(dark.astype(np.float32), self.smoothing_px) < _NEAR_DARK)
        within = expected > _CORE * peak
        share = self.light / np.maximum(expected, _CORE / 2 * peak)
        missing = float(expected[within & (share < _ENDED)].sum() / expected.sum())
        lit = share >= _ENDED
        beside = within & lit & (cv2.erode(lit.astype(np.uint8), None) == 0)
        by_v, by_u = np.gradient(share)
        outwards = -np.stack([by_u[beside], by_v[beside]], axis=-1)
        return _Fitted(origin + covariance @ np.array(slope), missing, places[beside], outwards)


def _smoothed(frame: Frame, settings: SpotSettings) -> _Smoothed | None:
    """A frame's spot, smoothed; None without one, or where the border of the picture cuts it."""
    patch = FrameAnalysis(frame, settings).brightest_patch
    if patch is None or patch.is_cut:
        return None
    return _Smoothed(
        np.maximum(patch.smooth.astype(np.float64), 1e-6), patch.left, patch.top, settings.smoothing_px
    )


def _covariance_mm(spot: _Smoothed, jacobian: FloatArray) -> FloatArray:
    """The covariance (2, 2) mm² of the Gaussian that a whole spot is, without the smoothing."""
    core = spot.light > _CORE * spot.light.max()
    px = spot.places()[core]
    x, y = (px - px.mean(axis=0)).T
    weight = spot.light[core]
    design = np.column_stack([np.ones(len(x)), x, y, 0.5 * x * x, x * y, 0.5 * y * y])
    *_, xx, xy, yy = np.linalg.lstsq(design * weight[:, None], np.log(weight) * weight, rcond=None)[0]
    covariance = np.linalg.inv(-np.array([[xx, xy], [xy, yy]])) - spot.smoothing_px**2 * np.eye(2)
    to_mm = np.linalg.inv(jacobian)
    return np.asarray(to_mm @ covariance @ to_mm.T)


def _end(edges_mm: FloatArray, outwards: FloatArray) -> PrintEnd | None:
    """The straight sides through the places (n, 2) at which spots go dark; None where they are not straight.

    ``outwards`` (n, 2) points to the darker side there. A side is one of at most four, along the stage's axes
    but for a small turn.
    """
    normals, distances = [], []
    explained = 0
    for outward in np.concatenate([np.eye(2), -np.eye(2)]):
        along = outward[::-1]
        of_side = edges_mm[outwards @ outward > np.cos(_MAX_TURN)]
        if len(of_side) < _MIN_PLACES:
            continue
        design = np.column_stack([np.ones(len(of_side)), of_side @ along])
        (distance_mm, slope), *_ = np.linalg.lstsq(design, of_side @ outward, rcond=None)
        rest_mm = of_side @ outward - design @ (distance_mm, slope)
        if np.sqrt(np.mean(np.square(rest_mm))) > _MAX_STRAIGHTNESS_MM:
            return None
        explained += len(of_side)
        length = np.hypot(1.0, slope)
        normals.append((outward - slope * along) / length)
        distances.append(distance_mm / length)
    if explained < _MIN_EXPLAINED_SHARE * len(edges_mm):
        return None
    return PrintEnd(np.array(normals), np.array(distances))
