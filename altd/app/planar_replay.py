"""Replay of a recording of kind ``planar``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from altd.app.replay import SILENT_AFTER_FRAME_SETS, utc_of
from altd.calibration.planar_file import check_planar_recording, load_planar_calibration
from altd.config import Measuring
from altd.instruments.planar.chain import PlanarChain
from altd.instruments.planar.instrument import QUANTITIES, PlanarCalibration
from altd.measuring.frame_chain import Provenance, RestPlace
from altd.recording.reader import Recording
from altd.records import Measurement, Origin, counted, origin_faults
from altd.status.measurement_json import as_object


@dataclass(frozen=True, slots=True)
class PlanarReplay:
    """A recording and its calibration; like ``app.replay.Replay``."""

    recording: Recording
    calibration: PlanarCalibration
    window: int
    every: int
    quantities = QUANTITIES
    positions = None
    knows_places = False

    @property
    def is_simulated(self) -> bool:
        """Whether the calibration or any camera of the recording is simulated."""
        cameras = self.recording.header.cameras.values()
        return self.calibration.simulated or any(camera.origin is Origin.SIMULATED for camera in cameras)

    @property
    def window_text(self) -> str:
        """Averaging window as text."""
        return f"means of up to {counted(self.window, 'exposure')} of one pose, every {self.every}"

    def measurements(
        self, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> Iterator[Measurement]:
        """Yield one measurement after the other; a frame that cannot be decoded raises BadInputError."""
        header, stay = self.recording.header, 0
        (camera,) = header.cameras
        measuring = Measuring(window=self.window, every=self.every)
        silent_after_s = max(measuring.silent_after_s, SILENT_AFTER_FRAME_SETS / header.fps)
        chain = PlanarChain(
            camera,
            self.calibration,
            measuring.model_copy(update={"silent_after_s": silent_after_s}),
            Provenance(
                origins=lambda: origin_faults({camera: header.cameras[camera].origin}),
                identity=lambda name: header.cameras[name].identity,
                utc=lambda t_ns: utc_of(header.start, t_ns),
                place=lambda sequence: RestPlace(stay),
            ),
        )
        total, stated = len(self.recording.rows), None
        for done, row in enumerate(self.recording.rows, start=1):
            here = row.pose, row.joints_mm
            stay, stated = stay + (here != stated), here
            yield from chain.push(self.recording.frame(row))
            progress(done, total)

    def as_object(self, measurement: Measurement) -> Mapping[str, Any]:
        """Return a measurement as plain JSON types."""
        return as_object(measurement)


def planar_replay_of(
    recording: Recording, calibration_path: Path, window: int | None, every: int | None
) -> PlanarReplay:
    """Return the replay of a recording; raises BadInputError if the calibration does not belong to it."""
    calibration = load_planar_calibration(calibration_path, recording.header.unit.serial)
    check_planar_recording(calibration, calibration_path, recording.header)
    return PlanarReplay(recording, calibration, window or Measuring().window, every or 1)
