"""The frames of the last seconds: who keeps them, put together from a config."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.kept_frames.keeper import FrameKeeper, Source
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.kept_frames.store import RecordingStore
from altd.config import Config
from altd.ports import Camera
from altd.recording.header import target_headers, unit_header
from altd.status.health import Health
from altd.status.recording_desk import KeptRecording
from altd.status.state import UnitState

RECORDINGS = "recordings"
"""In the service's own folder."""

_MARGIN_NS = 10**9
"""A recording is begun a little after its last frame."""


def folder_of_recordings(config: Config, state_folder: Path | None) -> Path | None:
    """Where recordings are written; None: nowhere."""
    if config.kept_frames.folder is not None or state_folder is None:
        return config.kept_frames.folder
    return state_folder / RECORDINGS


def frame_keeper(
    config: Config,
    cameras: Mapping[str, Camera],
    folder: Path,
    state: UnitState,
    health: Health,
    note: Callable[[str, KeptRecording | None], None],
) -> FrameKeeper:
    """Keeps and writes what a config asks for; the desk of ``health`` is open from now on."""
    settings = config.kept_frames
    length_ns = round((settings.before_s + settings.after_s) * 1e9) + _MARGIN_NS
    ring = FrameRing(settings.memory_mb << 20, length_ns, lambda camera: cameras[camera].identity)
    unit, targets = unit_header(config.unit.serial, config.targets), target_headers(config.targets)
    plan = RecordingPlan(settings.before_s, unit, targets, by="altd run, frames kept")
    keeper = FrameKeeper(
        Source(ring, cameras, config.measuring, plan),
        settings,
        RecordingStore(folder, settings.disk_mb << 20),
        state.read,
        health.component("kept frames"),
        note,
    )
    health.recordings.open(keeper)
    return keeper
