"""A recording through the very chain that the daemon uses, with the recording's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from altd.app.scan_positions import ScanPositions
from altd.calibration.file import check_camera, check_image_size, load_calibration
from altd.config import Measuring
from altd.errors import BadInputError
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.recording.reader import Recording, open_recording
from altd.records import Measurement, Origin, Quantities, origin_faults
from altd.status.measurement_json import as_object, as_scan_object

_SILENT_AFTER_EXPOSURES = 8

Progress = Callable[[int, int], None]
"""Told after each row how many of how many are done."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording and the calibration that it is measured with; they belong together.

    ``measuring`` holds ``window`` and ``every`` as they are, ``positions`` where the stage put the beam, in a
    scan. Without a window a scan gives one measurement a node, of all its exposures.
    """

    recording: Recording
    calibration: Calibration
    measuring: Measuring
    positions: ScanPositions | None

    @property
    def quantities(self) -> Quantities:
        """What the measurements hold."""
        return self._instrument.quantities

    @property
    def is_simulated(self) -> bool:
        """Whether any frame that the measurements rest on was simulated."""
        cameras = self.recording.header.cameras
        of_frames = (cameras[name].origin for name in self.calibration.target_names)
        return self.calibration.simulated or Origin.SIMULATED in of_frames

    @property
    def window_in_words(self) -> str:
        """What is averaged."""
        if self.positions is not None and self.positions.is_by_node:
            return "all exposures of a node"
        window, every = self.measuring.window, self.measuring.every
        if every == 1:
            return f"sliding means of {window} exposures"
        return f"means of {window} exposures, every {every}"

    def measurements(self, progress: Progress = lambda done, total: None) -> Iterator[Measurement]:
        """One measurement after the other; a frame that cannot be decoded raises BadInputError."""
        if self.positions is None:
            return self._measured(progress)
        return self.positions.by_node(self._measured(progress))

    def as_object(self, measurement: Measurement) -> Mapping[str, Any]:
        """A measurement as plain JSON types, that of a scan with what is known of it."""
        if self.positions is None:
            return as_object(measurement)
        return as_scan_object(measurement, self.positions.known_mm(measurement.sequence))

    @property
    def _instrument(self) -> BeamInstrument:
        return BeamInstrument(self.calibration, self.measuring)

    def _measured(self, progress: Progress) -> Iterator[Measurement]:
        header, targets = self.recording.header, self.calibration.target_names
        origins = {name: header.cameras[name].origin for name in targets}
        positions = self.positions
        chain = MeasuringChain(
            [View(name, name) for name in targets],
            self.calibration,
            self.measuring,
            self._instrument,
            lambda: origin_faults(origins),
            utc=lambda t_ns: _utc(header.start, t_ns),
            place=positions.place if positions is not None else lambda sequence: None,
        )
        total = len(self.recording.rows)
        for done, row in enumerate(self.recording.rows, start=1):
            if positions is None or positions.see(row):
                yield from chain.push(self.recording.frame(row))
            progress(done, total)
        yield from chain.flush()


def open_replay(
    recording_path: Path, calibration_path: Path, window: int | None = None, every: int | None = None
) -> Replay:
    """Open both and check all that can be checked before a frame is decoded.

    Raises BadInputError when recording and calibration cannot be read or do not belong together.
    """
    recording = open_recording(recording_path)
    header = recording.header
    calibration = load_calibration(calibration_path, header.unit.serial)
    for camera, size in header.cameras.items():
        check_image_size(calibration, calibration_path, camera, size.width, size.height)
        check_camera(calibration, calibration_path, camera, size.identity)
    missing = [name for name in calibration.target_names if name not in header.cameras]
    if missing:
        raise BadInputError(recording_path, f"has no camera {missing[0]!r}")
    settings: dict[str, float] = {"silent_after_s": max(0.4, _SILENT_AFTER_EXPOSURES / header.fps)}
    positions = None
    if header.kind == "scan":
        positions = ScanPositions(recording, window if every is None else window or Measuring().window)
    measuring = Measuring(window=window or Measuring().window, every=every or 1).model_copy(update=settings)
    return Replay(recording, calibration, measuring, positions)


def _utc(start: datetime | None, t_ns: int) -> datetime | None:
    return None if start is None else start + timedelta(microseconds=t_ns / 1000)
