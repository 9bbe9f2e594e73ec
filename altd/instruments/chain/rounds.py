"""Frames become visits, visits become rounds: one visit of all targets is a round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from altd.reasons import Reason
from altd.records import NoSpot, Spot

MAX_VISIT_EXPOSURES = 256
"""A visit of more is closed: a switch that is forgotten must not fill the memory."""


@dataclass(frozen=True, slots=True)
class Sight:
    """The finding of one camera in one exposure, and the target that was opaque then; empty: none was.

    ``breaks`` counts, as in ``Located``, the camera's frames that no mean may reach across.
    """

    target: str
    opaque: str
    sequence: int
    t_ns: int
    spot: Spot | NoSpot
    breaks: int = 0
    camera: str = ""
    leds_on = False
    """A row has no frame LEDs."""
    found = None
    """No exposure is controlled by a spot that comes and goes with the glasses."""


@dataclass(slots=True)
class Visit:
    """The sights of the cameras while ``target`` was opaque, by target, in order of time."""

    target: str
    sights: dict[str, list[Sight]] = field(default_factory=dict)
    sequences: dict[int, None] = field(default_factory=dict)

    def own(self, exposures: int) -> list[Sight]:
        """The last exposures that show the opaque target itself, none from before a break."""
        sights = [
            sight for sight in self.sights.get(self.target, ()) if sight.sequence in self.last(exposures)
        ]
        return [sight for sight in sights if sight.breaks == sights[-1].breaks]

    def last(self, exposures: int) -> set[int]:
        """The numbers of the last exposures: those before are the time of settling."""
        return set(list(self.sequences)[-exposures:])

    def brightness(self, target: str, exposures: int) -> list[float] | None:
        """The light that a target's camera saw, exposure by exposure; None: not known.

        Counts · px², that of a Gaussian but for a factor; 0 where nothing was seen.
        """
        last = self.last(exposures)
        lights = [_light(sight.spot) for sight in self.sights.get(target, ()) if sight.sequence in last]
        known = [light for light in lights if light is not None]
        return known if known and 2 * len(known) >= len(lights) else None


def _light(spot: Spot | NoSpot) -> float | None:
    """The light of a spot; None: there is some, of unknown strength, or the frame is not to be believed."""
    if isinstance(spot, Spot):
        return spot.peak * spot.diameter_px**2
    return 0.0 if spot.reason is Reason.SPOT_MISSING else None


@dataclass(frozen=True, slots=True)
class Round:
    """One visit of the targets, by their names; a target that was not visited is absent."""

    visits: Mapping[str, Visit]

    @property
    def sequence(self) -> int:
        """The number of its last exposure."""
        return max(max(visit.sequences) for visit in self.visits.values())


class RoundWindow:
    """Collects frames into rounds. A round ends where a target is opaque again, or at the end of the frames.

    It may begin at any target. A round that lacks targets is one all the same: their cameras are silent. The
    first and the last are no rounds if they lack some, for the frames begin and end anywhere.
    """

    def __init__(self, targets: tuple[str, ...]) -> None:
        self._targets = targets
        self._visits: dict[str, Visit] = {}
        self._current: Visit | None = None
        self._is_first = True

    def add(self, sight: Sight) -> Round | None:
        """Take one; the round that ended before it, or None."""
        ended = None
        current = self._current
        is_full = current is not None and len(current.sequences) >= MAX_VISIT_EXPOSURES
        is_new = current is None or sight.opaque != current.target
        if is_new or (is_full and current is not None and sight.sequence not in current.sequences):
            if sight.opaque in self._visits:
                ended = self._end()
            self._current = current = Visit(sight.opaque)
            self._visits[sight.opaque] = current
        assert current is not None  # noqa: S101  made above
        current.sequences[sight.sequence] = None
        current.sights.setdefault(sight.target, []).append(sight)
        return ended

    def forget(self) -> None:
        """Leave out the round that has begun: the frames do not reach back to it."""
        self._visits, self._current, self._is_first = {}, None, True

    def flush(self) -> Round | None:
        """The last round, at the end of a recording; None: it lacks targets."""
        is_whole = len(self._visits) == len(self._targets)
        return self._end() if is_whole else None

    def _end(self) -> Round | None:
        visits, self._visits, self._current = self._visits, {}, None
        is_partial_first = self._is_first and len(visits) < len(self._targets)
        self._is_first = False
        return None if is_partial_first else Round(visits)
