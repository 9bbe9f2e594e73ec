"""Recordings become a calibration: each target from the scans, or the plate, that show it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from altd.calibration.from_plates import calibrate_plates
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.recorded_flat import flats_of
from altd.calibration.result import CalibrationResult, Progress, cross_check_doubts
from altd.calibration.target_frames import TargetFrames, target_frames
from altd.calibration.turned import beam_tilt, without_tilt
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from altd.recording.reader import Recording
from altd.records import Limits
from altd.records.limits import LIMIT_KEYS


def calibrate(
    recordings: Sequence[Recording],
    flat: Recording | None = None,
    progress: Progress = lambda done, total: None,
) -> CalibrationResult:
    """Fit the maps of every target that the recordings show; ``flat`` is one of kind ``flat``.

    Raises BadInputError when the recordings do not go together or one of them is no good, see
    ``target_frames``, ``calibrate_scans``, ``calibrate_plates`` and ``flats_of``.
    """
    targets = target_frames(recordings)
    scanned, turned = _by_turn([frames for frames in targets if frames.kind == "scan"])
    if flat is not None and not scanned:
        raise BadInputError(flat.path, "is for a scan; a plate shows no laser spot")
    flats = {} if flat is None else flats_of(flat, scanned, progress)
    of_scans = calibrate_scans(scanned, flats, progress)
    limits = _limits([recording for recording in recordings if recording.header.kind == "scan"])
    if turned:
        tilt = beam_tilt(of_scans.targets, turned, progress)
        of_scans = without_tilt(of_scans, tilt)
        limits = replace(limits, beam_normal_mm_per_m=1000 * tilt.sigma)
    of_plates = calibrate_plates([frames for frames in targets if frames.kind == "plate"], progress)
    both = of_scans, of_plates
    calibration = Calibration(
        unit_serial=recordings[0].header.unit.serial,
        created=datetime.now(UTC),
        recording_note=_note(recordings),
        recording_sha256=sha256_of_all([recording.sha256() for recording in recordings]),
        targets=tuple(sorted((target for of in both for target in of.targets), key=lambda of: of.z_mm)),
        limits=limits,
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
            *_zero_doubts(targets),
        ),
        of_scans.remarks + of_plates.remarks,
    )


def _by_turn(scanned: Sequence[TargetFrames]) -> tuple[list[TargetFrames], list[TargetFrames]]:
    """The scans of the unit as it is, which define its frame, and those of the turned unit."""
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


def _limits(scans: Sequence[Recording]) -> Limits:
    """The limits that the scans state; where two state the same one, the larger counts."""
    stated = [scan.header.limits for scan in scans if scan.header.limits is not None]
    of_all = {key: [sigma for of in stated if (sigma := getattr(of, key)) is not None] for key in LIMIT_KEYS}
    return Limits(**{key: max(sigmas) for key, sigmas in of_all.items() if sigmas})


def _zero_doubts(targets: Sequence[TargetFrames]) -> tuple[str, ...]:
    """Whether the targets' zeros are one: a beam's direction is the difference between their points."""
    first, *others = [{part.recording.path for part in frames.parts} for frames in targets]
    if not any(first.isdisjoint(other) for other in others):
        return ()
    return (
        "the targets are from different recordings: the zero of yaw and pitch is that of the stage or the "
        "plates, which must have been the same, and is not in sigma",
    )


def _note(recordings: Sequence[Recording]) -> str:
    """That of the recording; of several each different one once, in their order."""
    return "; ".join(dict.fromkeys(of.header.note for of in recordings if of.header.note))


def sha256_of_all(hashes: Sequence[str]) -> str:
    """That of one recording; of several the hash over theirs, a line each, in their order."""
    if len(hashes) == 1:
        return hashes[0]
    return hashlib.sha256("".join(f"{of}\n" for of in hashes).encode()).hexdigest()
