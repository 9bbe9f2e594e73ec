"""Replay of a recording through the same chain as the daemon's, with the recording's clock."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from altd.app.calibration_summary import why_unusable
from altd.calibration.file import check_recording, load_calibration
from altd.calibration.scan_nodes import node_key
from altd.config import Measuring
from altd.errors import BadInputError
from altd.instruments.beam.instrument import BeamInstrument
from altd.instruments.row.switched_window import SwitchedWindow
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import Provenance, RestPlace
from altd.recording.frames_table import FrameLine
from altd.recording.header import FRAMES_FILE
from altd.recording.reader import Recording, open_recording
from altd.records import Measurement, Origin, Quantities, counted, origin_faults
from altd.status.measurement_json import as_object, as_scan_object

MAX_WINDOW = 1000
"""Maximum window, in exposures; a node with more is measured from its last ones."""
_MAX_REMEMBERED = 4 * MAX_WINDOW
"""Maximum number of remembered exposures, to which a measurement may refer."""
_MAX_BEHIND = MAX_WINDOW
"""Maximum number of rows of one camera after the latest of another, which is then still remembered."""


@dataclass(frozen=True, slots=True)
class _Exposure:
    """Number of the stage's stay, counted from 0, the beam's position in it, and the exposure's first row."""

    stay: int
    position_mm: tuple[float, float]
    row: FrameLine


class _Stays:
    """Counts the stays of the stage at its nodes, row by row, and remembers the last exposures."""

    def __init__(self) -> None:
        self.exposures: dict[int, _Exposure] = {}
        self._last: _Exposure | None = None

    def see(self, row: FrameLine) -> _Exposure | None:
        """Take a row and return its exposure; None: not at a node, such as an LED reference pair."""
        if row.position_mm is None or row.leds_on:
            return None
        if (known := self.exposures.get(row.sequence)) is not None:
            return known
        last = self._last
        is_there = last is not None and node_key(row.position_mm) == node_key(last.position_mm)
        stay = 0 if last is None else last.stay + (not is_there)
        self._last = self.exposures[row.sequence] = _Exposure(stay, row.position_mm, row)
        if len(self.exposures) > _MAX_REMEMBERED:
            del self.exposures[next(iter(self.exposures))]
        return self._last


