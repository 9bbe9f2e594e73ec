"""Calibrate targets from scans: localise every node, fit every target's map (thesis 3.5.7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from altd.calibration.camera_fingerprint import fingerprint_of
from altd.calibration.fitting import TargetFit, fit_nodes
from altd.calibration.pattern import NodeScatter, pattern_noise_px, pattern_shape
from altd.calibration.printed.find import Print, find_print
from altd.calibration.recorded_flat import flat_correlation
from altd.calibration.result import Progress, TargetEvidence, TargetsResult, residual_distances_mm
from altd.calibration.scan_grid import cut_sides, offset_doubts, refuse_ended, scan_grid, weighted_nodes
from altd.calibration.scan_nodes import (
    Job,
    ScannedTarget,
    ScanNode,
    first_frames,
    first_of_nodes,
    locate_nodes,
    printed_nodes,
)
from altd.calibration.spot_reference import (
    LocaliserVerdict,
    localiser_agreement,
    refusal,
    spot_reference,
    verdict,
)
from altd.calibration.target_frames import FrameRow, TargetFrames
from altd.errors import BadInputError
from altd.mapping.grid import MIN_LINES
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Fiducials
from altd.measuring.calibration import TargetCalibration
from altd.records import FloatArray
from altd.vision.flat import Flat
from altd.vision.settings import UNKNOWN_SPOT, SpotReference, SpotSettings

PROFILE, _MOMENT = SpotSettings(method="profile"), SpotSettings(method="moment")
_MIN_CORRELATION = 0.5
"""Minimum correlation with a flat: the right one has 0.8 to 1, below 0.5 shifted by 1 px, about 0 by more."""
_MAX_UNMEASURED_SHARE = 0.25
"""Maximum share of nodes whose spot the calibrated unit refuses: single ones have dirt or a reflection."""
_MAX_FIDUCIAL_COST = 1.2
"""Maximum ratio of the leave-one-out rms with a print's fiducials to that without; above it, not used."""


@dataclass(frozen=True, slots=True)
class _Made:
    """Intermediate result of a target: calibration, evidence, the nodes' scatter, and findings."""

    target: TargetCalibration
    evidence: TargetEvidence
    scatter: NodeScatter
    used: tuple[FrameRow, ...]
    """The first good exposure of each node that was used."""
    remark: str = ""
    doubts: tuple[str, ...] = ()
    must_agree: bool = False
    """Whether the two localisers must agree, because no print explains a difference."""
    fiducials: Fiducials | None = None
    """Of a print that guides the map."""


def calibrate_scans(
    targets: Sequence[TargetFrames],
    flats: Mapping[str, Flat],
    progress: Progress,
    fiducials: Mapping[str, Fiducials] = MappingProxyType({}),
) -> TargetsResult:
    """Fit the maps of targets from their scans.

    Spots are localised through the target's flat. If ``flats`` has none, the scan is searched for a regular
    print, and the print is modelled. ``fiducials`` of such prints guide the maps of targets whose flat was
    learnt in service. Raises BadInputError when too few nodes have a spot or the nodes are no
    grid.
    """
    jobs = [Job(frames, PROFILE, flats.get(frames.name), fiducials.get(frames.name)) for frames in targets]
    made = [_calibrate_target(job, progress) for job in jobs]
    references = [_reference(job, of.target) for job, of in zip(jobs, made, strict=True)]
    patterns_px = pattern_noise_px(
        [
            of.scatter if spot is None else replace(of.scatter, texture_px=spot.texture_px)
            for of, spot in zip(made, references, strict=True)
        ]
    )
    verdicts = [_verdict(job, of, px) for job, of, px in zip(jobs, made, patterns_px, strict=True)]
    marked = [_with_camera(job, of) for job, of in zip(jobs, made, strict=True)]
    calibrated = tuple(
        _with_pattern(target, spot, of.scatter, pattern_px)
        for (target, _), spot, of, pattern_px in zip(marked, references, made, patterns_px, strict=True)
    )
    evidence = tuple(
        replace(of.evidence, unmeasured=_unmeasured(job, target, of.used))
        for job, target, of in zip(jobs, calibrated, made, strict=True)
    )
    return TargetsResult(
        calibrated,
        (
            *(f"{of.name} node x {x:g} y {y:g} mm: {why}" for of in evidence for (x, y), why in of.excluded),
            *(f"{of.name} {led}" for of in evidence for led in of.leds_dropped),
        ),
        evidence,
        (
            *(doubt for of in made for doubt in of.doubts),
            *(doubt for _, doubt in marked if doubt is not None),
            *(of.doubt for of in verdicts if of.doubt is not None),
            *(
                f"{of.name} node x {x:g} y {y:g} mm: the unit would not measure its spot: {why}"
                for of in evidence
                for (x, y), why in of.unmeasured
            ),
        ),
        (
            *(of.remark for of in made),
            *(line for of in evidence for line in _unequal_nodes(of)),
            *(of.remark for of in verdicts),
        ),
        {of.target.name: of.fiducials for of in made if of.fiducials is not None},
    )


