"""The history that the unit keeps of what it measured and of what happened to it."""

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
