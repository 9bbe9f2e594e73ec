"""A recording of a row of switched targets, through the instrument ``chain``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from altd.app.replay import Progress, utc_of
from altd.calibration.file import check_place, check_recording, load_calibration, target_of
from altd.config import ChainSettings, Config
from altd.errors import BadInputError
from altd.instruments.chain.document import as_object
from altd.instruments.chain.instrument import Chain
from altd.instruments.chain.rounds import Sight
from altd.measuring.calibration import Calibration
from altd.measuring.chain import calibration_faults
from altd.measuring.spot_locator import SpotLocator
from altd.recording.frames_table import Row
from altd.recording.reader import Recording
from altd.records import Origin, origin_faults


@dataclass(frozen=True, slots=True)
class ChainReplay:
    """A recording, the calibration of its targets, and the target of each camera."""

    recording: Recording
    calibration: Calibration
    settings: ChainSettings
    targets: Mapping[str, str]

    def objects(self, progress: Progress = lambda done, total: None) -> Iterator[dict[str, Any]]:
        """A JSON object a round. Frames without an opaque target, or with lit LEDs, are not measured.

        Raises BadInputError for a frame that cannot be decoded and where rows of one exposure contradict
        each other.
        """
        header = self.recording.header
        chain = Chain(self.calibration, self.settings)
        locators = {camera: self._locator(camera, target) for camera, target in self.targets.items()}
        origins = {target: header.cameras[camera].origin for camera, target in self.targets.items()}
        faults = {fault.reason: fault for fault in calibration_faults(self.calibration.simulated)}
        faults |= {fault.reason: fault for fault in origin_faults(origins)}
        write = partial(self._object, tuple(faults.values()))
        total, last = len(self.recording.rows), None
        for done, row in enumerate(self.recording.rows, start=1):
            if row.opaque and not row.leds_on and row.camera in self.targets:
                _check_exposure(self.recording, row, last)
                last = row
                located = locators[row.camera].locate(self.recording.frame(row))
                sight = Sight(
                    self.targets[row.camera],
                    row.opaque,
                    row.sequence,
                    located.t_ns,
                    located.spot,
                    located.breaks,
                )
                if (result := chain.add(sight)) is not None:
                    yield write(result)
            progress(done, total)
        yield from map(write, chain.flush())

    @property
    def is_simulated(self) -> bool:
        """Whether any frame that the rounds rest on was simulated."""
        cameras = self.recording.header.cameras
        return self.calibration.simulated or any(
            cameras[name].origin is Origin.SIMULATED for name in self.targets
        )

    def _locator(self, camera: str, target: str) -> SpotLocator:
        identity = self.recording.header.cameras[camera].identity
        return SpotLocator(
            camera,
            target_of(self.calibration, self.recording.path, target),
            lambda: identity,
            other_place_of=self.calibration.other_place_of,
        )

    def _object(self, faults: Any, result: Any) -> dict[str, Any]:
        return as_object(result, utc_of(self.recording.header.start, result.t_ns), faults)


def _check_exposure(recording: Recording, row: Row, last: Row | None) -> None:
    """One exposure has one opaque target, and exposures come in the order of time."""
    if last is None:
        return
    if row.sequence == last.sequence and row.opaque != last.opaque:
        message = f"opaque {row.opaque!r} is not that of the same exposure in row {last.number}"
        raise BadInputError(recording.rows.place(row), f"{message}, {last.opaque!r}")
    if row.sequence < last.sequence:
        message = f"is out of the order of time: sequence {row.sequence} after {last.sequence}"
        raise BadInputError(recording.rows.place(row), message)


def open_chain_replay(
    recording: Recording, calibration_path: Path, config: Config | None, config_path: Path | None
) -> ChainReplay:
    """Check all that can be checked before a frame is decoded; raises BadInputError.

    Without a config no target is stable.
    """
    header = recording.header
    calibration = load_calibration(calibration_path, header.unit.serial)
    check_recording(calibration, calibration_path, header)
    cameras = {target.name: target.camera for target in header.shown_targets}
    missing = [name for name in calibration.target_names if name not in cameras]
    if missing:
        raise BadInputError(recording.path, f"has no camera that looks at target {missing[0]!r}")
    if not recording.rows.has_opaque:
        raise BadInputError(recording.path, "no row names an opaque target: it shows no row of glass targets")
    settings = ChainSettings()
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
    targets = {cameras[name]: name for name in calibration.target_names}
    return ChainReplay(recording, calibration, settings, targets)
