"""A reason with the target that it concerns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from altd.reasons import Reason
from altd.records.frames import Origin


@dataclass(frozen=True, slots=True)
class Fault:
    """One reason with the target it concerns (None: the whole unit) and a sentence for people."""

    reason: Reason
    target: str | None = None
    detail: str = ""

    def __str__(self) -> str:
        """Return the published code, such as ``front_spot_missing``."""
        return f"{self.target}_{self.reason}" if self.target else str(self.reason)


def origin_faults(origins: Mapping[str, Origin], played: Iterable[str] = ()) -> tuple[Fault, ...]:
    """Return the warnings of each measurement from these cameras' frames; ``played`` play a recording."""
    simulated = (name for name, origin in origins.items() if origin is Origin.SIMULATED)
    by_reason = {Reason.PLAYBACK: sorted(played), Reason.SIMULATED: sorted(simulated)}
    return tuple(Fault(reason, detail=", ".join(names)) for reason, names in by_reason.items() if names)
