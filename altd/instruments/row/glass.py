"""Faults of the glasses and the beam path, identified by all cameras' light in a round (docs/chain.md)."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from altd.instruments.row.rounds import Round
from altd.reasons import Reason

MIN_BRIGHT_SHARE = 0.35
"""Minimum share of its usual light that a milky glass shows; a clear one scatters far less."""
MIN_FIRST_SHARE = 0.9
"""Minimum light of a settled glass in its first exposure, as a share of the last."""
MIN_FADING_SHARE = 0.1
"""Minimum light of a glass that is still turning clear, as a share of its light when milky."""
_REMEMBERED = 20


INVALIDATING = frozenset({Reason.STUCK_CLEAR, Reason.SLOW, Reason.NOT_CONFIRMED, Reason.CAMERAS_SWAPPED})
"""Faults that make the target's spot invalid."""


@dataclass(slots=True)
class Diagnosis:
    """Faults of a round, by target; ``beam_lost``: no target shows the beam."""

    faults: dict[str, list[Reason]] = field(default_factory=dict)
    beam_lost: bool = False

    def add(self, target: str, fault: Reason) -> None:
        """Add a fault once."""
        noted = self.faults.setdefault(target, [])
        if fault not in noted:
            noted.append(fault)

    def has(self, target: str, *faults: Reason) -> bool:
        """Whether a target has any of these faults."""
        return any(fault in self.faults.get(target, ()) for fault in faults)


class GlassCheck:
    """Compares the light at the cameras with the commanded switch states; keeps each target's usual light."""

    def __init__(self, targets: Sequence[str], exposures: int) -> None:
        self._targets = tuple(targets)
        self._exposures = exposures
        self._usual: dict[str, deque[float]] = {name: deque(maxlen=_REMEMBERED) for name in targets}

    def inspect(self, round_: Round, unlike: Collection[str] = ()) -> Diagnosis:
        """Return the faults of a round; ``unlike`` are targets whose light is not a spot of the beam."""
        seen = _Seen(self._targets, round_, self._exposures, self._usual)
        seen.lights |= {(target, target): None for target in unlike}
        diagnosis = Diagnosis()
        _find_slow(seen, diagnosis)
        _find_swapped(seen, diagnosis)
        for target in self._targets:
            if not diagnosis.has(target, Reason.CAMERAS_SWAPPED):
                _find_stuck(seen, diagnosis, target)
        _find_lost(seen, diagnosis)
        for target in self._targets:
            if target not in diagnosis.faults and (own := seen.own(target)):
                self._usual[target].append(own)
        return diagnosis


class _Seen:
    """Light of each target in each visit."""

    def __init__(
        self,
        targets: tuple[str, ...],
        round_: Round,
        exposures: int,
        usual: Mapping[str, Sequence[float]],
    ) -> None:
        self.targets = targets
        self.lights: dict[tuple[str, str], list[float] | None] = {
            (target, visit.target): visit.brightness(target, exposures)
            for visit in round_.visits.values()
            for target in targets
        }
        self._usual = {target: _median(lights) for target, lights in usual.items() if lights}

    def light(self, target: str, opaque: str) -> float | None:
        """Median light of a target while ``opaque``, another one or itself, was opaque; None: not known."""
        lights = self.lights.get((target, opaque))
        return _median(lights) if lights else None

    def own(self, target: str) -> float | None:
        """Light of a target while it was opaque; None: not known."""
        return self.light(target, target)

    def behind(self, target: str) -> tuple[str, ...]:
        """Targets behind a target, in beam order."""
        return self.targets[self.targets.index(target) + 1 :]

    def before(self, target: str) -> tuple[str, ...]:
        """Targets before a target, in beam order."""
        return self.targets[: self.targets.index(target)]

    def is_bright(self, target: str) -> bool:
        """Whether a target shows a spot as bright as usual, or any spot while its usual light is unknown."""
        own = self.own(target) or 0.0
        return own > 0.0 and own >= MIN_BRIGHT_SHARE * self._usual.get(target, own)

    def is_unchanged(self, target: str) -> bool:
        """Whether a target shows as much light while another one is opaque."""
        own = self.own(target) or 0.0
        return any(
            (self.light(target, other) or 0.0) > MIN_BRIGHT_SHARE * own for other in self._others(target)
        )

    def is_seen_opaque_alone(self, target: str) -> bool:
        """Whether the light of a target is known only for its own visit."""
        return all(self.light(target, other) is None for other in self._others(target))

    def _others(self, target: str) -> tuple[str, ...]:
        return self.before(target) + self.behind(target)

    def has_reference(self, target: str) -> bool:
        """Whether the usual light of a target is known."""
        return target in self._usual

    def while_clear(self, target: str) -> list[float]:
        """Known light of a target in the visits of the targets behind it."""
        lights = (self.light(target, other) for other in self.behind(target))
        return [light for light in lights if light is not None]


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


