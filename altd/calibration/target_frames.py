"""The frames of each target of a calibration, from one recording or several, and which of them are lit.

See docs/recordings.md.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from altd.calibration.result import Progress
from altd.errors import BadInputError
from altd.recording.frames_table import FrameLine
from altd.recording.header import HEADER_FILE, PlateHeader, TargetHeader
from altd.recording.reader import Recording
from altd.records import CameraIdentity, Frame, Glass, Origin

CalibrationKind = Literal["scan", "plate"]

_Z_TOLERANCE_MM = 1e-3


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One frame of a target, not yet read: its row, its recording, and the recording's number from 0."""

    recording: Recording
    number: int
    row: FrameLine

    def frame(self) -> Frame:
        """Decode the frame; raises BadInputError with the file and the row."""
        return self.recording.frame(self.row)


@dataclass(frozen=True, slots=True)
class RecordedTarget:
    """The frames of a target in one recording; ``number`` counts the recordings from 0."""

    recording: Recording
    number: int
    target: TargetHeader

    @property
    def header_file(self) -> Path:
        """File with the recording's header, for error messages."""
        return self.recording.path / HEADER_FILE

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of its pictures, px."""
        camera = self.recording.header.cameras[self.target.camera]
        return camera.width, camera.height

    @property
    def identity(self) -> CameraIdentity:
        """Identity of the target's camera, as far as it is recorded."""
        return self.recording.header.cameras[self.target.camera].identity

    @property
    def kind(self) -> CalibrationKind:
        """Kind of the recording."""
        return "plate" if self.recording.header.kind == "plate" else "scan"


@dataclass(frozen=True, slots=True)
class TargetFrames:
    """The frames of one target by one camera, from recordings of one kind: scans, or one plate."""

    parts: tuple[RecordedTarget, ...]

    @property
    def name(self) -> str:
        """Name of the target."""
        return self.parts[0].target.name

    @property
    def z_mm(self) -> float:
        """Place of the target on the beam, mm."""
        return self.parts[0].target.z_mm

    @property
    def glass(self) -> Glass | None:
        """Glass behind the target, from the first recording that states it."""
        return next((part.target.glass for part in self.parts if part.target.glass), None)

    @property
    def kind(self) -> CalibrationKind:
        """Kind of the recordings."""
        return self.parts[0].kind

    def of_turned_unit(self, is_turned: bool) -> TargetFrames | None:
        """Select the recordings of the turned unit, or of the unturned one; None if there are none."""
        parts = tuple(p for p in self.parts if (p.recording.header.turned_deg != 0.0) is is_turned)
        return replace(self, parts=parts) if parts else None

    @property
    def unit_serial(self) -> str:
        """Serial number of the target's unit."""
        return self.parts[0].recording.header.unit.serial

    @property
    def place(self) -> str:
        """Paths of the recordings, for error messages."""
        return ", ".join(str(part.recording.path) for part in self.parts)

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of its pictures, px."""
        return self.parts[0].image_size

    @property
    def camera(self) -> CameraIdentity:
        """Identity of the target's camera, from the first recording that states any of it."""
        nobody = CameraIdentity()
        return next((part.identity for part in self.parts if part.identity != nobody), nobody)

    @property
    def origin(self) -> Origin:
        """Origin of the frames: simulated if those of any recording are."""
        of_parts = {part.recording.header.cameras[part.target.camera].origin for part in self.parts}
        return Origin.SIMULATED if Origin.SIMULATED in of_parts else Origin.CAMERA

    @property
    def plate(self) -> PlateHeader:
        """The plate at the target's place; raises BadInputError if the recording does not describe it."""
        part = self.parts[0]
        plate = part.recording.header.plate
        if not isinstance(plate, PlateHeader):
            raise BadInputError(part.header_file, "plate: Field required in a recording of a plate")
        return plate

    @property
    def is_mirrored(self) -> bool:
        """Whether the camera's picture of the target is mirrored."""
        part = self.parts[0]
        return part.recording.header.is_mirrored(part.target)

    def file_of(self, frame: FrameRow) -> str:
        """File of a frame for messages: its name in the recording, with the folder if there are several."""
        return frame.row.file if len(self.parts) == 1 else str(frame.recording.path / frame.row.file)

    def __len__(self) -> int:
        return sum(part.recording.rows.count.get(part.target.camera, 0) for part in self.parts)

    def __iter__(self) -> Iterator[FrameRow]:
        """Yield the frames in the order of time, one recording after another."""
        for part in self.parts:
            for row in part.recording.rows.of(part.target.camera):
                yield FrameRow(part.recording, part.number, row)


