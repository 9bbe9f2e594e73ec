"""A recording through the very chain that the daemon uses, with the recording's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from altd.app.scan_positions import ScanPositions
from altd.app.target_names import why_unusable
from altd.calibration.file import check_recording, load_calibration
from altd.config import Measuring
from altd.errors import BadInputError
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, Provenance, View
from altd.recording.reader import Recording, open_recording
from altd.records import Measurement, Origin, Quantities, counted, origin_faults
from altd.status.measurement_json import as_object, as_scan_object

_SILENT_AFTER_FRAME_SETS = 8

Progress = Callable[[int, int], None]
"""Told after each row how many of how many are done."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording and the calibration that it is measured with; they belong together.

    ``views`` are the calibration's targets, each with the recording's camera that looks at it. ``measuring``
    holds ``window`` and ``every`` as they are, ``positions`` where the stage put the beam, in a scan. Without
    a window a scan gives one measurement a node, of all its exposures.
    """

    recording: Recording
    calibration: Calibration
    views: tuple[View, ...]
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
        of_frames = (cameras[view.camera].origin for view in self.views)
        return self.calibration.simulated or Origin.SIMULATED in of_frames

    @property
    def window_text(self) -> str:
        """What is averaged."""
        if self.positions is not None and self.positions.is_by_node:
            return "all exposures of a node"
        window, every = self.measuring.window, self.measuring.every
        if every == 1:
            return f"sliding means of {counted(window, 'exposure')}"
        return f"means of {counted(window, 'exposure')}, every {every}"

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
        header, positions = self.recording.header, self.positions
        cameras = {view.camera for view in self.views}  # a recording may have more of them
        origins = {view.target: header.cameras[view.camera].origin for view in self.views}
        chain = MeasuringChain(
            self.views,
            self.calibration,
            self.measuring,
            self._instrument,
            Provenance(
                origins=lambda: origin_faults(origins),
                utc=lambda t_ns: _utc(header.start, t_ns),
                place=positions.place if positions is not None else lambda sequence: None,
            ),
        )
        total = len(self.recording.rows)
        for done, row in enumerate(self.recording.rows, start=1):
            if row.camera in cameras and (positions is None or positions.see(row)):
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
    if len(calibration.targets) < BeamInstrument.min_targets:
        only = calibration.target_names[0]
        raise BadInputError(
            calibration_path,
            f"is of target {only!r} alone; a beam needs at least {BeamInstrument.min_targets} targets",
        )
    for name in calibration.target_names:
        if why := why_unusable(name):
            raise BadInputError(calibration_path, f"target {name!r} {why}: calibrate with another name")
    check_recording(calibration, calibration_path, header)
    cameras = {target.name: target.camera for target in header.shown_targets}
    missing = [name for name in calibration.target_names if name not in cameras]
    if missing:
        raise BadInputError(recording_path, f"has no camera that looks at target {missing[0]!r}")
    views = tuple(View(name, cameras[name]) for name in calibration.target_names)
    settings: dict[str, float] = {"silent_after_s": max(0.4, _SILENT_AFTER_FRAME_SETS / header.fps)}
    positions = None
    if header.kind == "scan":
        averaged = window if every is None else window or Measuring().window
        positions = ScanPositions(recording, {view.camera for view in views}, averaged)
    measuring = Measuring(window=window or Measuring().window, every=every or 1).model_copy(update=settings)
    return Replay(recording, calibration, views, measuring, positions)


def _utc(start: datetime | None, t_ns: int) -> datetime | None:
    return None if start is None else start + timedelta(microseconds=t_ns / 1000)
