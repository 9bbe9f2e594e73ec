"""Settings of the data to keep: history of measurements and events, frames of the last seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from altd.files.table import Table


class HistorySettings(Table):
    """The history: measurements, summaries and events in a file."""

    enabled: bool = True
    """Keep the history; false: events are kept only until the next start."""
    file: Path | None = None
    """Path; default: `history.db` in the service's `StateDirectory`; without that there is no history."""
    max_mb: Annotated[int, Field(ge=64, le=100_000)] = 400
    """Maximum size, 10⁶ bytes; a year takes 265. Above it, the oldest summaries are deleted."""


class KeptFrames(Table):
    """Frames of the last seconds, written when a fault begins."""

    before_s: Annotated[float, Field(ge=0.5, le=600)] = 10.0
    """Time before a fault, s, as far as ``memory_mb`` allows."""
    after_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    """Time after a fault, s."""
    memory_mb: Annotated[int, Field(ge=0, le=16_384)] = 160
    """Memory for the frames of all cameras, 2²⁰ bytes; 0 keeps none. Twice as much is needed while a
    recording is written, within ``MemoryMax``."""
    on_fault: bool = True
    """Write a recording when the state becomes failure or out of specification."""
    again_after_s: Annotated[float, Field(ge=10, le=86_400)] = 600.0
    """Shortest time between recordings of the same cause, s."""
    disk_mb: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    """Maximum size of all recordings, 2²⁰ bytes; the oldest are deleted, marked ones are kept."""
    folder: Path | None = None
    """Folder of the recordings; default: `recordings` in the service's `StateDirectory`."""