def target_frames(recordings: Sequence[Recording]) -> tuple[TargetFrames, ...]:
    """Collect the frames of each target in the recordings, in beam order.

    Raises BadInputError with the recording that is neither scan nor plate, is incompatible with another one,
    or is given twice.
    """
    _check_unit(recordings)
    targets: dict[str, TargetFrames] = {}
    for number, recording in enumerate(recordings):
        for target in recording.header.shown_targets:
            part = RecordedTarget(recording, number, target)
            known = targets.get(target.name)
            if known is None:
                targets[target.name] = TargetFrames((part,))
            else:
                _check_same_target(known, part)
                targets[target.name] = replace(known, parts=(*known.parts, part))
    in_order = tuple(sorted(targets.values(), key=lambda frames: frames.z_mm))
    for nearer, farther in itertools.pairwise(in_order):
        if farther.z_mm - nearer.z_mm <= _Z_TOLERANCE_MM:
            raise BadInputError(
                farther.parts[0].header_file,
                f"target {farther.name!r} is at z {farther.z_mm:g} mm, where target {nearer.name!r} of "
                f"{nearer.parts[0].recording.path} is",
            )
    return in_order


def _check_unit(recordings: Sequence[Recording]) -> None:
    """Check that each is a scan or a plate, shows a target, is of the first one's unit, and is given once."""
    first = recordings[0]
    for number, recording in enumerate(recordings):
        path, header = recording.path, recording.header
        if header.kind not in ("scan", "plate"):
            raise BadInputError(
                path, f"is of kind {header.kind!r}; a calibration needs a 'scan' or a 'plate'"
            )
        if not header.shown_targets:
            raise BadInputError(
                path / HEADER_FILE, "has neither `targets` nor a camera 'front' or 'rear': it shows no target"
            )
        if header.unit.serial != first.header.unit.serial:
            raise BadInputError(
                path / HEADER_FILE,
                f"is of unit {header.unit.serial!r}, {first.path} of unit {first.header.unit.serial!r}",
            )
        if any(path.resolve() == other.path.resolve() for other in recordings[:number]):
            raise BadInputError(path, "is given twice")


def _check_same_target(known: TargetFrames, part: RecordedTarget) -> None:
    """Raise BadInputError if another recording of a target contradicts the previous ones."""
    first, target = known.parts[0], part.target

    def refusal(why: str) -> BadInputError:
        return BadInputError(part.header_file, f"target {target.name!r} {why}")

    if part.kind != first.kind:
        raise refusal(f"is shown by a {part.kind} here and by a {first.kind} in {first.recording.path}")
    if part.kind == "plate":
        raise refusal(f"is shown by the plate in {first.recording.path} already")
    if abs(target.z_mm - known.z_mm) > _Z_TOLERANCE_MM:
        raise refusal(f"is at z {target.z_mm:g} mm, in {first.recording.path} at {known.z_mm:g} mm")
    for other in known.parts:
        if target.glass and other.target.glass and target.glass != other.target.glass:
            raise refusal(f"has {target.glass} behind it, in {other.recording.path} {other.target.glass}")
    if part.image_size != known.image_size:
        sizes = [f"{width} × {height}" for width, height in (part.image_size, known.image_size)]
        raise refusal(f"has pictures of {sizes[0]}, in {first.recording.path} of {sizes[1]}")
    for other in known.parts:
        if difference := part.identity.difference_from(other.identity):
            raise refusal(f"is seen by another camera than in {other.recording.path}: {difference}")


_MAX_STEADY_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class LitRows:
    """Flags of the lit and of the dark rows of a camera, in the order of the rows; some may be neither."""

    lit: tuple[bool, ...]
    dark: tuple[bool, ...]


def lit_rows(
    recording: Recording, camera: str, max_dark_ratio: float, progress: Progress = lambda done, total: None
) -> LitRows:
    """Determine the lit and the dark rows of a camera.

    ``leds`` decides if the rows differ in it. Otherwise the mean of each frame decides: frames within a tenth
    of the range of means from the brightest are lit, from the dimmest dark. All are lit if the dimmest has
    more than ``max_dark_ratio`` of the light of the brightest.
    """
    flags = array("b", (row.leds_on for row in recording.rows.of(camera)))
    if not flags or min(flags) < max(flags):
        return LitRows(tuple(map(bool, flags)), tuple(not flag for flag in flags))
    levels = array("d")
    for row in recording.rows.of(camera):
        levels.append(float(recording.frame(row).pixels.mean()))
        progress(len(levels), len(flags))
    dimmest, brightest = min(levels), max(levels)
    if dimmest > max_dark_ratio * brightest or dimmest == brightest:
        return LitRows((True,) * len(levels), (False,) * len(levels))
    margin = _MAX_STEADY_SHARE * (brightest - dimmest)
    return LitRows(
        tuple(level >= brightest - margin for level in levels),
        tuple(level <= dimmest + margin for level in levels),
    )