def _reference(job: Job, target: TargetCalibration) -> SpotReference | None:
    """Return the reference of a target's good spots, with the noise about the map still to be set."""
    first = first_of_nodes(job)
    return spot_reference(
        lambda node: first[node].frame(), len(first), target.localiser, target.flat, target.map
    )


def _with_pattern(
    target: TargetCalibration, spot: SpotReference | None, scatter: NodeScatter, pattern_px: float
) -> TargetCalibration:
    """Return the target with the noise of print and speckle, and the reference of its good spots."""
    spot = UNKNOWN_SPOT if spot is None else replace(spot, noise_px=pattern_px)
    shape_mm = pattern_shape(np.array(list(scatter.residuals_mm.values())), spot.shape)
    return replace(target, map=target.map.with_noise(pattern_px, shape_mm), spot=spot)


def _unmeasured(
    job: Job, target: TargetCalibration, used: Sequence[FrameRow]
) -> tuple[tuple[tuple[float, float], str], ...]:
    """Return the nodes whose spot the calibrated unit refuses, with the reason.

    Raises BadInputError if they are more than ``_MAX_UNMEASURED_SHARE`` of all: the unit measures no such
    beam.
    """
    unmeasured = [
        (frame_row.row.position_mm or (0.0, 0.0), why)
        for frame_row in used
        if (why := refusal(frame_row.frame(), target)) is not None
    ]
    if len(unmeasured) > _MAX_UNMEASURED_SHARE * len(used):
        raise BadInputError(
            job.frames.place,
            f"{job.name}: the unit would not measure the spots of {len(unmeasured)} of {len(used)} nodes: "
            f"{unmeasured[0][1]}",
        )
    return tuple(unmeasured)


def _calibrate_target(job: Job, progress: Progress) -> _Made:
    """Calibrate one target through its recorded flat, else the model of its print, else neither."""
    if job.flat is not None and job.flat.learnt is not None:
        made = _fit_target(job, locate_nodes(job, progress), job.fiducials)
        return replace(made, remark=f"{job.name}: localised through a flat learnt in service")
    if job.flat is not None:
        scanned = locate_nodes(job, progress)
        refuse_ended(job, job.flat, scanned.usable)
        made = _fit_target(job, scanned, None)
        by_laser = job.flat.source == "laser"
        doubts = () if by_laser else _flat_doubts(flat_correlation(first_frames(job), job.flat), job.name)
        remark = (
            f"{job.name}: localised through its {'flat made with the laser' if by_laser else 'recorded flat'}"
        )
        return replace(made, remark=remark, doubts=made.doubts + doubts, must_agree=True)
    printed, nodes = printed_nodes(job)
    if 2 * printed > nodes:
        job = replace(job, localiser=_MOMENT)
    scanned = locate_nodes(job, progress)
    made = _fit_target(job, scanned, None)
    located = [node.good[0].located[0] for node in scanned.usable]
    sides = cut_sides(lambda node: located[node].frame(), _positions_mm(scanned.usable), made.target.map)
    if sides:
        raise BadInputError(
            job.frames.place,
            f"{job.name}: print or surface ends within the spots of the outer nodes "
            f"at {', '.join(sides)} mm: record a flat and calibrate with --flat, or scan a smaller area",
        )
    found = find_print(
        lambda node: located[node].frame(), _spots_px(scanned.usable), made.target.map, job.localiser
    )
    if found is not None:
        return _calibrate_printed(job, found, progress)
    remark = "plain, no print"
    if printed:
        remark = f"print at {printed} of {nodes} nodes, but no regular one: a flat would help"
    return replace(made, remark=f"{job.name}: {remark}", must_agree=not printed)


