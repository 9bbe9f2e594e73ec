"""What the unit keeps: the history of its measurements and events, and the frames of the last seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from altd.config.table import Table


class HistorySettings(Table):
    """The history: measurements, summaries and events in a file."""

    enabled: bool = True
    """Keep a history; false: events are known until the next start, and no more."""
    file: Path | None = None
    """The file; without it `history.db` in the folder that systemd gives the service. Where there is no such
    folder there is no history."""
    max_mb: Annotated[int, Field(ge=64, le=100_000)] = 400
    """How large the file may become, in 10⁶ bytes: a year takes 265. Then the oldest summaries go."""


class KeptFrames(Table):
    """The frames of the last seconds, so that a fault at night can be replayed in the morning."""

    before_s: Annotated[float, Field(ge=0.5, le=600)] = 10.0
    """Frames from so long before a fault are kept, as far as ``memory_mb`` reaches."""
    after_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    """And from so long after it."""
    memory_mb: Annotated[int, Field(ge=0, le=16_384)] = 160
    """What the frames of all cameras may take in memory; as much again while a recording is written, and
    the unit's ``MemoryMax`` must leave room for both. 0 keeps none."""
    on_fault: bool = True
    """Write a recording when the unit's state becomes worse: failure or out of specification."""
    again_after_s: Annotated[float, Field(ge=10, le=86_400)] = 600.0
    """No second recording of the same cause before that."""
    disk_mb: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    """What all recordings may take: the oldest go first; marked ones stay."""
    folder: Path | None = None
    """Where they are written; without it in `recordings` in the service's own folder
    (`StateDirectory`)."""
