"""Grouping of frames into visits and of visits into rounds: a round is one visit of all targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from altd.reasons import Reason
from altd.records import NoSpot, Spot

MAX_VISIT_EXPOSURES = 256
"""Maximum number of exposures in a visit: a forgotten switch must not fill the memory."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Finding of one camera in one exposure, and the target that was opaque then; empty: none was.

    ``breaks`` counts, as in ``Located``, the camera's frames that no mean may span.
    """

    target: str
    opaque: str
    sequence: int
    t_ns: int
    spot: Spot | NoSpot
    breaks: int = 0


@dataclass(slots=True)
class Visit:
    """Observations of the cameras while ``target`` was opaque, by target, in order of time."""

    target: str
    observations: dict[str, list[Observation]] = field(default_factory=dict)
    sequences: dict[int, None] = field(default_factory=dict)

    def own(self, exposures: int) -> list[Observation]:
        """Observations of the opaque target itself in the last exposures, none from before a break."""
        observations = [
            one for one in self.observations.get(self.target, ()) if one.sequence in self.last(exposures)
        ]
        return [one for one in observations if one.breaks == observations[-1].breaks]

    def last(self, exposures: int) -> set[int]:
        """Numbers of the last exposures; in the earlier ones the glass settles."""
        return set(list(self.sequences)[-exposures:])

    def brightness(self, target: str, exposures: int) -> list[float] | None:
        """Light at a target's camera in each of the last exposures; None: not known.

        In counts · px², up to a constant factor that of a Gaussian; 0 without a spot.
        """
        last = self.last(exposures)
        lights = [_light(one.spot) for one in self.observations.get(target, ()) if one.sequence in last]
        known = [light for light in lights if light is not None]
        return known if known and 2 * len(known) >= len(lights) else None


def _light(spot: Spot | NoSpot) -> float | None:
    """Light of a spot; None: its strength is unknown, or the frame is not valid."""
    if isinstance(spot, Spot):
        return spot.peak * spot.diameter_px**2
    return 0.0 if spot.reason is Reason.SPOT_MISSING else None


@dataclass(frozen=True, slots=True)
class Round:
    """One visit of each target, by name; a target that was not visited is absent."""

    visits: Mapping[str, Visit]

    @property
    def sequence(self) -> int:
        """Number of the last exposure."""
        return max(max(visit.sequences) for visit in self.visits.values())


class RoundWindow:
    """Collects frames into rounds. A round ends when a target is opaque again, or at the end of the frames.

    It may begin at any target. A round that lacks targets is still a round: their cameras are silent. The
    first and the last round are dropped if they lack some, because the frames begin and end anywhere.
    """

    def __init__(self, targets: tuple[str, ...]) -> None:
        self._targets = targets
        self._visits: dict[str, Visit] = {}
        self._current: Visit | None = None
        self._is_first = True

    def add(self, observation: Observation) -> Round | None:
        """Add an observation; return the round that ended before it, or None."""
        ended = None
        current = self._current
        is_full = current is not None and len(current.sequences) >= MAX_VISIT_EXPOSURES
        is_new = current is None or observation.opaque != current.target
        if is_new or (is_full and current is not None and observation.sequence not in current.sequences):
            if observation.opaque in self._visits:
                ended = self._end()
            self._current = current = Visit(observation.opaque)
            self._visits[observation.opaque] = current
        assert current is not None  # noqa: S101  set above
        current.sequences[observation.sequence] = None
        current.observations.setdefault(observation.target, []).append(observation)
        return ended

    def forget(self) -> None:
        """Discard the unfinished round, because the next frames do not continue it."""
        self._visits, self._current, self._is_first = {}, None, True

    def flush(self) -> Round | None:
        """Return the last round at the end of a recording; None: it lacks targets."""
        is_whole = len(self._visits) == len(self._targets)
        return self._end() if is_whole else None

    def _end(self) -> Round | None:
        visits, self._visits, self._current = self._visits, {}, None
        is_partial_first = self._is_first and len(visits) < len(self._targets)
        self._is_first = False
        return None if is_partial_first else Round(visits)
