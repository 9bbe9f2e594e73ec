"""A recording through the very chain that the daemon uses, with the recording's clock."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

from altd.calibration.file import check_camera, check_image_size, load_calibration
from altd.config import Installation, Measuring
from altd.errors import BadInputError
from altd.measurement_json import as_line
from altd.recording import open_recording
from altd.records import origin_faults
from altd.service.chain import MeasuringChain, View

_SILENT_AFTER_EXPOSURES = 8


def replay(recording_path: Path, calibration_path: Path, window: int, every: int) -> Iterator[str]:
    """Measurement lines of a recording; every check is made before the first line comes.

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
    silent_after_s = max(0.4, _SILENT_AFTER_EXPOSURES / header.fps)
    origins = {name: header.cameras[name].origin for name in calibration.target_names}
    chain = MeasuringChain(
        [View(name, name) for name in calibration.target_names],
        calibration,
        Measuring(window=window, every=every).model_copy(update={"silent_after_s": silent_after_s}),
        Installation(),
        lambda: origin_faults(origins),
        utc=lambda t_ns: _utc(header.start, t_ns),
    )

    def lines() -> Iterator[str]:
        for row in recording.rows:
            yield from map(as_line, chain.push(recording.frame(row)))
        yield from map(as_line, chain.flush())

    return lines()


def _utc(start: datetime | None, t_ns: int) -> datetime | None:
    return None if start is None else start + timedelta(microseconds=t_ns / 1000)