def _with_camera(job: Job, made: _Made) -> tuple[TargetCalibration, str | None]:
    """Return the target with its camera's identity, origin and fingerprint, and a doubt about the latter."""
    target = made.target
    flat = None if target.flat is not None and target.flat.learnt is not None else target.flat
    fingerprint, doubt = fingerprint_of(
        job.frames, target.localiser, flat, made.must_agree and target.flat is None
    )
    known = replace(target, camera=job.frames.camera, origin=job.frames.origin, fingerprint=fingerprint)
    return known, None if doubt is None else f"{job.name}: {doubt}"


def _verdict(job: Job, made: _Made, pattern_px: float) -> LocaliserVerdict:
    """Compare the two localisers; through a recorded flat, no pattern explains a difference."""
    target = made.target
    agreement = localiser_agreement(first_frames(job), target.localiser, target.flat)
    pattern_limit_px = 0.0 if job.flat is not None else pattern_px
    return verdict(
        target.name, target.localiser.method, agreement, pattern_limit_px if made.must_agree else None
    )


def _flat_doubts(correlation: float, name: str) -> tuple[str, ...]:
    if not correlation < _MIN_CORRELATION:  # also for NaN: a flat too even to tell is no worse than none
        return ()
    return (
        f"{name}: the flat does not match the spots (correlation {correlation:.2f} of 1): "
        "was it recorded before camera, lens or window were moved?",
    )


def _calibrate_printed(job: Job, found: Print, progress: Progress) -> _Made:
    """Calibrate a target through the model of its print, which also guides the map unless it is bent."""
    flat = replace(found.flat, origin=job.frames.origin)
    job = replace(job, localiser=PROFILE, flat=flat)
    scanned = locate_nodes(job, progress)
    alone, guided = (_fit_target(job, scanned, fiducials) for fiducials in (None, found.fiducials))
    remark = f"{job.name}: print of {found.lattice.pitch_mm:.3f} mm pitch found and modelled"
    if guided.target.leave_one_out_px > _MAX_FIDUCIAL_COST * alone.target.leave_one_out_px:
        return replace(alone, remark=f"{remark}; it is bent, so it does not guide the map")
    return replace(guided, remark=remark, fiducials=found.fiducials)


def _fit_target(job: Job, scanned: ScannedTarget, fiducials: Fiducials | None) -> _Made:
    """Fit the maps to the usable nodes; raises BadInputError if they are too few."""
    place, nodes, refused = job.frames.place, scanned.usable, scanned.refused
    if not scanned.nodes:
        raise BadInputError(place, f"{job.name}: 0 of 0 nodes have no spot: no row has a position")
    try:
        grid = scan_grid(scanned)
        if not grid.block.is_sufficient:
            needed = f"a map needs a grid of at least {MIN_LINES} × {MIN_LINES}"
            why = f"{len(scanned.nodes)} nodes do not form a usable grid: {needed}"
            if refused:
                share = f"{len(refused)} of {len(scanned.nodes)}"
                why = f"{share} nodes have no spot: {refused[0].complaint}"
            raise BadInputError(place, f"{job.name}: {why}")
        fitted = fit_nodes(
            weighted_nodes(nodes, job.frames.image_size, None if job.flat is None else job.flat.learnt),
            job.frames.image_size,
            grid.block.most_missing - grid.block.missing,
            fiducials,
        )
    except ValueError as error:
        raise BadInputError(place, f"{job.name}: {error}") from error
    for node in (nodes[row] for row in fitted.dropped):
        mapped_px = fitted.fit.map.to_px(_positions_mm([node]))
        off_px = float(np.linalg.norm(_spots_px([node]) - mapped_px))
        node.refusal = f"its spot lies {off_px:.1f} px from where the other nodes put it"
    margin_mm = fitted.fit.map.margin_mm
    return _Made(
        _target(job, scanned, fitted),
        _evidence(job, scanned, fitted),
        _scatter(scanned.usable, fitted),
        tuple(node.good[0].located[0] for node in scanned.usable),
        doubts=(
            *(f"{job.name}: {line}" for line in grid.missing_ends(margin_mm)),
            *offset_doubts(job, scanned.usable, fitted.fit.map),
        ),
    )


