"""The instrument ``chain``: from observations to results of rounds; its only state is its rounds."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from altd.config import RowSettings
from altd.instruments.row.displacement import Baseline, BaselineMeans, Displaced, Displacement
from altd.instruments.row.glass import INVALIDATING, Diagnosis, GlassCheck
from altd.instruments.row.places import BeamPlace, place_of
from altd.instruments.row.rate import DailyRate, DailyTrend, alarms
from altd.instruments.row.rounds import Observation, Round, RoundWindow
from altd.measuring.calibration import Calibration
from altd.reasons import Reason
from altd.records import Fault

_ROUNDS_BEFORE = 3
"""Number of earlier rounds that show whether the beam moved smoothly."""
_MAX_ROUNDS = 1000
"""Maximum number of rounds kept while the baseline is not complete."""
_UNLIKE_THE_BEAM = (
    Reason.DISTORTED,
    Reason.WRONG_SIZE,
    Reason.WRONG_SHAPE,
    Reason.IMPLAUSIBLE,
    Reason.OUT_OF_RANGE,
)
_BEAM_KNOWN = {
    "line": (),
    "offset": (Reason.BEAM_ANGLE_UNKNOWN,),
    "nothing": (Reason.BEAM_DRIFT_UNKNOWN,),
}


@dataclass(frozen=True, slots=True)
class TargetResult:
    """Result of one target in a round; invalid without ``place``. ``status`` holds faults and warnings."""

    place: BeamPlace | None
    status: tuple[Fault, ...] = ()
    displacement: Displacement | None = None
    rate: DailyRate | None = None


@dataclass(frozen=True, slots=True)
class RoundResult:
    """A round: number and time of its last exposure, mean time, and the targets in beam order.

    ``status`` holds the faults of the whole row.
    """

    sequence: int
    last_ns: int
    t_ns: int
    frames: int
    targets: Mapping[str, TargetResult]
    status: tuple[Fault, ...] = ()


@dataclass(frozen=True, slots=True)
class _Measured:
    """A located round: places or faults, and the diagnosis of the switches."""

    sequence: int
    last_ns: int
    t_ns: int
    places: Mapping[str, BeamPlace]
    faults: Mapping[str, tuple[Fault, ...]]
    diagnosis: Diagnosis = field(default_factory=Diagnosis)


class RowInstrument:
    """Measures rounds of a row of targets; the result of a round is known when the next round has ended.

    The beam's movement at each visit is interpolated between the stable targets' visits before and after it,
    so a beam that jumps within a round displaces no place. ``means`` is a stored baseline; None: the first
    rounds define it.
    """

    def __init__(
        self, calibration: Calibration, settings: RowSettings, means: BaselineMeans | None = None
    ) -> None:
        self._calibration = calibration
        self._settings = settings
        self._targets = calibration.target_names
        self._window = RoundWindow(self._targets)
        self._glasses = GlassCheck(self._targets, settings.exposures)
        self._baseline = Baseline(calibration, settings.stable, settings.baseline_rounds, means)
        self._trends = {name: DailyTrend() for name in self._targets}
        self._history: deque[_Measured] = deque(maxlen=_MAX_ROUNDS)
        self._pending: _Measured | None = None

    @property
    def baseline(self) -> BaselineMeans | None:
        """Means of the baseline; None while it is not complete."""
        return self._baseline.means

    def add(self, observation: Observation) -> RoundResult | None:
        """Process the finding of one frame; return the result of a round, or None."""
        ended = self._window.add(observation)
        return None if ended is None else self._next(ended)

    def forget(self) -> None:
        """Discard the unfinished round, because the next frames do not continue it."""
        self._window.forget()

    def flush(self) -> list[RoundResult]:
        """Return the results that are still due at the end of a recording."""
        results = []
        if (last := self._window.flush()) is not None and (result := self._next(last)) is not None:
            results.append(result)
        if self._pending is not None:
            results.append(self._result(self._pending, is_open=True))
            self._pending = None
        return results

    def _next(self, round_: Round) -> RoundResult | None:
        """Measure a round; return the result of the one before it."""
        measured = self._measured(round_)
        self._history.append(measured)
        while self._baseline.is_complete and len(self._history) > _ROUNDS_BEFORE + 2:
            self._history.popleft()
        before, self._pending = self._pending, measured
        return None if before is None else self._result(before, is_open=False)

    def _measured(self, round_: Round) -> _Measured:
        places: dict[str, BeamPlace] = {}
        faults: dict[str, tuple[Fault, ...]] = {}
        for name in self._targets:
            visit, target = round_.visits.get(name), self._calibration.target(name)
            if visit is None or target is None:
                faults[name] = (Fault(Reason.CAMERA_SILENT, name),)
                continue
            place = place_of(visit, target, self._calibration.limits, self._settings.exposures)
            if isinstance(place, BeamPlace):
                places[name] = place
            else:
                faults[name] = place
        unlike = [name for name, of in faults.items() if of[0].reason in _UNLIKE_THE_BEAM]
        diagnosis = self._glasses.inspect(round_, unlike)
        places = {name: of for name, of in places.items() if not diagnosis.has(name, *INVALIDATING)}
        seen_ns = [
            one.t_ns for visit in round_.visits.values() for of in visit.observations.values() for one in of
        ]
        times = [place.t_ns for place in places.values()] or seen_ns
        t_ns = times[0] + round(sum(time - times[0] for time in times) / len(times))
        return _Measured(round_.sequence, max(seen_ns), t_ns, places, faults, diagnosis)

    def _result(self, of: _Measured, is_open: bool) -> RoundResult:
        history = {
            name: [each.places[name] for each in self._history if name in each.places]
            for name in self._targets
        }
        displaced = Displaced()
        status = list[Reason]()
        if self._baseline.is_complete:
            displaced = self._baseline.displaced(of.places, history)
            status += [Reason.STABLE_DISAGREE] if displaced.disagree else _BEAM_KNOWN[displaced.beam]
            status += [Reason.BEAM_NOT_CLOSED] if is_open else []
        else:
            self._baseline.collect(of.places, history)
            status.append(Reason.BASELINE_INCOMPLETE)
        if of.diagnosis.beam_lost:
            status.append(Reason.BEAM_LOST)
        targets = {name: self._target(name, of, displaced) for name in self._targets}
        frames = sum(place.frames for place in of.places.values())
        return RoundResult(of.sequence, of.last_ns, of.t_ns, frames, targets, tuple(map(Fault, status)))

    def _target(self, name: str, of: _Measured, displaced: Displaced) -> TargetResult:
        faults = [replace(fault, target=name) for fault in of.faults.get(name, ())]
        faults += [Fault(reason, name) for reason in of.diagnosis.faults.get(name, ())]
        place = of.places.get(name)
        if place is None:
            return TargetResult(None, _each_once(faults))
        if name in displaced.moved:
            faults.append(Fault(Reason.STABLE_MOVED, name))
        displacement = displaced.places.get(name)
        if displacement is None:
            if self._baseline.is_complete and not self._baseline.has(name):
                faults.append(Fault(Reason.NO_BASELINE, name))
            return TargetResult(place, tuple(faults))
        rate = self._trends[name].add(displacement)
        settings = self._settings
        raised = alarms(displacement, rate, settings.alarm_mm, settings.alarm_mm_per_day)
        faults += [Fault(reason, name) for reason in raised]
        return TargetResult(place, tuple(faults), displacement, rate)


def _each_once(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """First fault of each reason."""
    first = dict[Reason, Fault]()
    for fault in faults:
        first.setdefault(fault.reason, fault)
    return tuple(first.values())
