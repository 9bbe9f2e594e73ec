"""What a report is made of, before anything is computed or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from altd.calibration.evidence import TargetEvidence
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.header import RecordingHeader
from altd.records import PixelArray


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """What is reported on: the calibration, its evidence, how it was made.

    ``negatives`` are the scan's pictures by target, see ``scan_negatives``; a target may lack one. ``header``
    is the recording's.
    """

    calibration: Calibration
    evidence: tuple[TargetEvidence, ...]
    negatives: Mapping[str, PixelArray]
    command: str
    header: RecordingHeader

    def targets(self) -> list[tuple[TargetCalibration, TargetEvidence]]:
        """Each target with its evidence."""
        known = {seen.name: seen for seen in self.evidence}
        return [(target, known[target.name]) for target in self.calibration.targets]