def _find_slow(seen: _Seen, diagnosis: Diagnosis) -> None:
    """Find glasses whose light grows in their own exposures, or fades in those of another target.

    Where an earlier glass is still fading, the light behind it grows for that reason.
    """
    for opaque in seen.targets:
        for other in seen.before(opaque):
            lights, own = seen.lights.get((other, opaque)), seen.own(other)
            if lights and own and lights[0] > max(MIN_FADING_SHARE * own, lights[-1] / MIN_FIRST_SHARE):
                diagnosis.add(other, Reason.SLOW)
    for target in seen.targets:
        lights = seen.lights.get((target, target)) or [0.0]
        grows = lights == sorted(lights) and lights[0] < MIN_FIRST_SHARE * lights[-1]
        if grows and not any(diagnosis.has(other, Reason.SLOW) for other in seen.before(target)):
            diagnosis.add(target, Reason.SLOW)


def _find_swapped(seen: _Seen, diagnosis: Diagnosis) -> None:
    """Find pairs of cameras that each show the spot in the other's visit, and not in their own."""
    for target in seen.targets:
        for other in seen.behind(target):
            mine, its = seen.own(target), seen.own(other)
            crossed = seen.light(target, other) or 0.0, seen.light(other, target) or 0.0
            if mine is None or its is None or min(crossed) == 0.0:
                continue
            if max(mine, its) < MIN_BRIGHT_SHARE * min(crossed):
                diagnosis.add(target, Reason.CAMERAS_SWAPPED)
                diagnosis.add(other, Reason.CAMERAS_SWAPPED)


def _find_stuck(seen: _Seen, diagnosis: Diagnosis, target: str) -> None:
    """Find a glass that does not change between its own visit and those of the targets behind it."""
    own = seen.own(target)
    if own is None:
        return
    passes = any(seen.is_bright(other) for other in seen.behind(target))
    if seen.is_bright(target):
        _find_unswitched(seen, diagnosis, target, passes)
    elif passes:
        passed = any(seen.light(other, target) for other in seen.behind(target))
        diagnosis.add(target, Reason.STUCK_CLEAR if own or passed else Reason.NOT_CONFIRMED)
    elif own > 0.0 and (any(map(seen.is_bright, seen.targets)) or seen.is_unchanged(target)):
        diagnosis.add(target, Reason.STUCK_CLEAR)  # else all are dim but switch: the laser is dim


def _find_unswitched(seen: _Seen, diagnosis: Diagnosis, target: str, passes: bool) -> None:
    """Find a target that shows its spot not only when opaque, but also when clear or without the beam."""
    own, clear = seen.own(target) or 0.0, seen.while_clear(target)
    stray = any((seen.light(target, other) or 0.0) > MIN_BRIGHT_SHARE * own for other in seen.before(target))
    if stray and all(seen.is_bright(other) for other in seen.before(target)):
        diagnosis.add(target, Reason.NOT_CONFIRMED)
    if seen.is_seen_opaque_alone(target):
        diagnosis.add(target, Reason.SWITCH_UNSEEN)
    elif clear and min(clear) > MIN_BRIGHT_SHARE * own:
        if passes and not seen.has_reference(target):
            diagnosis.add(target, Reason.STUCK_CLEAR)
        elif not diagnosis.has(target, Reason.SLOW):
            diagnosis.add(target, Reason.STUCK_OPAQUE)


def _find_lost(seen: _Seen, diagnosis: Diagnosis) -> None:
    """Find the target behind which all are dark, unless a glass that is stuck opaque explains it."""
    looked_for = [target for target in seen.targets if seen.own(target) is not None]
    bright = [target for target in looked_for if seen.is_bright(target)]
    dark = [target for target in looked_for if seen.own(target) == 0.0]
    if not dark:
        return
    if not bright:
        diagnosis.beam_lost = len(dark) == len(looked_for)
        return
    last = bright[-1]
    behind = [target for target in seen.behind(last) if target in dark]
    if behind and not any(diagnosis.has(each, Reason.STUCK_OPAQUE) for each in bright):
        diagnosis.add(last, Reason.BEAM_LOST_BEHIND)
