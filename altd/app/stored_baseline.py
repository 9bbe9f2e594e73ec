"""``altd baseline``: stores a baseline from a recording, or lets the daemon's next rounds make a new one."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from altd.app.baseline import BaselineFile, baseline_path
from altd.app.row_replay import open_row_replay
from altd.app.settings import service_folder
from altd.calibration.file import load_calibration
from altd.config import Config, RowSettings
from altd.devices.playback import RecordingCameraSettings
from altd.errors import BadInputError
from altd.recording.reader import open_recording
from altd.records import counted


def store_baseline(
    config: Config,
    place: Path,
    recording_path: Path | None,
    replace: bool,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[str]:
    """Store the baseline from a recording's first rounds; return a report of what was done, in lines.

    Without a recording and with live cameras, the daemon makes it: only the stored baseline is renamed.
    Raises BadInputError, also for an existing baseline, unless ``replace``.
    """
    if config.unit.instrument != "chain":
        raise BadInputError(place, f'unit.instrument: "{config.unit.instrument}" has no baseline')
    settings = config.chain or RowSettings()
    calibration = load_calibration(config.unit.calibration, config.unit.serial)
    path = baseline_path(config, service_folder(place))
    file = BaselineFile(path, calibration, settings)
    if os.path.lexists(path) and not replace:
        raise BadInputError(path, "exists already; --replace renames it")
    recording_path = recording_path or _played(config)
    means = None
    if recording_path is not None:
        recording = open_recording(recording_path)
        replay = open_row_replay(recording, config.unit.calibration, config, place, is_fresh=True)
        means = replay.baseline(progress)
        if means is None:
            wanted = counted(settings.baseline_rounds, "round")
            raise BadInputError(
                recording_path, f"has fewer than {wanted} in which all stable targets are seen"
            )
    lines = [f"renamed: {old}"] if (old := _renamed(path)) is not None else []
    if means is None or recording_path is None:
        rounds = counted(settings.baseline_rounds, "round")
        return [*lines, f"restart altd: its first {rounds} make the baseline, {path}"]
    file.save(means, recording.header.start or datetime.now(UTC), replay.is_simulated)
    left_out = [name for name in settings.stable if name not in means.own]
    without = f", without stable {', '.join(left_out)}: not measured" if left_out else ""
    return [*lines, f"{path}: baseline of {counted(len(means.own), 'target')} from {recording_path}{without}"]


def _played(config: Config) -> Path | None:
    """Return the recording played by the settings; None: the cameras are live."""
    played = {of.path for of in config.cameras.values() if isinstance(of, RecordingCameraSettings)}
    return min(played, default=None)


def _renamed(path: Path) -> Path | None:
    """Rename an existing file and return its new path; None: there is no file. Raises BadInputError."""
    if not os.path.lexists(path):
        return None
    old = path.with_name(f"{path.name}.{datetime.now(UTC):%Y%m%dT%H%M%SZ}")
    try:
        path.rename(old)
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be renamed") from error
    return old
