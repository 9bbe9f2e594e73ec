"""Check the grid of a scan's nodes, weight the nodes, and detect the end of the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from altd.calibration.scan_nodes import Job, ScannedTarget, ScanNode
from altd.mapping.grid import Axis, GridPart, convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap, fit_tensor_map
from altd.records import FloatArray, Frame, Spot
from altd.statistics import MAD_TO_SIGMA
from altd.vision.flat import Flat, Learnt
from altd.vision.frame_analysis import FrameAnalysis, Patch
from altd.vision.localise import fitted_profile, locate_in
from altd.vision.misfit import hidden_px, misfit_of
from altd.vision.settings import SpotSettings

MAX_SIGMA_RATIO = 1.5
"""Maximum sigma of an ordinary spot over the median: print and speckle do not move a dim spot more."""
_ITERATIONS = 3
MIN_LEARNT_SHARE = 0.9
"""Share of a spot's light on a learnt surface from which its node counts as others do."""
_UNLEARNT_RATIO = 3.0
"""Scatter of the other nodes over that of these, in whole drawn units (decision 51)."""


@dataclass(frozen=True, slots=True)
class ScanGrid:
    """The grid of a scan: its axes, its usable block, and the positions (n, 2) of the usable nodes."""

    axes: tuple[Axis, Axis]
    block: GridPart
    usable_mm: FloatArray

    def missing_ends(self, margin_mm: float) -> list[str]:
        """Describe each end of the grid without usable nodes, and where the measurable area ends there."""
        words = []
        for axis, along, name in zip(self.axes, self.usable_mm.T, "xy", strict=True):
            for end, last, outward in (
                (axis.first_mm, float(along.min()), -1),
                (axis.last_mm, float(along.max()), 1),
            ):
                if abs(end - last) > axis.step_mm / 2:
                    line = "column" if name == "x" else "row"
                    words.append(
                        f"no node of the outer {line} at {name} {end:g} mm can be used: the measurable "
                        f"area ends at {name} {last + outward * margin_mm:.1f} mm"
                    )
        return words


def scan_grid(scanned: ScannedTarget) -> ScanGrid:
    """Return the grid of one target's nodes; raises ValueError if they form none."""
    nodes = list(scanned.nodes.values())
    positions_mm = np.array([node.position_mm for node in nodes])
    axes = Axis.through(positions_mm[:, 0]), Axis.through(positions_mm[:, 1])
    numbers = [axis.numbers(along).tolist() for axis, along in zip(axes, positions_mm.T, strict=True)]
    cells = list(zip(*numbers, strict=True))
    missing = [cell for cell, node in zip(cells, nodes, strict=True) if not node.is_usable]
    usable = np.array([node.is_usable for node in nodes])
    return ScanGrid(axes, GridPart.within(cells, missing), positions_mm[usable])


def weighted_nodes(
    nodes: Sequence[ScanNode], image_size: tuple[int, int], learnt: Learnt | None = None
) -> Nodes:
    """Return the nodes with their scatter relative to an ordinary one, from the sigmas of their spots.

    An ordinary node scatters by the effect of print and speckle on its spot, estimated about a first map. A
    spot cut by the border of the picture scatters more, by its own sigmas; one that falls on what a flat has
    not ``learnt``, three times as much. Raises ValueError when the nodes are too few for a map.
    """
    places_mm = np.array([node.position_mm for node in nodes])
    places_px = np.array([node.spot_px for node in nodes])
    sigmas_px = np.array([node.sigma_px for node in nodes])
    even = np.ones(len(nodes))
    if learnt is not None:
        shares = np.array([learnt.of_spot(*node.spot_px) for node in nodes])
        even = np.where(shares < MIN_LEARNT_SHARE, _UNLEARNT_RATIO, 1.0)
    relative = even
    uneven = sigmas_px > MAX_SIGMA_RATIO * np.median(sigmas_px)
    if uneven.any():
        hull_mm = convex_hull_mm(places_mm)
        for _ in range(_ITERATIONS):
            first = (
                fit_tensor_map(places_mm, places_px, hull_mm, None, relative),
                fit_lens_map(Nodes(places_mm, places_px, relative), hull_mm, image_size),
            )
            ordinary_px = min(fit.map.noise_px for fit in first)
            relative = np.where(uneven, np.maximum(sigmas_px / ordinary_px, even), even)
    return Nodes(places_mm, places_px, relative)


