"""A scan recording becomes a calibration: localise every node, fit every target's map (thesis 3.5.7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from altd.calibration.evidence import TargetEvidence
from altd.calibration.fitting import fit_nodes
from altd.calibration.model import Calibration, TargetCalibration
from altd.errors import BadInputError
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import Fit
from altd.recording import Recording, Row
from altd.records import FloatArray, Frame, NoSpot
from altd.vision.leds import locate_leds
from altd.vision.localise import locate
from altd.vision.settings import SpotSettings

Progress = Callable[[int, int], None]
"""Told how many of how many frames are done."""

_LARGEST_MISSING_SHARE = 0.2
_SAME_NODE_MM = 0.5
"""Exposures whose stage positions round to the same half millimetre belong to one node."""


@dataclass(slots=True)
class _Node:
    """The exposures at one node: stage positions mm, spots px, and why the others have none."""

    positions_mm: list[tuple[float, float]] = field(default_factory=list)
    spots_px: list[tuple[float, float]] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    @property
    def usable(self) -> bool:
        """Whether most of its exposures have a spot."""
        return len(self.spots_px) > len(self.complaints)

    @property
    def position_mm(self) -> tuple[float, float]:
        """The mean of the stage's positions."""
        x_mm, y_mm = np.mean(self.positions_mm, axis=0).tolist()
        return x_mm, y_mm

    def refuse(self, why: str) -> None:
        """Take its exposures out of use."""
        self.spots_px.clear()
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
class ScanResult:
    """A calibration and, in words, the nodes that it was made without and what is doubtful about it.

    ``evidence`` is what each target's calibration was made from, in the order of the targets.
    """

    calibration: Calibration
    refused: tuple[str, ...]
    evidence: tuple[TargetEvidence, ...]
    doubts: tuple[str, ...]


def calibrate_scan(
    recording: Recording,
    localiser: SpotSettings | None = None,
    degree: tuple[int, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> ScanResult:
    """Fit the maps of every target of a recording of kind ``scan``.

    Raises BadInputError when it is no scan, when too few nodes have a spot, or when the nodes are no grid.
    """
    header = recording.header
    if header.kind != "scan":
        raise BadInputError(recording.path, f"is of kind {header.kind!r}; a calibration needs a 'scan'")
    distances = {"front": 0.0, "rear": header.unit.target_distance_mm}
    if set(header.cameras) != set(distances):
        raise BadInputError(recording.path, "a scan must have the cameras 'front' and 'rear'")
    localiser = localiser or SpotSettings()
    seen = _look(recording, localiser, progress)
    made = [
        _target(recording, name, z_mm, seen[name], localiser, degree)
        for name, z_mm in sorted(distances.items(), key=lambda item: item[1])
    ]
    calibration = Calibration(
        unit_serial=header.unit.serial,
        created=datetime.now(UTC),
        recording_note=header.note,
        recording_sha256=recording.sha256(),
        targets=tuple(target for target, _ in made),
    )
    refused = [
        f"{name} node x {node.positions_mm[0][0]:g} y {node.positions_mm[0][1]:g} mm: {node.complaints[0]}"
        for name, of_target in seen.items()
        for node in of_target.refused
    ]
    doubts = [
        f"{target.name}: the {target.map.model} and the {target.cross_check.map.model} map lie up to "
        f"{target.cross_check.largest_px:.2f} px apart; where it is more than "
        f"{target.cross_check.bound_px:.2f} px a measurement will be implausible"
        for target in calibration.targets
        if target.cross_check.largest_px > target.cross_check.bound_px
    ]
    return ScanResult(calibration, tuple(refused), tuple(evidence for _, evidence in made), tuple(doubts))


def _look(recording: Recording, localiser: SpotSettings, progress: Progress) -> dict[str, _Seen]:
    """Localise the spots of all nodes and the LEDs of all reference pairs."""
    seen = {camera: _Seen() for camera in recording.header.cameras}
    dark: dict[str, Frame] = {}
    for done, row in enumerate(recording.rows):
        progress(done, len(recording.rows))
        frame = recording.frame(row)
        if row.position_mm is None:
            _take_reference(seen[row.camera], frame, dark)
        elif not row.leds_on:
            _take_node(seen[row.camera], frame, row, localiser)
    progress(len(recording.rows), len(recording.rows))
    return seen


def _take_reference(seen: _Seen, frame: Frame, dark: dict[str, Frame]) -> None:
    """LED reference exposures come in pairs: off, then on."""
    if not frame.leds_on:
        dark[frame.camera] = frame
    elif frame.camera in dark:
        spots = locate_leds(frame, dark[frame.camera])
        seen.leds.append(np.array([(spot.u_px, spot.v_px) for spot in spots]).reshape(-1, 2))


def _take_node(seen: _Seen, frame: Frame, row: Row, localiser: SpotSettings) -> None:
    assert row.position_mm is not None  # noqa: S101  the caller looked
    x_mm, y_mm = row.position_mm
    node = seen.nodes.setdefault((round(x_mm / _SAME_NODE_MM), round(y_mm / _SAME_NODE_MM)), _Node())
    node.positions_mm.append(row.position_mm)
    spot = locate(frame, localiser)
    if isinstance(spot, NoSpot):
        detail = f" ({spot.detail})" if spot.detail else ""
        node.complaints.append(f"{spot.reason} in {row.file}{detail}")
    else:
        node.spots_px.append((spot.u_px, spot.v_px))


def _target(
    recording: Recording,
    name: str,
    z_mm: float,
    seen: _Seen,
    localiser: SpotSettings,
    degree: tuple[int, int] | None,
) -> tuple[TargetCalibration, TargetEvidence]:
    nodes = [node for node in seen.nodes.values() if node.usable]
    refused, most = seen.refused, int(_LARGEST_MISSING_SHARE * len(seen.nodes))
    if len(refused) > most or not nodes:
        why = refused[0].complaints[0] if refused else "no row has a position"
        raise BadInputError(
            recording.path, f"{name}: {len(refused)} of {len(seen.nodes)} nodes have no spot: {why}"
        )
    all_mm = np.array([node.position_mm for node in nodes])
    all_px = np.array([np.mean(node.spots_px, axis=0) for node in nodes])
    size = recording.header.cameras[name].width, recording.header.cameras[name].height
    try:
        fitted = fit_nodes(all_mm, all_px, size, degree, most - len(refused))
    except ValueError as error:
        raise BadInputError(recording.path, f"{name}: {error}") from error
    fit = fitted.fit
    used = [node for row, node in enumerate(nodes) if row not in fitted.dropped]
    exposures = [node.spots_px for node in used]
    for row in fitted.dropped:
        off_px = float(np.linalg.norm(all_px[row] - fit.map.to_px(all_mm[row : row + 1])[0]))
        nodes[row].refuse(f"its spot lies {off_px:.1f} px from where the other nodes put it")
    nodes_mm = np.delete(all_mm, fitted.dropped, axis=0)
    distance_mm = _residual_distances_mm(fit, nodes_mm)
    target = TargetCalibration(
        name=name,
        z_mm=z_mm,
        width=size[0],
        height=size[1],
        localiser=localiser,
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
    return target, evidence


def _residual_distances_mm(fit: Fit, nodes_mm: FloatArray) -> FloatArray:
    """Eq. 3.1 for the nodes themselves: how far from its known place the map puts each one."""
    nodes_px = fit.map.to_px(nodes_mm) + fit.residuals_px
    _, jacobian, _ = InverseMap.of(fit.map).to_mm(nodes_px)
    offsets: FloatArray = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, fit.residuals_px), axis=1)
    return offsets


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
