"""The message that the daemon sends once to the process of the server, at its start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from altd.config import OpcUaSettings
from altd.records import Quantities, Quantity

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Start:
    """Identity of the unit, what it publishes, and how it is served.

    ``started_ns`` is the monotonic time at which ``clock_ms`` was 0: all processes share that clock.
    ``ranges`` are the ranges of the unit's quantities, ``targets`` those of each target, by their keys.
    """

    settings: OpcUaSettings
    port: int
    serial: str
    product: str
    version: str
    session: str
    started_ns: int
    stale_after_s: float
    quantities: Quantities
    ranges: Mapping[str, Range]
    targets: Mapping[str, Mapping[str, Range]]
    calibration: Mapping[str, Any]
    history: Path | None
    declared: tuple[Quantity, ...] = ()
    """Quantities of beams and plates, for the unit's type."""

    def to_line(self) -> bytes:
        """Return one line of JSON."""
        return _ADAPTER.dump_json(self) + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> Start:
        """Parse a line of ``to_line``; raises ValueError."""
        return _ADAPTER.validate_json(line)


_ADAPTER = TypeAdapter(Start)
