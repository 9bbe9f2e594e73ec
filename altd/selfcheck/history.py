"""Checks by day, to find a slow drift long before a limit (CUSUM, E. S. Page, Biometrika 41, 1954).

The mean of each day's checks counts, so that neither a warm afternoon nor an hourly schedule makes a drift.
Shift in u and v, and turn and scale as px at the LEDs, are summed up beyond an allowance K, each in both
directions: S ← max(0, S ± x − K). A drift is reported once S exceeds the limit H.

K is at least five standard deviations of x, including that of the reference, which is the same in all checks
of a calibration. So chance raises S above zero in less than one day of a hundred thousand; that limits the
false alarms without independence of the checks. 0.02 px a day exceed K on the second day and H on the fifth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from altd.selfcheck.records import SelfCheck, Similarity, Verdict

MIN_ALLOWANCE_PX = 0.03
"""Minimum allowance K: a picture that moves by less and stays there, as with warmth, is no drift."""
ALLOWANCE_SIGMAS = 5.0
MIN_LIMIT_PX = 0.06
LIMIT_SIGMAS = 5.0
DAY_S = 86_400.0
DAYS_KEPT = 30

_Px = Annotated[float, Field(ge=-1e12, le=1e12)]
Numbers = tuple[_Px, _Px, _Px, _Px]
"""Shift in u, shift in v, turn, scale, each as px at the LEDs."""
_NotNegative = Annotated[float, Field(ge=0, le=1e18)]
_Sums = tuple[_NotNegative, _NotNegative, _NotNegative, _NotNegative]
"""Variances of the four numbers, or their sums beyond the allowance."""
_NOTHING: Numbers = (0.0, 0.0, 0.0, 0.0)
_FILED = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Configuration for ``history_of``, which checks the fields of these records by their types."""


@dataclass(frozen=True, slots=True)
class SlowDrift:
    """Target whose camera drifts: its deviation from the calibration, and its speed."""

    target: str
    shift_px: tuple[float, float]
    turn_deg: float
    scale_ppm: float
    px_per_day: float


@dataclass(frozen=True, slots=True)
class Day:
    """Checks of one day: its number, number of checks, sum of their results and of their variances."""

    __pydantic_config__ = _FILED
    number: Annotated[int, Field(ge=-1_000_000, le=4_000_000)]
    checks: Annotated[int, Field(ge=1, le=1_000_000_000)]
    sums: Numbers
    variances: _Sums

    @property
    def mean(self) -> Numbers:
        """Mean of the results, px."""
        return _four(np.array(self.sums) / self.checks)

    @property
    def sigma(self) -> Numbers:
        """Sigma of the mean, px: that of one check, because the reference's part is the same in all."""
        return _four(np.sqrt(np.array(self.variances) / self.checks))


@dataclass(frozen=True, slots=True)
class TargetHistory:
    """One target: the current day, the last days, CUSUMs upwards and downwards, the LEDs' radius."""

    __pydantic_config__ = _FILED
    today: Day
    days: Annotated[tuple[Day, ...], Field(max_length=DAYS_KEPT)]
    above: _Sums
    below: _Sums
    drifts: bool
    radius_px: Annotated[float, Field(gt=0, le=1e5)]

    def with_numbers(self, numbers: Numbers, variances: Numbers, number: int) -> TargetHistory:
        """Return the history with one more check, of that day."""
        if number <= self.today.number:  # after a clock was set back, checks add to the current day
            today = Day(
                self.today.number,
                self.today.checks + 1,
                _four(np.add(self.today.sums, numbers)),
                _four(np.add(self.today.variances, variances)),
            )
            return replace(self, today=today)
        return replace(self._closed(), today=Day(number, 1, numbers, variances))

    def dated_back(self, number: int) -> TargetHistory:
        """Return the same days in their order, with ``number`` as the newest and no other day later."""
        too_late = max(self.days[-1].number - (number - 1), 0) if self.days else 0
        days = tuple(replace(day, number=day.number - too_late) for day in self.days)
        return replace(self, days=days, today=replace(self.today, number=number))

    def _closed(self) -> TargetHistory:
        """Return the history with the current day summed up."""
        mean, sigma = np.array(self.today.mean), np.array(self.today.sigma)
        allowance = np.maximum(MIN_ALLOWANCE_PX, ALLOWANCE_SIGMAS * sigma)
        limit = np.maximum(MIN_LIMIT_PX, LIMIT_SIGMAS * sigma)
        above = np.maximum(0.0, np.array(self.above) + mean - allowance)
        below = np.maximum(0.0, np.array(self.below) - mean - allowance)
        return replace(
            self,
            days=(*self.days, self.today)[-DAYS_KEPT:],
            above=_four(np.minimum(above, 2 * limit)),
            below=_four(np.minimum(below, 2 * limit)),
            drifts=bool((np.maximum(above, below) > limit).any()),
        )


