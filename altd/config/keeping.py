"""Settings of the data to keep: history of measurements and events, frames of the last seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from altd.config.table import Table


class HistorySettings(Table):
    """The history: measurements, summaries and events in a file."""

    enabled: bool = True
    """Without it events are kept until the next start only."""
    file: Path | None = None
    """Default: `history.db` in the service's `StateDirectory`; without that there is no history."""
    max_mb: Annotated[int, Field(ge=64, le=100_000)] = 400
    """Largest size, 10⁶ bytes; a year takes 265. Then the oldest summaries are deleted."""


class KeptFrames(Table):
    """The frames of the last seconds, written when a fault begins."""

    before_s: Annotated[float, Field(ge=0.5, le=600)] = 10.0
    """Time before a fault, as far as ``memory_mb`` allows."""
    after_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    """Time after it."""
    memory_mb: Annotated[int, Field(ge=0, le=16_384)] = 160
    """Memory for the frames of all cameras, needed twice while a recording is written, within ``MemoryMax``;
    0 keeps none."""
    on_fault: bool = True
    """Write a recording when the state becomes failure or out of specification."""
    again_after_s: Annotated[float, Field(ge=10, le=86_400)] = 600.0
    """Shortest time between recordings of the same cause."""
    disk_mb: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    """Size of all recordings; the oldest are deleted, marked ones are kept."""
    folder: Path | None = None
    """Default: `recordings` in the service's `StateDirectory`."""
