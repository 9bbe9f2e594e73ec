"""Calibrate a unit from recordings: each target from its scans or its plate."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from altd.calibration.from_plates import calibrate_plates
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.recorded_flat import flats_of
from altd.calibration.result import CalibrationResult, Progress, TargetsResult, cross_check_doubts
from altd.calibration.scan_grid import MAX_SIGMA_RATIO
from altd.calibration.scan_nodes import Job, ScanNode, locate_nodes
from altd.calibration.service_flat import check_service, with_service
from altd.calibration.target_frames import TargetFrames, target_frames
from altd.errors import BadInputError
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.reader import Recording
from altd.records import FloatArray, Limits
from altd.records.limits import LIMIT_KEYS, NO_LIMITS


def calibrate(
    recordings: Sequence[Recording],
    flat: Recording | None = None,
    progress: Progress = lambda done, total: None,
    service: Recording | None = None,
) -> CalibrationResult:
    """Fit the maps of every target in the recordings; ``flat`` is a recording of kind ``flat``.

    From ``service``, a recording of measurements, a flat is learnt if its spots show more than it assumes.
    Raises BadInputError when the recordings are incompatible or one of them is unusable, see
    ``target_frames``, ``calibrate_scans``, ``calibrate_plates`` and ``flats_of``.
    """
    targets = target_frames(recordings)
    scanned, turned = _by_turn([frames for frames in targets if frames.kind == "scan"])
    if flat is not None and not scanned:
        raise BadInputError(flat.path, "is for a scan; a plate shows no laser spot")
    flats = {} if flat is None else flats_of(flat, scanned, progress)
    headers = [recording.header for recording in recordings if recording.header.kind == "scan"]
    for recording in recordings:
        if recording.header.deflection_yaw_deg or recording.header.deflection_pitch_deg:
            raise BadInputError(
                recording.path, "has a deflected beam: it verifies a calibration, and makes none"
            )
    if service is not None:
        check_service(scanned, flats, service)
    of_scans = calibrate_scans(scanned, flats, progress)
    if service is not None:
        of_scans = with_service(scanned, of_scans, service, progress)
    plates = [frames.plate for frames in targets if frames.kind == "plate"]
    limits = _limits([header.limits for header in headers if header.limits] + [of.limits for of in plates])
    if limits != NO_LIMITS and plates:
        limits = _of_plates(limits, targets)
    celsius = [header.temperature_c for header in headers if header.temperature_c is not None]
    if turned:
        tilt = beam_tilt(of_scans.targets, turned, progress)
        of_scans = without_tilt(of_scans, tilt)
        seats = [header.seat_mm_per_m for header in headers if header.seat_mm_per_m is not None]
        seated = max(seats, default=0.0) / math.sqrt(2)  # of the mean of two seatings
        limits = replace(limits, beam_normal_mm_per_m=math.hypot(1000 * tilt.sigma, seated))
    of_plates = calibrate_plates([frames for frames in targets if frames.kind == "plate"], progress)
    both = of_scans, of_plates
    calibration = Calibration(
        unit_serial=recordings[0].header.unit.serial,
        created=datetime.now(UTC),
        recording_note="; ".join(dict.fromkeys(of.header.note for of in recordings if of.header.note)),
        recording_sha256=sha256_of_all([recording.sha256() for recording in recordings]),
        targets=tuple(sorted((target for of in both for target in of.targets), key=lambda of: of.z_mm)),
        limits=limits,
        temperature_c=float(np.mean(celsius)) if celsius else None,
    )
    evidence = {seen.name: seen for of in both for seen in of.evidence}
    return CalibrationResult(
        calibration,
        of_scans.refused + of_plates.refused,
        tuple(evidence[name] for name in calibration.target_names),
        (
            *cross_check_doubts(calibration.targets),
            *of_scans.doubts,
            *of_plates.doubts,
            *(_zero_doubts(targets) if limits.plate_mm is None else ()),
        ),
        of_scans.remarks + of_plates.remarks,
    )


def _by_turn(scanned: Sequence[TargetFrames]) -> tuple[list[TargetFrames], list[TargetFrames]]:
    """Separate the scans of the unturned unit, which define its frame, from those of the turned unit."""
    as_it_is, turned = [], []
    for frames in scanned:
        upright, of_turned_unit = frames.of_turned_unit(False), frames.of_turned_unit(True)
        if upright is None:
            why = "every scan is of the turned unit; one with turned_deg 0 defines the unit's frame"
            raise BadInputError(frames.place, f"{frames.name}: {why}")
        as_it_is.append(upright)
        if of_turned_unit is not None:
            turned.append(of_turned_unit)
    return as_it_is, turned


def _limits(stated: Sequence[Limits]) -> Limits:
    """Limits that scans and plates state; the larger value if several state the same one."""
    of_all = {key: [sigma for of in stated if (sigma := getattr(of, key)) is not None] for key in LIMIT_KEYS}
    return Limits(**{key: max(sigmas) for key, sigmas in of_all.items() if sigmas})


def _of_plates(limits: Limits, targets: Sequence[TargetFrames]) -> Limits:
    """Limits with the zero of yaw and pitch, which is uncertain by the places of two plates.

    Raises BadInputError unless one scale holds for all targets.
    """
    plates = [frames.plate for frames in targets if frames.kind == "plate"]
    stated = {plate.limits for plate in plates}
    if stated != {NO_LIMITS} and (len(plates) < len(targets) or len(stated) > 1):
        why = "a plate states its uncertainty: show the same plate on all targets, with the same statement"
        raise BadInputError(targets[0].place, why)
    if limits.plate_mm is None or len(targets) < 2:
        return limits
    apart_mm = targets[-1].z_mm - targets[0].z_mm
    return replace(limits, beam_normal_mm_per_m=1e3 * math.sqrt(2) * limits.plate_mm / apart_mm)


def _zero_doubts(targets: Sequence[TargetFrames]) -> tuple[str, ...]:
    """Return a doubt if the targets' zeros may differ; a beam's direction is the difference of points."""
    first, *others = [{part.recording.path for part in frames.parts} for frames in targets]
    if not any(first.isdisjoint(other) for other in others):
        return ()
    return (
        "the targets are from different recordings: the zero of yaw and pitch is that of the stage or the "
        "plates, which must have been the same, and is not in sigma",
    )


def sha256_of_all(hashes: Sequence[str]) -> str:
    """Hash of one recording; for several, the SHA-256 over their hashes, one per line, in their order."""
    if len(hashes) == 1:
        return hashes[0]
    return hashlib.sha256("".join(f"{of}\n" for of in hashes).encode()).hexdigest()


_MIN_NODES = 6
_MAX_RATIO = 3.0
"""Maximum ratio of the nodes' scatter to that of print, speckle and map, if the unit was turned by 180°."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamTilt:
    """Slopes (2,) of the calibrating beam against the normal of the targets, each with ``sigma``."""

    slopes: FloatArray
    sigma: float

    def __str__(self) -> str:
        x, y = 1000 * self.slopes
        sigma = f"sigma {1000 * self.sigma:.3f} mm/m"
        return f"tilt of the calibrating beam x {x:+.3f}, y {y:+.3f} mm/m, {sigma}"

    def removed_from(self, target: TargetCalibration) -> TargetCalibration:
        """Return the target with its maps shifted to where the beam met it."""
        shift_mm = self.slopes * target.z_mm
        check = replace(target.cross_check, map=_shifted(target.cross_check.map, shift_mm))
        return replace(target, map=_shifted(target.map, shift_mm), cross_check=check)


