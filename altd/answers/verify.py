"""``altd verify``: measures known beams, and checks whether the unit keeps its stated limits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from altd.acquisition.scan.plan import nodes_of
from altd.app.replay import Replay, replay_of
from altd.app.settings import load_beam_settings
from altd.calibration.calibrating import sha256_of_all
from altd.calibration.file import check_recording, load_calibration, target_of
from altd.calibration.from_plates import spots_of_plate
from altd.calibration.target_frames import TargetFrames, target_frames
from altd.calibration.verification.document import (
    comparison,
    head_object,
    plate_object,
    plate_residual_objects,
    read_earlier,
    residual_objects,
    set_objects,
)
from altd.calibration.verification.estimate import (
    BeamSet,
    Mounting,
    beam_set,
    estimate,
    why_not_aligned,
    why_too_few,
)
from altd.calibration.verification.plates import PlateSet, plate_set, tests_of_plates
from altd.calibration.verification.verdict import Judgement, LimitTest, Result, judge, judge_agreement
from altd.config import Measuring, Scan
from altd.config.measuring import ScanLimits
from altd.errors import BadInputError
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.instrument import Solution
from altd.recording.header import RecordingHeader
from altd.recording.reader import Recording, open_recording
from altd.records import Limits, MeanSpots, Measurement, Origin, counted, utc_text
from altd.records.limits import LIMIT_KEYS

MAX_POSITIONS = 2000
"""Maximum number of valid positions of a set; the covariances of all sets are full matrices."""
_MAX_INVALID_SHARE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """A measured recording."""

    replay: Replay
    beams: BeamSet
    positions: int
    invalid: Counter[str]


def verify(
    recordings: Sequence[Path], calibration: Path, earlier: Path | None, progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """Return the verification as plain JSON types; each recording is a set, of a plate one on each target.

    Raises BadInputError for files that cannot be read or do not belong together.
    """
    opened = [open_recording(path) for path in recordings]
    known = load_calibration(calibration, opened[0].header.unit.serial)
    unit = known.unit_serial
    before = None if earlier is None else read_earlier(earlier, unit)
    _check_independent(opened, known)
    is_of_plates = any(recording.header.kind == "plate" for recording in opened)
    if is_of_plates:
        is_simulated, reference = known.simulated or any(map(_is_simulated, opened)), None
        judgement, of_sets, residuals = _plates(opened, known, calibration, progress)
    else:
        replays = [replay_of(recording, calibration) for recording in opened]
        is_simulated = any(replay.is_simulated for replay in replays)
        measured = [_measure(replay, progress) for replay in replays]
        judgement, of_sets, residuals = _judged(measured)
        reference = _reference(measured)
    sha256 = "" if known.file is None else known.file.sha256
    return {
        **head_object(judgement, unit, datetime.now(UTC), is_simulated),
        "of": "places on the targets by a plate" if is_of_plates else "beams",
        "calibration": {
            "path": str(calibration),
            "created": utc_text(known.created),
            "sha256": sha256,
            "limits": asdict(known.limits),
        },
        "reference": None if reference is None else asdict(reference),
        "sets": of_sets,
        "residuals": residuals,
        "comparison": None if before is None else comparison(before, judgement.agreement, sha256),
    }


def plan(settings: Sequence[Path], calibration_path: Path) -> dict[str, Any]:
    """Return the tests of a planned verification without measured values; a file of settings for each scan.

    The measurements are those that the calibration states at the planned positions. Raises BadInputError for
    files that cannot be read or do not belong together.
    """
    configs = [load_beam_settings(path) for path in settings]
    calibration = load_calibration(calibration_path, configs[0].unit.serial)
    sets = [_planned(calibration, config.scan) for config in configs]
    reasons = [
        f"{path}: {why}" for path, one in zip(settings, sets, strict=True) if (why := why_too_few(one))
    ]
    used = [one for one in sets if not why_too_few(one)]
    judgement = Judgement(Result.NOT_DECIDED, tuple(reasons), ())
    if used:
        reference = _largest([config.scan.limits.record for config in configs])
        judgement = judge(estimate(used), reference, calibration.limits, reasons)
    document = head_object(judgement, calibration.unit_serial, datetime.now(UTC), calibration.simulated)
    if judgement.verdict is Result.PASSED:
        document["verdict"] = "decides"
    document |= {"format": "altd-verification-plan/1", "comparison": None}
    for test in document["tests"]:
        test |= {"value": None, "result": "decides" if test["result"] == Result.PASSED else test["result"]}
    return document


def _planned(calibration: Calibration, scan: Scan) -> BeamSet:
    """Return the expected set of a scan by a unit without errors; unmeasurable positions are left out."""
    mounting = _mounting(scan, scan.limits)
    sign = -1 if mounting.turned else 1
    known_mm = np.array([(node.x_mm, node.y_mm) for node in nodes_of(scan)])
    slopes = np.tan(np.radians(mounting.deflection_deg))
    targets, instrument = calibration.targets, BeamInstrument(calibration, Measuring())
    px = np.stack([target.map.to_px(sign * (known_mm + target.z_mm * slopes)) for target in targets], axis=1)
    scatter_px = np.concatenate([target.repeatability_px for target in targets])
    covariance_px2 = np.diag(scatter_px**2 / scan.exposures)
    measurements, reached = list[Measurement](), list[int]()
    for number, spots_px in enumerate(px):
        mean = MeanSpots(
            calibration.target_names, spots_px, covariance_px2, 0, scan.exposures, 0, (None,) * len(targets)
        )
        if isinstance(solved := instrument.solve(mean), Solution):
            quantities = instrument.quantities
            measurements.append(Measurement(0, 0, None, 1, quantities, solved.values, solved.targets))
            reached.append(number)
    return beam_set(calibration, measurements, known_mm[reached], mounting)


def _mounting(of: RecordingHeader | Scan, limits: Limits | ScanLimits | None) -> Mounting:
    return Mounting(
        of.turned_deg > 0,
        0.0 if limits is None else limits.stage_mm or 0.0,
        of.seat_mm_per_m,
        (of.deflection_yaw_deg, of.deflection_pitch_deg),
        of.deflection_sigma_deg,
    )


def _check_independent(recordings: Sequence[Recording], calibration: Calibration) -> None:
    """Refuse a set that is given twice, or that made the calibration, also as a copy.

    It would count as twice the evidence, or test the map with its own errors. A turned unit's calibration
    stores one hash of both scans, so a single one of them is not noticed.
    """
    seen = dict[str, Path]()
    for recording in recordings:
        sha256, path = recording.sha256(), recording.path
        if sha256 in seen:
            raise BadInputError(path, f"is the same recording as {seen[sha256]}")
        seen[sha256] = path
    made_of = calibration.recording_sha256
    for hashes in (*((one,) for one in seen), *permutations(seen, 2)):
        if sha256_of_all(hashes) == made_of:
            raise BadInputError(seen[hashes[0]], "made the calibration; verify it with another recording")


def _measure(replay: Replay, progress: Callable[[int, int], None]) -> _Measured:
    positions, path = replay.positions, replay.recording.path
    if positions is None:
        raise BadInputError(path, "has no known positions (x_mm, y_mm) to verify the unit against")
    valid, known, invalid = list[Measurement](), list[tuple[float, float]](), Counter[str]()
    for measurement in replay.measurements(progress):
        if measurement.valid:
            valid.append(measurement)
            known.append(positions.known_mm(measurement.sequence))
        else:
            invalid[str(next(iter(measurement.status), "unknown"))] += 1
        if len(valid) > MAX_POSITIONS:
            raise BadInputError(path, f"has more than {MAX_POSITIONS} positions")
    header = replay.recording.header
    beams = beam_set(
        replay.calibration, valid, np.array(known).reshape(-1, 2), _mounting(header, header.limits)
    )
    return _Measured(replay, beams, len(valid) + invalid.total(), invalid)


def _judged(measured: Sequence[_Measured]) -> tuple[Judgement, list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the judgement, an object for each set, and the residuals of all."""
    reasons = list[str]()
    used = list[_Measured]()
    for one in measured:
        path, valid = one.replay.recording.path, len(one.beams)
        if why := why_too_few(one.beams):
            reasons.append(f"{path}: {why}")
            continue
        if why := why_not_aligned(one.beams):
            raise BadInputError(path, why)
        if valid < (1.0 - _MAX_INVALID_SHARE) * one.positions:
            reasons.append(
                f"{path}: only {valid} of {counted(one.positions, 'position')} gave a valid measurement"
            )
        used.append(one)
    objects = [_set_object(one) for one in measured]
    if not used:
        return Judgement(Result.NOT_DECIDED, tuple(reasons), ()), objects, []
    found = estimate([one.beams for one in used])
    judgement = judge(found, _reference(used), used[0].replay.calibration.limits, reasons)
    residuals = list[dict[str, Any]]()
    for one, of_set, left in zip(used, set_objects(found), found.residuals, strict=True):
        number = next(n for n, other in enumerate(measured) if other is one)
        objects[number] |= of_set
        residuals += [{"set": number + 1, **of} for of in residual_objects(one.beams, left)]
    return judgement, objects, residuals


