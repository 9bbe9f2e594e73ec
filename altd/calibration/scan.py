"""A scan recording becomes a calibration: localise every node, fit every target's map (thesis 3.5.7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from altd.calibration.agreement import Agreement, Verdict, agreement, verdict
from altd.calibration.evidence import TargetEvidence
from altd.calibration.fitting import TargetFit, fit_nodes
from altd.calibration.model import Calibration, TargetCalibration
from altd.calibration.pattern import NodeScatter, pattern_noise_px
from altd.calibration.print_model import find_print
from altd.calibration.result import (
    CalibrationResult,
    Progress,
    cross_check_doubts,
    residual_distances_mm,
)
from altd.errors import BadInputError
from altd.mapping.inverse import InverseMap
from altd.mapping.marks import Marks
from altd.recording import Recording, Row
from altd.records import FloatArray, Frame, NoSpot
from altd.vision.flat import Flat
from altd.vision.leds import locate_leds
from altd.vision.localise import locate, shows_print
from altd.vision.settings import SpotSettings

_LARGEST_MISSING_SHARE = 0.2
_SAME_NODE_MM = 0.5
"""Exposures whose stage positions round to the same half millimetre belong to one node."""


@dataclass(slots=True)
class _Node:
    """The exposures at one node: stage positions mm, spots px, and why the others have none."""

    positions_mm: list[tuple[float, float]] = field(default_factory=list)
    spots_px: list[tuple[float, float]] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    located: list[Row] = field(default_factory=list)
    """The rows that the spots come from."""

    @property
    def usable(self) -> bool:
        """Whether most of its exposures have a spot."""
        return len(self.spots_px) > len(self.complaints)

    @property
    def key(self) -> tuple[int, int]:
        """Which node it is."""
        return _node_key(self.positions_mm[0])

    @property
    def position_mm(self) -> tuple[float, float]:
        """The mean of the stage's positions."""
        x_mm, y_mm = np.mean(self.positions_mm, axis=0).tolist()
        return x_mm, y_mm

    def refuse(self, why: str) -> None:
        """Take its exposures out of use."""
        self.spots_px.clear()
        self.located.clear()
        self.complaints.append(why)


@dataclass(slots=True)
class _Seen:
    """What a target's camera saw during the scan."""

    nodes: dict[tuple[int, int], _Node] = field(default_factory=dict)
    leds: list[FloatArray] = field(default_factory=list)

    @property
    def refused(self) -> list[_Node]:
        """The nodes that cannot be used."""
        return [node for node in self.nodes.values() if not node.usable]


@dataclass(frozen=True, slots=True)
class _Job:
    """One target of a scan and how its spots are localised."""

    recording: Recording
    name: str
    z_mm: float
    localiser: SpotSettings
    flat: Flat | None
    degree: tuple[int, int] | None

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the target's pictures, px."""
        camera = self.recording.header.cameras[self.name]
        return camera.width, camera.height


@dataclass(frozen=True, slots=True)
class _Made:
    """A target's calibration so far, what it rests on, its nodes' scatter, what was seen of its surface."""

    target: TargetCalibration
    evidence: TargetEvidence
    scatter: NodeScatter
    agreement: Agreement | None = None
    remark: str = ""
    must_agree: bool = False
    """Whether no print excuses the two localisers."""

    def verdict(self, pattern_px: float) -> Verdict:
        """On the two localisers; a recorded flat leaves no pattern to excuse them either."""
        allowed_px = 0.0 if self.target.flat is not None else pattern_px
        return verdict(
            self.evidence.name,
            self.target.localiser.method,
            self.agreement,
            allowed_px if self.must_agree else None,
        )