def _shifted(fitted: TensorMap, shift_mm: FloatArray) -> TensorMap:
    axes = (fitted.x_axis, fitted.y_axis)
    x_axis, y_axis = (
        replace(axis, first_mm=axis.first_mm + float(by)) for axis, by in zip(axes, shift_mm, strict=True)
    )
    return replace(fitted, x_axis=x_axis, y_axis=y_axis, hull_mm=fitted.hull_mm + shift_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """Mean (2,) of reading plus stage position over a target's nodes, and its variance per axis."""

    z_mm: float
    sum_mm: FloatArray
    variance_mm2: float


def beam_tilt(
    targets: Sequence[TargetCalibration], turned: Sequence[TargetFrames], progress: Progress
) -> BeamTilt:
    """Estimate the beam's tilt from scans of the unit turned by half a turn about its own z axis.

    Stage and beam do not move while the unit is turned. With stage (X, Y) and tilt t, the beam meets a target
    at z in (X, Y) + t · z, but the map, fitted to the scan of the unturned unit, reads (X, Y). It meets the
    turned unit in c − (X, Y) − t · z, so the map reads c − (X, Y) − 2 t · z. The mean of reading plus stage
    position is therefore c at z = 0 and changes by −2 t for each mm along the beam.

    Raises BadInputError for fewer than two targets, for too few nodes of one, and for a motion other than
    half a turn about z.
    """
    known = {target.name: target for target in targets}
    readings = [_reading(known[frames.name], frames, progress) for frames in turned]
    if len(readings) < 2:
        raise BadInputError(turned[0].place, "shows one target of the turned unit; the tilt needs two")
    z_mm = np.array([reading.z_mm for reading in readings])
    weights = np.array([1 / reading.variance_mm2 for reading in readings])
    design = np.column_stack([np.ones_like(z_mm), -2 * z_mm])
    covariance = np.linalg.inv(design.T @ (weights[:, None] * design))
    sums = np.array([reading.sum_mm for reading in readings])
    fitted: FloatArray = covariance @ design.T @ (weights[:, None] * sums)
    return BeamTilt(fitted[1], float(np.sqrt(covariance[1, 1])))


def without_tilt(scans: TargetsResult, tilt: BeamTilt) -> TargetsResult:
    """Return the scans' targets and nodes corrected for the beam's tilt, with a remark on it."""
    z_mm = {target.name: target.z_mm for target in scans.targets}
    evidence = (
        replace(seen, nodes_mm=seen.nodes_mm + tilt.slopes * z_mm[seen.name]) for seen in scans.evidence
    )
    return replace(
        scans,
        targets=tuple(tilt.removed_from(target) for target in scans.targets),
        evidence=tuple(evidence),
        remarks=(*scans.remarks, f"{tilt}: removed"),
    )


def _reading(target: TargetCalibration, frames: TargetFrames, progress: Progress) -> _Reading:
    nodes = locate_nodes(Job(frames, target.localiser, target.flat), progress).usable
    stage_mm, read_mm, variance_mm2 = _read(target, nodes)
    if len(stage_mm) < _MIN_NODES:
        why = f"{len(stage_mm)} of {len(nodes)} nodes of the turned unit lie in the calibrated area"
        raise BadInputError(frames.place, f"{frames.name}: {why}, {_MIN_NODES} are needed")
    # p + P = sum + turn × P: the turn differs slightly from half a turn
    design = np.zeros((2 * len(stage_mm), 3))
    design[0::2, 0] = design[1::2, 1] = 1.0
    design[0::2, 2], design[1::2, 2] = -stage_mm[:, 1], stage_mm[:, 0]
    sums = (read_mm + stage_mm).ravel()
    solution: FloatArray = np.asarray(np.linalg.lstsq(design, sums, rcond=None)[0], dtype=np.float64)
    degrees_of_freedom = sums.size - design.shape[1]
    scatter_mm2 = float(np.square(sums - design @ solution).sum()) / degrees_of_freedom
    ratio = float(np.sqrt(scatter_mm2 / variance_mm2))
    if ratio > _MAX_RATIO:
        raise BadInputError(
            frames.place,
            f"{frames.name}: the nodes scatter {ratio:.0f} times as much as print, speckle and map explain: "
            "was the unit turned by 180° about z, and nothing else moved?",
        )
    # factor 2: the map's error is common to all nodes and has the variance of a mean of as many nodes
    return _Reading(target.z_mm, solution[:2], 2 * max(scatter_mm2, variance_mm2) / len(stage_mm))


def _read(target: TargetCalibration, nodes: Sequence[ScanNode]) -> tuple[FloatArray, FloatArray, float]:
    """Return stage positions and readings (n, 2) mm of nodes in the area, and the variance of a reading.

    Nodes with less certain spots, such as those that the picture's border cuts, are left out.
    """
    sigmas_px = np.array([node.sigma_px for node in nodes])
    nodes = [node for node in nodes if node.sigma_px <= MAX_SIGMA_RATIO * np.median(sigmas_px)]
    stage_mm = np.array([node.position_mm for node in nodes]).reshape(-1, 2)
    spots_px = np.array([node.spot_px for node in nodes]).reshape(-1, 2)
    read_mm, _, covariance_mm2 = target.inverse.to_mm(spots_px)
    is_known = np.isfinite(read_mm).all(axis=1)
    traces = np.trace(covariance_mm2[is_known], axis1=1, axis2=2) / 2
    return stage_mm[is_known], read_mm[is_known], float(traces.mean()) if is_known.any() else 0.0