class ScanPositions:
    """Positions of the exposures of a scan, or of known beams, during their measurement.

    Nodes are distinguished as by ``altd calibrate``. ``cameras`` are the measured cameras. ``window`` is the
    number of averaged exposures; None: all of a stay at a node, with one measurement per stay. Raises
    BadInputError if two rows of one exposure contradict each other, if rows are far out of order, or if no
    row has a position.
    """

    def __init__(self, recording: Recording, cameras: Collection[str], window: int | None) -> None:
        self._window = window
        self._stays = _Stays()
        lengths = _lengths(recording, cameras)
        self._lengths = None if window is not None else lengths

    @property
    def is_by_node(self) -> bool:
        """Whether all exposures of a stay are averaged."""
        return self._window is None

    def see(self, row: FrameLine) -> bool:
        """Take a row; return whether it is to be measured."""
        return self._stays.see(row) is not None

    def place(self, sequence: int) -> RestPlace | None:
        """Return the place of an exposure whose row was read; None: it has none."""
        exposure = self._stays.exposures.get(sequence)
        if exposure is None:
            return None
        of_all = None if self._lengths is None else min(self._lengths[exposure.stay], MAX_WINDOW)
        return RestPlace(exposure.stay, of_all)

    def known_mm(self, sequence: int) -> tuple[float, float]:
        """Return the mean of the positions (x, y) within a window that ends at this exposure, mm."""
        exposures = self._stays.exposures
        reach = range(sequence, sequence - (self._window or MAX_WINDOW), -1)
        stay = exposures[sequence].stay
        reached = [exposures[n].position_mm for n in reach if n in exposures and exposures[n].stay == stay]
        count = len(reached)
        return sum(x_mm for x_mm, _ in reached) / count, sum(y_mm for _, y_mm in reached) / count

    def by_node(self, measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        """Yield the last measurement of each stay if whole stays are averaged; else all measurements."""
        if not self.is_by_node:
            yield from measurements
            return
        last: Measurement | None = None
        last_stay = 0
        for measurement in measurements:
            stay = self._stays.exposures[measurement.sequence].stay
            if last is not None and stay != last_stay:
                yield last
            last, last_stay = measurement, stay
        if last is not None:
            yield last


def _lengths(recording: Recording, cameras: Collection[str]) -> list[int]:
    """Return the number of exposures in each stay of the stage; raises BadInputError."""
    stays, lengths = _Stays(), list[int]()
    place = recording.path / FRAMES_FILE
    latest: FrameLine | None = None
    since_latest = 0
    for row in recording.rows:
        if row.camera not in cameras:
            continue
        if latest is None or row.sequence > latest.sequence:
            latest, since_latest = row, 0
        since_latest += 1
        if since_latest > _MAX_BEHIND:
            raise BadInputError(
                f"{place}: row {row.number}",
                f"is not in order of time: sequence {row.sequence} long after {latest.sequence}",
            )
        before = len(lengths)
        is_new = row.sequence not in stays.exposures
        exposure = stays.see(row)
        if exposure is None:
            continue
        if exposure.position_mm != row.position_mm:
            raise BadInputError(
                f"{place}: row {row.number}",
                f"x_mm, y_mm are not those of the same exposure in row {exposure.row.number}",
            )
        if exposure.stay == before:
            lengths.append(0)
        lengths[exposure.stay] += is_new
    if not lengths:
        raise BadInputError(place, "is of a scan, and no row has a position")
    return lengths


SILENT_AFTER_FRAME_SETS = 8

Progress = Callable[[int, int], None]
"""Callback after each row with the number of processed rows and the total."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording and the calibration that belongs to it.

    ``views`` are the calibration's targets, each with the camera in the recording that views it.
    ``measuring`` has the effective ``window`` and ``every``. ``positions`` are the beam's positions by the
    stage, for a scan and for a measurement whose rows have positions; without a window they give one
    measurement per node, from all its exposures.
    """

    recording: Recording
    calibration: Calibration
    views: tuple[View, ...]
    measuring: Measuring
    positions: ScanPositions | None

    @property
    def quantities(self) -> Quantities:
        """The quantities of the measurements."""
        return self._instrument.quantities

    @property
    def is_simulated(self) -> bool:
        """Whether the calibration or any measured camera is simulated."""
        cameras = self.recording.header.cameras
        of_frames = (cameras[view.camera].origin for view in self.views)
        return self.calibration.simulated or Origin.SIMULATED in of_frames

    @property
    def knows_places(self) -> bool:
        """Whether positions are known in the unit's frame; those of a turned unit are not."""
        return self.positions is not None and self.recording.header.turned_deg == 0.0

    @property
    def window_text(self) -> str:
        """Averaging window as text."""
        if self.positions is not None and self.positions.is_by_node:
            return "all exposures of a node"
        window, every = self.measuring.window, self.measuring.every
        if every == 1:
            return f"sliding means of {counted(window, 'exposure')}"
        return f"means of {counted(window, 'exposure')}, every {every}"

    def measurements(self, progress: Progress = lambda done, total: None) -> Iterator[Measurement]:
        """Yield one measurement after the other; a frame that cannot be decoded raises BadInputError."""
        if self.positions is None:
            return self._measured(progress)
        return self.positions.by_node(self._measured(progress))

    def as_object(self, measurement: Measurement) -> Mapping[str, Any]:
        """Return a measurement as plain JSON types, with the known position of the beam if there is one."""
        if self.positions is None or not self.knows_places:
            return as_object(measurement)
        return as_scan_object(measurement, self.positions.known_mm(measurement.sequence))

    @property
    def _instrument(self) -> BeamInstrument:
        return BeamInstrument(self.calibration, self.measuring)

    def _measured(self, progress: Progress) -> Iterator[Measurement]:
        header, positions = self.recording.header, self.positions
        cameras = {view.camera for view in self.views}  # a recording may have further cameras
        origins = {view.target: header.cameras[view.camera].origin for view in self.views}
        names, measuring = tuple(view.target for view in self.views), self.measuring
        chain = MeasuringChain(
            self.views,
            self.calibration,
            measuring,
            self._instrument,
            Provenance(
                origins=lambda: origin_faults(origins),
                utc=lambda t_ns: utc_of(header.start, t_ns),
                place=positions.place if positions is not None else lambda sequence: None,
            ),
            SwitchedWindow(names, measuring.window, measuring.every) if header.is_switched else None,
        )
        total = len(self.recording.rows)
        for done, row in enumerate(self.recording.rows, start=1):
            if row.camera in cameras and (positions is None or positions.see(row)):
                yield from chain.push(self.recording.frame(row))
            progress(done, total)
        yield from chain.flush()


def open_replay(recording_path: Path, calibration_path: Path) -> Replay:
    """Open recording and calibration and check all that does not need a decoded frame.

    Raises BadInputError if recording or calibration cannot be read or they do not belong together.
    """
    return replay_of(open_recording(recording_path), calibration_path)


def replay_of(
    recording: Recording, calibration_path: Path, window: int | None = None, every: int | None = None
) -> Replay:
    """Like ``open_replay``, for an open recording."""
    recording_path, header = recording.path, recording.header
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
    settings: dict[str, float] = {"silent_after_s": max(0.4, SILENT_AFTER_FRAME_SETS / header.fps)}
    positions = None
    if header.kind == "scan" or (header.kind == "measurement" and recording.rows.has_positions):
        averaged = window if every is None else window or Measuring().window
        positions = ScanPositions(recording, {view.camera for view in views}, averaged)
    measuring = Measuring(window=window or Measuring().window, every=every or 1).model_copy(update=settings)
    return Replay(recording, calibration, views, measuring, positions)


def utc_of(start: datetime | None, t_ns: int) -> datetime | None:
    """Return the UTC of an instant in a recording that starts at ``start``; None: not known."""
    return None if start is None else start + timedelta(microseconds=t_ns / 1000)
