"""The frames of the last seconds: who keeps them, put together from a config."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.kept_frames.keeper import FrameKeeper, Source
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.kept_frames.store import RecordingStore
from altd.config import Config
from altd.ports import Camera
from altd.recording.header import target_headers, unit_header
from altd.status.health import Health
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


def frame_ring(config: Config, cameras: Mapping[str, Camera]) -> FrameRing:
    """The ring, as large as the config says."""
    settings = config.kept_frames
    length_ns = round((settings.before_s + settings.after_s) * 1e9) + _MARGIN_NS
    return FrameRing(settings.memory_mb << 20, length_ns, lambda camera: cameras[camera].identity)


def frame_keeper(
    config: Config,
    cameras: Mapping[str, Camera],
    ring: FrameRing,
    folder: Path,
    state: UnitState,
    health: Health,
) -> FrameKeeper:
    """Who writes what the ring holds; the desk of ``health`` is open from now on."""
    unit, targets = unit_header(config.unit.serial, config.targets), target_headers(config.targets)
    plan = RecordingPlan(config.kept_frames.before_s, unit, targets, by="altd run, frames kept")
    keeper = FrameKeeper(
        Source(ring, cameras, config.measuring, plan),
        config.kept_frames,
        RecordingStore(folder, config.kept_frames.disk_mb << 20),
        state.read,
        health.component("kept frames"),
    )
    health.recordings.open(keeper)
    return keeper