def calibrate_scan(
    recording: Recording,
    flats: Mapping[str, Flat] | None = None,
    localiser: SpotSettings | None = None,
    degree: tuple[int, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> CalibrationResult:
    """Fit the maps of every target of a recording of kind ``scan``.

    Spots are localised through the target's flat; where ``flats`` has none, the scan is searched for a
    regular print, of which a model is made. Raises BadInputError when it is no scan, when flats do not belong
    to it, when too few nodes have a spot, or when the nodes are no grid.
    """
    header = recording.header
    if header.kind != "scan":
        raise BadInputError(recording.path, f"is of kind {header.kind!r}; a calibration needs a 'scan'")
    distances = {"front": 0.0, "rear": header.unit.target_distance_mm}
    if set(header.cameras) != set(distances):
        raise BadInputError(recording.path, "a scan must have the cameras 'front' and 'rear'")
    jobs = [
        _Job(recording, name, z_mm, localiser or SpotSettings(), (flats or {}).get(name), degree)
        for name, z_mm in sorted(distances.items(), key=lambda item: item[1])
    ]
    for job in jobs:
        if job.flat is not None and job.flat.levels.shape[::-1] != job.image_size:
            raise BadInputError(recording.path, f"{job.name}: the flat is of another size than the frames")
    made = [_calibrate_target(job, progress) for job in jobs]
    patterns_px = pattern_noise_px([target.scatter for target in made])
    verdicts = [of.verdict(pattern_px) for of, pattern_px in zip(made, patterns_px, strict=True)]
    calibration = Calibration(
        unit_serial=header.unit.serial,
        created=datetime.now(UTC),
        recording_note=header.note,
        recording_sha256=recording.sha256(),
        targets=tuple(
            replace(of.target, map=replace(of.target.map, noise_px=pattern_px))
            for of, pattern_px in zip(made, patterns_px, strict=True)
        ),
    )
    return CalibrationResult(
        calibration,
        tuple(
            f"{of.evidence.name} node x {x:g} y {y:g} mm: {why}"
            for of in made
            for (x, y), why in of.evidence.left_out
        ),
        tuple(of.evidence for of in made),
        (*cross_check_doubts(calibration.targets), *(of.doubt for of in verdicts if of.doubt is not None)),
        (*(of.remark for of in made), *(of.remark for of in verdicts)),
    )


def _calibrate_target(job: _Job, progress: Progress) -> _Made:
    """One target: localised through its flat, the model of its print, or as plain."""
    seen = _look(job, progress)
    made = _fit_target(job, seen, None)
    if job.flat is not None:
        return replace(made, remark=f"{job.name}: localised through its recorded flat", must_agree=True)
    usable = [node for node in seen.nodes.values() if node.usable]
    frames = [job.recording.frame(node.located[0]) for node in usable]
    printed = sum(shows_print(frame, job.localiser) for frame in frames)
    if 2 * printed < len(frames):
        plain = replace(made.target, localiser=replace(job.localiser, method="profile"))
        return replace(made, target=plain, remark=f"{job.name}: plain, no print", must_agree=True)
    nodes_px = np.array([np.mean(node.spots_px, axis=0) for node in usable])
    found = find_print(frames, nodes_px, made.target.map, job.localiser)
    if found is None:
        bare = replace(made.target, localiser=replace(job.localiser, method="moment"))
        return replace(made, target=bare, remark=f"{job.name}: printed, not regularly: a flat would help")
    job = replace(job, flat=found.flat)
    made = _fit_target(job, _look(job, lambda done, total: None), found.marks)
    pitch_mm = found.lattice.pitches_mm[0]
    return replace(made, remark=f"{job.name}: print of {pitch_mm:.3f} mm pitch found and modelled")


def _look(job: _Job, progress: Progress) -> _Seen:
    """Localise the spots of all nodes and the LEDs of all reference pairs in one camera's frames."""
    seen = _Seen()
    dark: Frame | None = None
    rows = [row for row in job.recording.rows if row.camera == job.name]
    for done, row in enumerate(rows, start=1):
        frame = job.recording.frame(row)
        if row.position_mm is not None:
            if not row.leds_on:
                _take_node(seen, frame, row, job)
        elif not row.leds_on:
            dark = frame
        elif dark is not None:  # LED reference exposures come in pairs: off, then on
            spots = locate_leds(frame, dark)
            seen.leds.append(np.array([(spot.u_px, spot.v_px) for spot in spots]).reshape(-1, 2))
        progress(done, len(rows))
    return seen


def _node_key(position_mm: tuple[float, float]) -> tuple[int, int]:
    x_mm, y_mm = position_mm
    return round(x_mm / _SAME_NODE_MM), round(y_mm / _SAME_NODE_MM)


def _take_node(seen: _Seen, frame: Frame, row: Row, job: _Job) -> None:
    assert row.position_mm is not None  # noqa: S101  the caller looked
    node = seen.nodes.setdefault(_node_key(row.position_mm), _Node())
    node.positions_mm.append(row.position_mm)
    spot = locate(frame, job.localiser, job.flat)
    if isinstance(spot, NoSpot):
        detail = f" ({spot.detail})" if spot.detail else ""
        node.complaints.append(f"{spot.reason} in {row.file}{detail}")
    else:
        node.spots_px.append((spot.u_px, spot.v_px))
        node.located.append(row)


def _fit_target(job: _Job, seen: _Seen, marks: Marks | None) -> _Made:
    recording, name = job.recording, job.name
    nodes = [node for node in seen.nodes.values() if node.usable]
    refused, most = seen.refused, int(_LARGEST_MISSING_SHARE * len(seen.nodes))
    if len(refused) > most or not nodes:
        why = refused[0].complaints[0] if refused else "no row has a position"
        raise BadInputError(
            recording.path, f"{name}: {len(refused)} of {len(seen.nodes)} nodes have no spot: {why}"
        )
    all_mm = np.array([node.position_mm for node in nodes])
    all_px = np.array([np.mean(node.spots_px, axis=0) for node in nodes])
    try:
        fitted = fit_nodes(all_mm, all_px, job.image_size, job.degree, most - len(refused), marks)
    except ValueError as error:
        raise BadInputError(recording.path, f"{name}: {error}") from error
    fit = fitted.fit
    used = [node for row, node in enumerate(nodes) if row not in fitted.dropped]
    exposures = [node.spots_px for node in used]
    for row in fitted.dropped:
        off_px = float(np.linalg.norm(all_px[row] - fit.map.to_px(all_mm[row : row + 1])[0]))
        nodes[row].refuse(f"its spot lies {off_px:.1f} px from where the other nodes put it")
    nodes_mm = np.delete(all_mm, fitted.dropped, axis=0)
    distance_mm = residual_distances_mm(fit, nodes_mm)
    target = TargetCalibration(
        name=name,
        z_mm=job.z_mm,
        width=job.image_size[0],
        height=job.image_size[1],
        localiser=replace(job.localiser, method="profile") if job.flat is not None else job.localiser,
        flat=job.flat,
        map=fit.map,
        cross_check=fitted.cross_check,
        left_out_px=fit.left_out_px,
        residual_mean_mm=float(distance_mm.mean()),
        residual_std_mm=float(distance_mm.std(ddof=1)),
        residual_max_mm=float(distance_mm.max()),
        repeatability_px=_repeatability_px(exposures),
        leds_px=_mean_leds_px(seen.leds),
    )
    evidence = TargetEvidence(
        name=name,
        nodes_mm=nodes_mm,
        nodes_px=np.delete(all_px, fitted.dropped, axis=0),
        residuals_px=fit.residuals_px,
        missed_px=fit.missed_px,
        scatter_px=np.array([_scatter_px(spots) for spots in exposures]),
        exposures=tuple(len(spots) for spots in exposures),
        left_out=tuple((node.position_mm, node.complaints[0]) for node in seen.refused),
        candidates=fitted.candidates,
    )
    frames = (recording.frame(node.located[0]) for node in used)
    return _Made(target, evidence, _scatter(fitted, used), agreement(frames, job.localiser, job.flat))


def _scatter(fitted: TargetFit, used: list[_Node]) -> NodeScatter:
    """How the nodes that were used lie about the map, in mm, to be held against the other targets'."""
    nodes_mm = np.array([node.position_mm for node in used])
    _, jacobian, _ = InverseMap.of(fitted.fit.map).to_mm(fitted.fit.map.to_px(nodes_mm))
    residuals_mm = np.einsum("nij,nj->ni", jacobian, fitted.fit.residuals_px)
    exposures_mm = {}
    for node, to_mm in zip(used, jacobian, strict=True):
        deviations_px = np.array(node.spots_px) - np.mean(node.spots_px, axis=0)
        for row, deviation_px in zip(node.located, deviations_px, strict=True):
            exposures_mm[node.key, row.sequence] = to_mm @ deviation_px
    return NodeScatter(
        noise_px=fitted.fit.map.noise_px,
        parameters=fitted.fit.parameters,
        mm_per_px=float(np.sqrt(np.median(np.abs(np.linalg.det(jacobian))))),
        residuals_mm={node.key: residual for node, residual in zip(used, residuals_mm, strict=True)},
        exposures_mm=exposures_mm,
    )


def _repeatability_px(exposures: list[list[tuple[float, float]]]) -> FloatArray:
    """Pooled standard deviation of single exposures at the same node, u and v; 0 when each has but one."""
    deviations = [np.array(spots) - np.mean(spots, axis=0) for spots in exposures]
    freedom = sum(len(spots) - 1 for spots in exposures)
    if freedom == 0:
        return np.zeros(2)
    pooled: FloatArray = np.sqrt(sum(np.square(d).sum(axis=0) for d in deviations) / freedom)
    return pooled


def _scatter_px(spots: list[tuple[float, float]]) -> FloatArray:
    """Standard deviation (2,) of the exposures at one node; NaN when there is but one."""
    if len(spots) < 2:
        return np.full(2, np.nan)
    scatter: FloatArray = np.std(spots, axis=0, ddof=1)
    return scatter


def _mean_leds_px(pairs: list[FloatArray]) -> FloatArray:
    """Mean LED positions over the reference pairs that show the usual number of LEDs."""
    if not pairs:
        return np.empty((0, 2))
    usual = int(np.median([len(pair) for pair in pairs]))
    same = [pair for pair in pairs if len(pair) == usual]
    return np.mean(same, axis=0) if same and usual else np.empty((0, 2))
