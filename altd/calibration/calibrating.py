"""Recordings become a calibration: each target from the scans, or the plate, that show it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime

from altd.calibration.from_plates import calibrate_plates
from altd.calibration.from_scans import calibrate_scans
from altd.calibration.recorded_flat import flats_of
from altd.calibration.result import CalibrationResult, Progress, cross_check_doubts
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from altd.recording.reader import Recording


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
    scanned = [frames for frames in targets if frames.kind == "scan"]
    if flat is not None and not scanned:
        raise BadInputError(flat.path, "is for a scan; a plate shows no laser spot")
    flats = {} if flat is None else flats_of(flat, scanned, progress)
    of_scans = calibrate_scans(scanned, flats, progress)
    of_plates = calibrate_plates([frames for frames in targets if frames.kind == "plate"], progress)
    both = of_scans, of_plates
    calibration = Calibration(
        unit_serial=recordings[0].header.unit.serial,
        created=datetime.now(UTC),
        recording_note=_note(recordings),
        recording_sha256=_sha256(recordings),
        targets=tuple(sorted((target for of in both for target in of.targets), key=lambda of: of.z_mm)),
    )
    evidence = {seen.name: seen for of in both for seen in of.evidence}
    return CalibrationResult(
        calibration,
        of_scans.refused + of_plates.refused,
        tuple(evidence[name] for name in calibration.target_names),
        (*cross_check_doubts(calibration.targets), *of_scans.doubts, *of_plates.doubts),
        of_scans.remarks + of_plates.remarks,
    )


def _note(recordings: Sequence[Recording]) -> str:
    """That of the recording; of several each different one once, in their order."""
    return "; ".join(dict.fromkeys(of.header.note for of in recordings if of.header.note))


def _sha256(recordings: Sequence[Recording]) -> str:
    """That of the recording; of several the hash over theirs, a line each, in their order."""
    hashes = [recording.sha256() for recording in recordings]
    if len(hashes) == 1:
        return hashes[0]
    return hashlib.sha256("".join(f"{of}\n" for of in hashes).encode()).hexdigest()