def _unequal_nodes(evidence: TargetEvidence) -> list[str]:
    """Describe the nodes that have a lower weight than the others, those of equal weight together."""
    places: dict[float, list[str]] = {}
    for (x, y), sigma in zip(evidence.nodes_mm.tolist(), evidence.relative_sigma.tolist(), strict=True):
        if sigma > 1.0:
            places.setdefault(sigma, []).append(f"x {x:g} y {y:g} mm")
    return [
        f"{evidence.name} node {of[0]} counts by 1/{sigma**2:.1f}: its spot is known worse"
        if len(of) == 1
        else f"{evidence.name}: {len(of)} nodes count by 1/{sigma**2:.1f}: their spots are known worse"
        for sigma, of in places.items()
    ]


def _positions_mm(nodes: Sequence[ScanNode]) -> FloatArray:
    return np.array([node.position_mm for node in nodes])


def _spots_px(nodes: Sequence[ScanNode]) -> FloatArray:
    return np.array([node.spot_px for node in nodes])


def _target(job: Job, scanned: ScannedTarget, fitted: TargetFit) -> TargetCalibration:
    distance_mm = residual_distances_mm(fitted.fit, _positions_mm(scanned.usable))
    width, height = job.frames.image_size
    return TargetCalibration(
        name=job.name,
        z_mm=job.frames.z_mm,
        glass=job.frames.glass,
        width=width,
        height=height,
        localiser=job.localiser,
        flat=job.flat,
        map=fitted.fit.map,
        cross_check=fitted.cross_check,
        leave_one_out_px=fitted.fit.leave_one_out_px,
        residual_mean_mm=float(distance_mm.mean()),
        residual_std_mm=float(distance_mm.std(ddof=1)),
        residual_max_mm=float(distance_mm.max()),
        repeatability_px=_repeatability_px(scanned.usable),
        leds_px=scanned.leds_px,
    )


def _evidence(job: Job, scanned: ScannedTarget, fitted: TargetFit) -> TargetEvidence:
    return TargetEvidence(
        name=job.name,
        nodes_mm=_positions_mm(scanned.usable),
        nodes_px=_spots_px(scanned.usable),
        residuals_px=fitted.fit.residuals_px,
        leave_one_out_residuals_px=fitted.fit.leave_one_out_residuals_px,
        relative_sigma=fitted.fit.relative_sigma,
        scatter_px=np.array([_scatter_px(node) for node in scanned.usable]),
        exposures=tuple(node.exposures for node in scanned.usable),
        excluded=tuple((node.position_mm, node.complaint) for node in scanned.refused),
        leds_dropped=scanned.leds_dropped,
        candidates=fitted.candidates,
    )


def _scatter(used: Sequence[ScanNode], fitted: TargetFit) -> NodeScatter:
    """Deviations of the used nodes from the map, in mm, for comparison with the other targets'."""
    nodes_px = fitted.fit.map.to_px(_positions_mm(used))
    _, jacobian, _ = InverseMap(fitted.fit.map).to_mm(nodes_px)
    residuals_mm = np.einsum("nij,nj->ni", jacobian, fitted.fit.residuals_px)
    exposures_mm = {}
    for node, to_mm in zip(used, jacobian, strict=True):
        for visit in node.good:
            for frame_row, deviation_px in zip(visit.located, visit.deviations_px, strict=True):
                exposures_mm[node.key, frame_row.number, frame_row.row.sequence] = to_mm @ deviation_px
    return NodeScatter(
        noise_px=fitted.fit.map.noise_px,
        parameters=fitted.fit.parameters,
        mm_per_px=float(np.sqrt(np.median(np.abs(np.linalg.det(jacobian))))),
        residuals_mm={node.key: residual for node, residual in zip(used, residuals_mm, strict=True)},
        exposures_mm=exposures_mm,
    )


def _repeatability_px(nodes: Sequence[ScanNode]) -> FloatArray:
    """Pooled standard deviation of single exposures at the same node, u and v; 0 if each has only one.

    Deviations are from the mean of each recording: a stage does not return exactly to the same place.
    """
    deviations = [visit.deviations_px for node in nodes for visit in node.good]
    freedom = sum(len(of_visit) - 1 for of_visit in deviations)
    if freedom == 0:
        return np.zeros(2)
    pooled: FloatArray = np.sqrt(sum(np.square(d).sum(axis=0) for d in deviations) / freedom)
    return pooled


def _scatter_px(node: ScanNode) -> FloatArray:
    """Standard deviation (2,) of the exposures at one node; NaN if each recording has only one."""
    if all(len(visit.spots_px) < 2 for visit in node.good):
        return np.full(2, np.nan)
    return _repeatability_px([node])
