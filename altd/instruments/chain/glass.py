"""Faults of the glasses and of the beam's way, named by what all cameras see in a round (docs/chain.md)."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from altd.instruments.chain.rounds import Round
from altd.reasons import Reason

MIN_BRIGHT_SHARE = 0.35
"""A milky glass shows at least this share of its usual light; a clear one scatters far less."""
MIN_FIRST_SHARE = 0.9
"""A settled glass shows in the first exposure at least this share of what it shows in the last."""
MIN_FADING_SHARE = 0.1
"""Light of a glass that still turns clear, of what it shows when milky."""
_REMEMBERED = 20


INVALIDATING = frozenset({Reason.STUCK_CLEAR, Reason.SLOW, Reason.NOT_CONFIRMED, Reason.CAMERAS_SWAPPED})
"""With one of these the target's spot is not to be believed."""


@dataclass(slots=True)
class Diagnosis:
    """The faults of a round, by target; ``beam_lost``: no target shows the beam."""

    faults: dict[str, list[Reason]] = field(default_factory=dict)
    beam_lost: bool = False

    def add(self, target: str, fault: Reason) -> None:
        """Note a fault once."""
        noted = self.faults.setdefault(target, [])
        if fault not in noted:
            noted.append(fault)

    def has(self, target: str, *faults: Reason) -> bool:
        """Whether any of these is noted."""
        return any(fault in self.faults.get(target, ()) for fault in faults)


class GlassCheck:
    """Holds what the cameras saw against what the switches were to show. Remembers each target's light."""

    def __init__(self, targets: Sequence[str], exposures: int) -> None:
        self._targets = tuple(targets)
        self._exposures = exposures
        self._usual: dict[str, deque[float]] = {name: deque(maxlen=_REMEMBERED) for name in targets}

    def inspect(self, round_: Round, unlike: Collection[str] = ()) -> Diagnosis:
        """The faults of a round; ``unlike`` are targets whose light is not a spot of the beam."""
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
    """The light of each target in each visit."""

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
        """The median of a target's light while another, or itself, was opaque; None: not known."""
        lights = self.lights.get((target, opaque))
        return _median(lights) if lights else None

    def own(self, target: str) -> float | None:
        """A target's light while it was opaque; None: not known."""
        return self.light(target, target)

    def behind(self, target: str) -> tuple[str, ...]:
        """The targets behind it, in beam order."""
        return self.targets[self.targets.index(target) + 1 :]

    def before(self, target: str) -> tuple[str, ...]:
        """The targets before it."""
        return self.targets[: self.targets.index(target)]

    def is_bright(self, target: str) -> bool:
        """Whether it shows a spot as bright as usual, or any as long as that is not known."""
        own = self.own(target) or 0.0
        return own > 0.0 and own >= MIN_BRIGHT_SHARE * self._usual.get(target, own)

    def is_unchanged(self, target: str) -> bool:
        """Whether it shows as much light while another is opaque."""
        own = self.own(target) or 0.0
        return any(
            (self.light(target, other) or 0.0) > MIN_BRIGHT_SHARE * own for other in self._others(target)
        )

    def is_seen_opaque_alone(self, target: str) -> bool:
        """Whether no frame shows it while another is opaque."""
        return all(self.light(target, other) is None for other in self._others(target))

    def _others(self, target: str) -> tuple[str, ...]:
        return self.before(target) + self.behind(target)

    def has_reference(self, target: str) -> bool:
        """Whether its usual light is known."""
        return target in self._usual

    def while_clear(self, target: str) -> list[float]:
        """Its light in the visits of the targets behind it, where it is known."""
        lights = (self.light(target, other) for other in self.behind(target))
        return [light for light in lights if light is not None]


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


def _find_slow(seen: _Seen, diagnosis: Diagnosis) -> None:
    """Glasses whose light grows in their own exposures, or fades in those of another.

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
    """Pairs of cameras of which each shows the spot in the other's visit, and not in its own."""
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
    """Whether a glass changes between its own visit and those of the targets behind it."""
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
        diagnosis.add(target, Reason.STUCK_CLEAR)  # else all are dim, and switch: it is the laser


def _find_unswitched(seen: _Seen, diagnosis: Diagnosis, target: str, passes: bool) -> None:
    """Whether a target that shows a spot when opaque shows it as well when clear, or without the beam."""
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
    """The target behind which all are dark, unless a glass that is stuck opaque explains it."""
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
