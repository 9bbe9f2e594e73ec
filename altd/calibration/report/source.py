"""What a report is made of, before anything is computed or drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from altd.calibration.evidence import TargetEvidence
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.header import RecordingHeader
from altd.records import PixelArray


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """What is reported on: the calibration, its evidence, how it was made.

    ``negatives`` are the scan's pictures by target, see ``scan_negatives``; a target may lack one.
    ``headers`` are those of the recordings, in the order in which they were given.
    """

    calibration: Calibration
    evidence: tuple[TargetEvidence, ...]
    negatives: Mapping[str, PixelArray]
    command: str
    headers: tuple[RecordingHeader, ...]

    def targets(self) -> list[tuple[TargetCalibration, TargetEvidence]]:
        """Each target with its evidence."""
        known = {seen.name: seen for seen in self.evidence}
        return [(target, known[target.name]) for target in self.calibration.targets]


def target_names_text(targets: Sequence[TargetCalibration]) -> str:
    """All the targets, in a sentence."""
    return {1: "the target", 2: "both targets"}.get(len(targets), "all targets")