def _plates(
    recordings: Sequence[Recording],
    calibration: Calibration,
    path: Path,
    progress: Callable[[int, int], None],
) -> tuple[Judgement, list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the judgement of plates, an object for each plate on a target, and the residuals of all."""
    of_targets: dict[str, list[tuple[TargetFrames, PlateSet]]] = {
        name: [] for name in calibration.target_names
    }
    for recording in recordings:
        if recording.header.kind != "plate":
            raise BadInputError(recording.path, "is no plate: verify plates and beams one after the other")
        load_calibration(path, recording.header.unit.serial)
        check_recording(calibration, path, recording.header)
        for seen in target_frames([recording]):
            target, others = target_of(calibration, path, seen.name), of_targets[seen.name]
            for other, _ in others:
                _check_same_plate(other, seen)
            others.append((seen, _plate_set(seen, target, progress)))
            if sum(len(one.known_mm) for _, one in others) > MAX_POSITIONS:
                raise BadInputError(seen.place, f"has more than {MAX_POSITIONS} discs")
    tests, reasons = list[LimitTest](), list[str]()
    objects, residuals = list[dict[str, Any]](), list[dict[str, Any]]()
    for name, shown in of_targets.items():
        if not shown:
            reasons.append(f"target {name!r} is not shown")
            continue
        if not any(one.is_between for _, one in shown):
            reasons.append(f"target {name!r}: move the discs by a part of the pitch, stated as --shift")
        of_target, left = tests_of_plates(name, [one for _, one in shown], calibration.limits)
        tests += of_target
        for (seen, one), errors in zip(shown, left, strict=True):
            objects.append(_recording_object(seen.parts[0].recording) | plate_object(name, one, errors))
            residuals += plate_residual_objects(len(objects), one, errors)
    return judge_agreement(tests, reasons), objects, residuals


def _plate_set(
    seen: TargetFrames, target: TargetCalibration, progress: Callable[[int, int], None]
) -> PlateSet:
    known_mm, spots_px = spots_of_plate(seen, target.map, progress)
    try:
        return plate_set(target, seen.plate, known_mm, spots_px)
    except ValueError as error:
        raise BadInputError(seen.place, f"{seen.name}: {error}") from error


def _check_same_plate(first: TargetFrames, other: TargetFrames) -> None:
    """Raise BadInputError unless two recordings of a target show one plate at two places."""
    if first.plate.origin_mm == other.plate.origin_mm:
        raise BadInputError(other.place, f"shows {other.name!r} with the shift of {first.place}")
    if first.plate.model_copy(update={"origin_mm": other.plate.origin_mm}) != other.plate:
        raise BadInputError(other.place, f"states another plate on {other.name!r} than {first.place}")


def _is_simulated(recording: Recording) -> bool:
    return any(camera.origin is Origin.SIMULATED for camera in recording.header.cameras.values())


def _set_object(one: _Measured) -> dict[str, Any]:
    header = one.replay.recording.header
    return {
        **_recording_object(one.replay.recording),
        "turned_deg": header.turned_deg,
        "seat_mm_per_m": header.seat_mm_per_m,
        "deflection_deg": one.beams.mounting.deflection_deg,
        "deflection_sigma_deg": header.deflection_sigma_deg,
        "positions": one.positions,
        "valid": len(one.beams),
        "invalid": dict(one.invalid),
    }


def _recording_object(recording: Recording) -> dict[str, Any]:
    start = recording.header.start
    return {
        "recording": str(recording.path),
        "sha256": recording.sha256(),
        "note": recording.header.note,
        "start": None if start is None else utc_text(start),
    }


def _reference(measured: Sequence[_Measured]) -> Limits | None:
    return _largest([one.replay.recording.header.limits for one in measured])


def _largest(stated: Sequence[Limits | None]) -> Limits | None:
    """Largest limits of all sets; a limit that one set does not state is not stated."""
    known = [limits for limits in stated if limits is not None]
    if not known or len(known) < len(stated):
        return None
    largest = dict[str, float | None]()
    for key in LIMIT_KEYS:
        values = [getattr(limits, key) for limits in known]
        largest[key] = None if None in values else max(values)
    return Limits(**largest)