@dataclass(frozen=True, slots=True)
class CheckHistory:
    """History of all checks by target; a new calibration starts a new one.

    ``was_bad``: whether the last check with a verdict was bad.
    """

    __pydantic_config__ = _FILED
    targets: Mapping[str, TargetHistory]
    was_bad: bool = False

    @classmethod
    def empty(cls) -> Self:
        """Return the history before the first check."""
        return cls({})

    def with_verdict(self, verdict: Verdict) -> Self:
        """Return the history with the verdict of the last check that had one."""
        return replace(self, was_bad=verdict is Verdict.BAD)

    def with_check(self, check: SelfCheck, time_s: float) -> Self:
        """Return it with one more check, at ``time_s`` (any clock that runs through a restart, such as UTC).

        A target that the check could not judge is not changed.
        """
        number = math.floor(time_s / DAY_S)
        targets = dict(self.targets)
        for name, drift in check.targets.items():
            if drift.similarity is None or not drift.is_similarity:
                continue
            numbers, variances = _numbers(drift.similarity)
            known = targets.get(name)
            if known is None:
                today, radius_px = Day(number, 1, numbers, variances), drift.similarity.radius_px
                targets[name] = TargetHistory(today, (), _NOTHING, _NOTHING, False, radius_px)
            else:
                targets[name] = known.with_numbers(numbers, variances, number)
        return replace(self, targets=targets)

    def is_ahead_of(self, time_s: float) -> bool:
        """Return whether it holds a day that begins more than a day after ``time_s`` of the same clock."""
        today = math.floor(time_s / DAY_S)
        return any(history.today.number > today + 1 for history in self.targets.values())

    def dated_back(self, time_s: float) -> Self:
        """Return it with the last checks dated to the day of ``time_s``, if it ends later.

        Setting a wrong clock is no evidence against what was found meanwhile.
        """
        number = math.floor(time_s / DAY_S)
        targets = {
            name: history.dated_back(number) if history.today.number > number else history
            for name, history in self.targets.items()
        }
        return replace(self, targets=targets)

    @property
    def slow_drifts(self) -> tuple[SlowDrift, ...]:
        """Targets that drift, by evidence that chance gives less than once in 10,000 checks."""
        return tuple(_slow_drift(name, history) for name, history in self.targets.items() if history.drifts)


def _numbers(similarity: Similarity) -> tuple[Numbers, Numbers]:
    """Return a similarity as px at the LEDs, and the variances, px²."""
    radius = similarity.radius_px
    to_px = np.array([1.0, 1.0, math.radians(radius), 1e-6 * radius])
    return _four(similarity.vector * to_px), _four(np.diag(similarity.covariance) * to_px**2)


def _slow_drift(name: str, history: TargetHistory) -> SlowDrift:
    recent = np.mean([day.mean for day in history.days[-3:]], axis=0)
    days = np.array([day.number for day in history.days], dtype=np.float64)
    means = np.array([day.mean for day in history.days])
    from_middle = days - days.mean()
    slopes = from_middle @ means / max(float(from_middle @ from_middle), 1e-9)
    u, v, turn_px, scale_px = recent.tolist()
    return SlowDrift(
        target=name,
        shift_px=(u, v),
        turn_deg=math.degrees(turn_px / history.radius_px),
        scale_ppm=1e6 * scale_px / history.radius_px,
        px_per_day=float(np.linalg.norm(slopes)),
    )


def _four(values: np.typing.NDArray[np.float64]) -> Numbers:
    first, second, third, fourth = values.tolist()
    return first, second, third, fourth


def document_of(history: CheckHistory) -> dict[str, Any]:
    """Return the history as plain JSON types: at most some 10 kB for each target."""
    targets = {name: asdict(target) for name, target in history.targets.items()}
    return {"targets": targets, "was_bad": history.was_bad}


def history_of(document: Mapping[str, Any], targets: Iterable[str]) -> CheckHistory:
    """Return the history in a document of ``document_of``; raises ValueError with a one-line message.

    ``targets`` are those of the calibration; any other target is an error.
    """
    try:
        history = TypeAdapter(CheckHistory).validate_python(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from error
    for name, target in history.targets.items():
        if name not in targets:
            raise ValueError(f"targets.{name}: the calibration has no such target")
        if any(later.number <= day.number for day, later in pairwise((*target.days, target.today))):
            raise ValueError(f"targets.{name}: the days are not in their order")
        if target.drifts and not target.days:
            raise ValueError(f"targets.{name}: a drift without a day that shows it")
    return history