def offset_doubts(job: Job, nodes: Sequence[ScanNode], fitted: TensorMap) -> tuple[str, ...]:
    """Describe the scans of a target that deviate from its first one by more than its nodes scatter.

    A stage's zero, a camera or a target may have moved between them.

    The deviation is a mean over the nodes of both: print and speckle are the same in both, and the scatter
    of single exposures averages out.
    """
    first, *others = job.frames.parts
    doubts = []
    for other in others:
        shared = [
            (visits[first.number], visits[other.number], node)
            for node in nodes
            if {first.number, other.number} <= (visits := node.good_visits).keys()
        ]
        if not shared:
            continue
        offset_px = np.mean([there.spot_px - here.spot_px for here, there, _ in shared], axis=0)
        if float(np.linalg.norm(offset_px)) <= fitted.noise_px:
            continue
        middle_px = fitted.to_px(np.array([node.position_mm for _, _, node in shared])).mean(axis=0)
        jacobian = InverseMap(fitted).to_mm(middle_px[None])[1][0]
        offset_mm = float(np.linalg.norm(jacobian @ offset_px))
        doubts.append(
            f"{job.name}: {other.recording.path} puts the spots of {len(shared)} nodes {offset_mm:.2f} mm "
            f"from where {first.recording.path} does: something was moved between the scans"
        )
    return tuple(doubts)


_MAX_HIDDEN_PX = 0.1
"""Maximum displacement of a node by the hidden part of its spot; print and speckle displace by 0.05."""


def refuse_ended(job: Job, flat: Flat, nodes: Sequence[ScanNode]) -> None:
    """Refuse the nodes where the end of the surface hides a part of an asymmetric spot.

    A whole spot is displaced by its asymmetry like all others, a part of it is not. A flat shows the end, but
    not the hidden light. A symmetric spot is located as well by a part of it, with a larger sigma.
    """
    profiles = [fitted_profile(node.good[0].located[0].frame(), job.localiser, flat) for node in nodes]
    seen = [(n, p, m) for n, p in zip(nodes, profiles, strict=True) if p and (m := misfit_of(p.residuals))]
    hidden = [flat.hidden(p.centre.u_px, p.centre.v_px, p.diameter_px) for _, p, _ in seen]
    if not any(hidden):
        return
    ratio = float(np.median([misfit.chi2 / misfit.degrees_of_freedom for _, _, misfit in seen]))
    for (node, _, misfit), share in zip(seen, hidden, strict=True):
        if hidden_px(misfit, ratio, share) > _MAX_HIDDEN_PX:
            node.refusal = (
                "print or surface ends within its spot, which is not symmetric: scan a smaller area"
            )


_MOMENT = SpotSettings(method="moment")
_CORE = 0.3
"""Minimum relative light of a smoothed pixel in the core."""
_MIN_CORE_PIXELS = 20
_REACH_MM = 10.0
"""Minimum distance of reference nodes from the outermost ones; closer spots may be cut themselves."""
_MIN_INNER_NODES = 4
_MIN_TREND_NODES = 9
_MAX_INNER_NODES = 100
"""Maximum number of inner nodes used; more would only take time."""
_MIN_CUT_MM = 0.04
_MIN_CUT_SIGMAS = 5.0
_MIN_CUT_SHARE = 1 / 3
"""Minimum share of a side's nodes that are cut, and at least two nodes: dirt displaces single spots."""
_SAME_LINE_MM = 1.0


