"""The instrument ``chain``: sights in, results of rounds out; pure but for its memory of the rounds."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from altd.config import ChainSettings
from altd.instruments.chain.displacement import Baseline, Displaced, Displacement
from altd.instruments.chain.glass import INVALIDATING, Diagnosis, GlassCheck
from altd.instruments.chain.places import Place, place_of
from altd.instruments.chain.rate import Rate, Trend, alarms
from altd.instruments.chain.rounds import Round, RoundWindow, Sight
from altd.measuring.calibration import Calibration
from altd.reasons import Reason
from altd.records import Fault

_ROUNDS_BEFORE = 3
"""Rounds before that show whether the beam moved smoothly."""
_MAX_ROUNDS = 1000
"""Rounds that are remembered while the baseline is not complete."""
_UNLIKE_THE_BEAM = (Reason.DISTORTED, Reason.IMPLAUSIBLE, Reason.OUT_OF_RANGE)
STABLE_MOVED = "stable_moved"
NO_BASELINE = "no_baseline"
STABLE_DISAGREE = "stable_targets_disagree"
BEAM_LOST = "beam_lost"
BASELINE = "baseline_incomplete"
BEAM_KNOWN = {"line": (), "offset": ("beam_angle_unknown",), "nothing": ("beam_drift_unknown",)}
BEAM_OPEN = "beam_not_closed"
"""A warning of the last round of a recording: no later visit shows how the beam moved on."""


@dataclass(frozen=True, slots=True)
class TargetResult:
    """One target in a round. Without ``place`` it is invalid; ``status`` says why, or warns."""

    place: Place | None
    status: tuple[str, ...] = ()
    displacement: Displacement | None = None
    rate: Rate | None = None


@dataclass(frozen=True, slots=True)
class RoundResult:
    """A round: its last exposure's number, the mean time of its exposures, and the targets in beam order."""

    sequence: int
    t_ns: int
    frames: int
    targets: Mapping[str, TargetResult]
    status: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether any target was measured."""
        return any(of.place is not None for of in self.targets.values())


@dataclass(frozen=True, slots=True)
class _Measured:
    """A round, located: places or faults, and what the switches did."""

    sequence: int
    t_ns: int
    places: Mapping[str, Place]
    faults: Mapping[str, tuple[Fault, ...]]
    diagnosis: Diagnosis = field(default_factory=Diagnosis)


class Chain:
    """Rounds of a row of targets; a round's result is known when the round after it has ended.

    The beam's movement at each visit is taken between the stable targets' visits before and after it: so a
    beam that jumps within a round moves no place.
    """

    def __init__(self, calibration: Calibration, settings: ChainSettings) -> None:
        self._calibration = calibration
        self._settings = settings
        self._targets = calibration.target_names
        self._window = RoundWindow(self._targets)
        self._glasses = GlassCheck(self._targets, settings.exposures)
        self._baseline = Baseline(calibration, settings.stable, settings.baseline_rounds)
        self._trends = {name: Trend() for name in self._targets}
        self._history: deque[_Measured] = deque(maxlen=_MAX_ROUNDS)
        self._pending: _Measured | None = None

    def add(self, sight: Sight) -> RoundResult | None:
        """Take what a camera saw in one frame; the result of a round, or None."""
        ended = self._window.add(sight)
        return None if ended is None else self._next(ended)

    def flush(self) -> list[RoundResult]:
        """The results that are still due, at the end of a recording."""
        results = []
        if (last := self._window.flush()) is not None and (result := self._next(last)) is not None:
            results.append(result)
        if self._pending is not None:
            results.append(self._result(self._pending, is_open=True))
            self._pending = None
        return results

    def _next(self, round_: Round) -> RoundResult | None:
        """Measure a round; the result of the one before it."""
        measured = self._measured(round_)
        self._history.append(measured)
        while self._baseline.is_complete and len(self._history) > _ROUNDS_BEFORE + 2:
            self._history.popleft()
        before, self._pending = self._pending, measured
        return None if before is None else self._result(before, is_open=False)

    def _measured(self, round_: Round) -> _Measured:
        places: dict[str, Place] = {}
        faults: dict[str, tuple[Fault, ...]] = {}
        for name in self._targets:
            visit, target = round_.visits.get(name), self._calibration.target(name)
            if visit is None or target is None:
                faults[name] = (Fault(Reason.CAMERA_SILENT, name),)
                continue
            place = place_of(visit, target, self._calibration.limits, self._settings.exposures)
            if isinstance(place, Place):
                places[name] = place
            else:
                faults[name] = place
        unlike = [name for name, of in faults.items() if of[0].reason in _UNLIKE_THE_BEAM]
        diagnosis = self._glasses.inspect(round_, unlike)
        places = {name: of for name, of in places.items() if not diagnosis.has(name, *INVALIDATING)}
        times = [place.t_ns for place in places.values()] or [
            sight.t_ns for visit in round_.visits.values() for of in visit.sights.values() for sight in of
        ]
        t_ns = times[0] + round(sum(time - times[0] for time in times) / len(times))
        return _Measured(round_.sequence, t_ns, places, faults, diagnosis)

    def _result(self, of: _Measured, is_open: bool) -> RoundResult:
        history = {
            name: [each.places[name] for each in self._history if name in each.places]
            for name in self._targets
        }
        displaced = Displaced()
        status = list[str]()
        if self._baseline.is_complete:
            displaced = self._baseline.displaced(of.places, history)
            status += [STABLE_DISAGREE] if displaced.disagree else BEAM_KNOWN[displaced.beam]
            status += [BEAM_OPEN] if is_open else []
        else:
            self._baseline.take(of.places, history)
            status.append(BASELINE)
        if of.diagnosis.beam_lost:
            status.append(BEAM_LOST)
        targets = {name: self._target(name, of, displaced) for name in self._targets}
        status += [f"{name}_{code}" for name, target in targets.items() for code in target.status]
        frames = sum(place.frames for place in of.places.values())
        return RoundResult(of.sequence, of.t_ns, frames, targets, tuple(dict.fromkeys(status)))

    def _target(self, name: str, of: _Measured, displaced: Displaced) -> TargetResult:
        codes: list[str] = [str(fault.reason) for fault in of.faults.get(name, ())]
        codes += map(str, of.diagnosis.faults.get(name, ()))
        place = of.places.get(name)
        if place is None:
            return TargetResult(None, tuple(dict.fromkeys(codes)))
        if name in displaced.moved:
            codes.append(STABLE_MOVED)
        displacement = displaced.places.get(name)
        if displacement is None:
            if self._baseline.is_complete and not self._baseline.has(name):
                codes.append(NO_BASELINE)
            return TargetResult(place, tuple(codes))
        rate = self._trends[name].add(displacement)
        settings = self._settings
        codes += alarms(displacement, rate, settings.alarm_mm, settings.alarm_mm_per_day)
        return TargetResult(place, tuple(codes), displacement, rate)
