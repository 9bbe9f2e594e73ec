"""Replay of a recording of a row of switched targets, through the instrument ``chain``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from altd.app.baseline import baseline_file
from altd.app.replay import Progress, utc_of
from altd.calibration.file import check_place, check_recording, load_calibration, target_of
from altd.config import Config, Measuring, RowSettings
from altd.errors import BadInputError
from altd.instruments.row.displacement import BaselineMeans
from altd.instruments.row.frames import RowChain
from altd.instruments.row.measurement import quantities_of
from altd.measuring.calibration import Calibration
from altd.measuring.chain import View
from altd.measuring.frame_chain import Provenance
from altd.recording.frames_table import FrameLine
from altd.recording.reader import Recording
from altd.records import Measurement, Origin, Quantities, origin_faults
from altd.status.measurement_json import as_object

_MAX_PAUSE_S = 1e9
"""Maximum time between two frames of a round: a recording may leave out what is not measured."""


@dataclass(frozen=True, slots=True)
class RowReplay:
    """A recording, the calibration of its targets, and the target of each camera; like ``app.replay.Replay``.

    ``means`` is a stored baseline; None: the first rounds determine it.
    """

    recording: Recording
    calibration: Calibration
    settings: RowSettings
    targets: Mapping[str, str]
    means: BaselineMeans | None = None
    positions = None
    knows_places = False
    window_text = "rounds of all targets"

    @property
    def quantities(self) -> Quantities:
        """The quantities of the measurements."""
        return quantities_of(self.calibration.target_names)

    @property
    def is_simulated(self) -> bool:
        """Whether the calibration or any measured camera is simulated."""
        cameras = self.recording.header.cameras
        return self.calibration.simulated or any(
            cameras[name].origin is Origin.SIMULATED for name in self.targets
        )

    def measurements(self, progress: Progress = lambda done, total: None) -> Iterator[Measurement]:
        """Yield one measurement per round; skip frames without an opaque target or with lit LEDs.

        Raises BadInputError for a frame that cannot be decoded and if rows of one exposure contradict each
        other.
        """
        yield from self._measured(self._chain(), progress)

    def baseline(self, progress: Progress = lambda done, total: None) -> BaselineMeans | None:
        """Return the baseline from the first rounds; None: there are too few rounds."""
        chain = self._chain()
        for _ in self._measured(chain, progress):
            if chain.baseline is not None:
                break
        return chain.baseline

    def as_object(self, measurement: Measurement) -> Mapping[str, Any]:
        """Return a measurement as plain JSON types."""
        return as_object(measurement)

    def _chain(self) -> RowChain:
        header = self.recording.header
        origins = {target: header.cameras[camera].origin for camera, target in self.targets.items()}
        provenance = Provenance(
            origins=lambda: origin_faults(origins),
            identity=lambda camera: header.cameras[camera].identity,
            utc=lambda t_ns: utc_of(header.start, t_ns),
        )
        views = [View(target, camera) for camera, target in self.targets.items()]
        measuring = Measuring().model_copy(update={"silent_after_s": _MAX_PAUSE_S})
        return RowChain(views, self.calibration, self.settings, measuring, provenance, self.means)

    def _measured(self, chain: RowChain, progress: Progress) -> Iterator[Measurement]:
        total, last = len(self.recording.rows), None
        for done, row in enumerate(self.recording.rows, start=1):
            if row.opaque and not row.leds_on and row.camera in self.targets:
                _check_exposure(self.recording, row, last)
                last = row
                yield from chain.push(self.recording.frame(row))
            progress(done, total)
        yield from chain.flush()


def _check_exposure(recording: Recording, row: FrameLine, last: FrameLine | None) -> None:
    """Raise BadInputError if an exposure has two opaque targets, or exposures are out of order of time."""
    if last is None:
        return
    if row.sequence == last.sequence and row.opaque != last.opaque:
        message = f"opaque {row.opaque!r} is not that of the same exposure in row {last.number}"
        raise BadInputError(recording.rows.place(row), f"{message}, {last.opaque!r}")
    if row.sequence < last.sequence:
        message = f"is not in order of time: sequence {row.sequence} after {last.sequence}"
        raise BadInputError(recording.rows.place(row), message)


def open_row_replay(
    recording: Recording,
    calibration_path: Path,
    config: Config | None,
    config_path: Path | None,
    is_fresh: bool = False,
) -> RowReplay:
    """Open a replay, checking all that does not need a decoded frame; raises BadInputError.

    Without a config no target is stable. The baseline file named in the config is used if it exists, unless
    ``is_fresh``.
    """
    header = recording.header
    calibration = load_calibration(calibration_path, header.unit.serial)
    check_recording(calibration, calibration_path, header)
    cameras = {target.name: target.camera for target in header.shown_targets}
    missing = [name for name in calibration.target_names if name not in cameras]
    if missing:
        raise BadInputError(recording.path, f"has no camera that looks at target {missing[0]!r}")
    if not recording.rows.has_opaque:
        raise BadInputError(
            recording.path, "no row names an opaque target: it is not a recording of glass targets"
        )
    settings, means = RowSettings(), None
    if config is not None and config_path is not None:
        if config.unit.serial != header.unit.serial:
            said = f"unit.serial: {config.unit.serial!r} is not that of the recording, {header.unit.serial!r}"
            raise BadInputError(config_path, said)
        for target in config.targets:
            target_of(calibration, calibration_path, target.name)
            check_place(calibration, calibration_path, target.name, target.z_mm, target.glass)
        named = {target.name for target in config.targets}
        if unnamed := [name for name in calibration.target_names if name not in named]:
            raise BadInputError(config_path, f"targets: the calibration's target {unnamed[0]!r} is missing")
        settings = config.chain or settings
        if not is_fresh and (file := baseline_file(config, calibration)) is not None:
            means = file.load()
    targets = {cameras[name]: name for name in calibration.target_names}
    return RowReplay(recording, calibration, settings, targets, means)