def cut_sides(
    frame_of: Callable[[int], Frame], nodes_mm: FloatArray, first_map: TensorMap
) -> tuple[str, ...]:
    """Return the outer columns and rows of nodes with spots cut by the end of the surface, such as ``x 70``.

    The cut displaces the centroid of a spot inwards. A Gaussian through the bright core of the smoothed spot
    is displaced less. The difference between the two shows the cut before the size of the core changes.

    ``frame_of`` returns one exposure of a node by its number. ``nodes_mm`` (n, 2) are the positions of the
    stage.
    """
    low, high = nodes_mm.min(axis=0), nodes_mm.max(axis=0)
    reach_mm = np.minimum(_REACH_MM, (high - low) / 4)
    inside_mm = np.minimum(nodes_mm - low, high - nodes_mm)
    inner = (inside_mm > reach_mm).all(axis=1)
    is_used = (inside_mm < _SAME_LINE_MM).any(axis=1)
    is_used[np.flatnonzero(inner)[:: 1 + np.count_nonzero(inner) // _MAX_INNER_NODES]] = True
    displacements_mm = np.full(nodes_mm.shape, np.nan)
    for row in np.flatnonzero(is_used).tolist():
        jacobian = first_map.jacobian(nodes_mm[row : row + 1])[0]
        displacements_mm[row] = _displacement_mm(frame_of(row), jacobian)
    has_both = np.isfinite(displacements_mm).all(axis=1)
    inner &= has_both
    if np.count_nonzero(inner) < _MIN_INNER_NODES:
        return ()
    design = np.column_stack([np.ones(len(nodes_mm)), nodes_mm])
    if np.count_nonzero(inner) < _MIN_TREND_NODES:
        design = design[:, :1]
    usual = np.linalg.lstsq(design[inner], displacements_mm[inner], rcond=None)[0]
    excess_mm = displacements_mm - design @ usual
    lost = np.sqrt(np.count_nonzero(inner) / (np.count_nonzero(inner) - design.shape[1]))
    sigmas_mm = lost * MAD_TO_SIGMA * np.median(np.abs(excess_mm[inner]), axis=0)
    # the trend reaches the outer nodes by extrapolation: its own uncertainty counts, too
    factor = np.linalg.inv(np.linalg.cholesky(design[inner].T @ design[inner])) @ design.T
    predicted = np.sqrt(1.0 + np.square(factor).sum(axis=0))
    sides = []
    for axis, name in enumerate("xy"):
        along_mm, off_mm = nodes_mm[:, axis], excess_mm[:, axis]
        limits_mm = np.maximum(_MIN_CUT_MM, _MIN_CUT_SIGMAS * float(sigmas_mm[axis]) * predicted)
        for end_mm, inwards in ((low[axis], 1), (high[axis], -1)):
            of_side = has_both & (np.abs(along_mm - end_mm) < _SAME_LINE_MM)
            cut = np.count_nonzero(inwards * off_mm[of_side] > limits_mm[of_side])
            if cut >= max(2, _MIN_CUT_SHARE * np.count_nonzero(of_side)):
                sides.append(f"{name} {end_mm:g}")
    return tuple(sides)


def _displacement_mm(frame: Frame, jacobian: FloatArray) -> FloatArray:
    """Centroid minus centre of the core (2,) mm; NaN if either is missing.

    ``jacobian`` (2, 2) is d(px)/d(mm).
    """
    analysis = FrameAnalysis(frame, _MOMENT)
    spot, patch = locate_in(analysis), analysis.brightest_patch
    centre_px = None if patch is None or patch.is_cut else _core_centre_px(patch)
    if centre_px is None or not isinstance(spot, Spot):
        return np.full(2, np.nan)
    displacement_px = np.array([spot.u_px, spot.v_px]) - centre_px
    return np.asarray(np.linalg.solve(jacobian, displacement_px))


def _core_centre_px(patch: Patch) -> FloatArray | None:
    """Centre (2,) of a Gaussian through the core of a smoothed spot; None if the core has no maximum."""
    light = patch.smooth.astype(np.float64)
    v, u = np.nonzero(light > _CORE * light.max())
    if len(u) < _MIN_CORE_PIXELS:
        return None
    core = light[v, u]
    middle_px = np.array([u.mean(), v.mean()])
    x, y = u - middle_px[0], v - middle_px[1]
    design = np.column_stack([np.ones(len(x)), x, y, 0.5 * x * x, x * y, 0.5 * y * y])
    *_, by_x, by_y, xx, xy, yy = np.linalg.lstsq(design * core[:, None], np.log(core) * core, rcond=None)[0]
    form = -np.array([[xx, xy], [xy, yy]])
    if np.linalg.eigvalsh(form)[0] <= 0:
        return None
    corner_px = np.array([patch.left, patch.top])
    return np.asarray(middle_px + corner_px + np.linalg.solve(form, (by_x, by_y)))
