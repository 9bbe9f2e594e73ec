"""Compares measurements with the truth, and summarises many of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from altd.records import FloatArray, Measurement
from benchmarks.harness import KEYS

HIDDEN_SUFFIX = " (hidden)"
"""Suffix of a way's name for its episodes that the drawn unit cannot detect."""
SIGMAS = 5.0
LIMITS = np.array([0.05, 0.05, 0.01, 0.01])
"""Error limits in mm, mm, °, °: an error is wrong if it exceeds both five sigmas and this limit."""


class Verdict(StrEnum):
    """Verdict on a measurement."""

    RIGHT = "valid and right"
    WRONG = "valid and wrong"
    INVALID = "invalid"


@dataclass(frozen=True, slots=True)
class Judgement:
    """A measurement's largest errors against the truth, in mm, in ° and in sigmas; 0 if it is invalid."""

    verdict: Verdict
    error_mm: float = 0.0
    error_deg: float = 0.0
    sigmas: float = 0.0
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def judge(measurement: Measurement, truth: FloatArray | None) -> Judgement:
    """Compare a measurement with x mm, y mm, yaw °, pitch °; without a truth every value is wrong."""
    reasons = tuple(str(fault) for fault in measurement.status if not fault.reason.is_warning)
    warnings = tuple(str(fault) for fault in measurement.status if fault.reason.is_warning)
    if not measurement.valid:
        return Judgement(Verdict.INVALID, reasons=reasons, warnings=warnings)
    if truth is None:
        return Judgement(Verdict.WRONG, np.inf, np.inf, np.inf, warnings=warnings)
    values, sigma = arrays(measurement)
    error = np.abs(values - truth)
    error[~np.isfinite(values)] = np.inf
    in_sigmas = error / sigma
    wrong = bool(np.any((in_sigmas > SIGMAS) & (error > LIMITS))) or not np.isfinite(in_sigmas).all()
    return Judgement(
        Verdict.WRONG if wrong else Verdict.RIGHT,
        float(error[:2].max()),
        float(error[2:].max()),
        float(in_sigmas.max()),
        warnings=warnings,
    )


def truth_of(measurement: Measurement, places: FloatArray, times_ns: FloatArray) -> FloatArray:
    """Mean position of the beam over a window's exposures, from ``places`` (exposures, 4) at ``times_ns``.

    If exposures were lost, it is shifted along the mean path to the time of the measurement.
    """
    mean: FloatArray = places.mean(axis=0)
    if len(places) < 2 or measurement.frames >= len(places):
        return mean
    since = times_ns - times_ns.mean()
    return np.asarray(mean + since @ places / (since @ since) * (measurement.t_ns - times_ns.mean()))


def arrays(measurement: Measurement) -> tuple[FloatArray, FloatArray]:
    """Values x mm, y mm, yaw °, pitch ° of a valid measurement, and their sigmas."""
    values = [measurement.values[key] for key in KEYS]
    return np.array([each.value for each in values]), np.array(
        [each.sigma for each in values], dtype=np.float64
    )


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one episode: the measurements before the onset, and those from it on.

    ``recovered_s``: time from the end of a disturbance until a measurement was valid again.
    """

    clean: tuple[Judgement, ...]
    spoilt: tuple[Judgement, ...]
    recovered_s: float | None = None


@dataclass(slots=True)
class Tally:
    """Sums of one way.

    ``noticed`` are frames from the onset until the first invalid measurement, of episodes that had one;
    ``worst`` holds the notes of wrong measurements with their errors, largest in sigmas first. ``invisible``:
    why a wrong measurement cannot be detected, empty if it can.
    """

    episodes: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    worst_mm: float = 0.0
    worst_deg: float = 0.0
    worst_sigmas: float = 0.0
    wrong_episodes: int = 0
    noticed: list[int] = field(default_factory=list)
    recovered_s: list[float] = field(default_factory=list)
    clean: int = 0
    clean_refused: Counter[str] = field(default_factory=Counter)
    clean_wrong: int = 0
    worst: list[tuple[float, float, float, str]] = field(default_factory=list)
    invisible: str = ""

    @property
    def measurements(self) -> int:
        """Number of measurements during disturbances."""
        return sum(self.verdicts.values())

    def add(self, outcome: Outcome, note: str, invisible: str = "") -> None:
        """Add one episode."""
        spoilt = outcome.spoilt
        self.invisible = invisible
        self.episodes += 1
        if outcome.recovered_s is not None:
            self.recovered_s.append(outcome.recovered_s)
        for one in outcome.clean:
            self.clean += 1
            self.clean_wrong += one.verdict is Verdict.WRONG
            if one.verdict is Verdict.INVALID:
                self.clean_refused[", ".join(one.reasons)] += 1
        for one in spoilt:
            self.verdicts[one.verdict] += 1
            self.reasons.update(one.reasons)
        self._remember([one for one in spoilt if one.verdict is Verdict.WRONG], note)
        first = next((n for n, one in enumerate(spoilt) if one.verdict is Verdict.INVALID), None)
        if first is not None:
            self.noticed.append(first + 1)

    def _remember(self, wrong: Sequence[Judgement], note: str) -> None:
        if not wrong:
            return
        self.wrong_episodes += 1
        self.worst_mm = max(self.worst_mm, *(one.error_mm for one in wrong))
        self.worst_deg = max(self.worst_deg, *(one.error_deg for one in wrong))
        worst = max(wrong, key=lambda one: one.sigmas)
        self.worst_sigmas = max(self.worst_sigmas, worst.sigmas)
        noted = (worst.sigmas, worst.error_mm, worst.error_deg, note)
        self.worst = sorted([*self.worst, noted], reverse=True)[:5]

    def merge(self, other: Tally) -> None:
        """Add the sums of another process."""
        self.invisible = other.invisible
        for name in _SUMS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("worst_mm", "worst_deg", "worst_sigmas"):
            setattr(self, name, max(getattr(self, name), getattr(other, name)))
        self.worst = sorted([*self.worst, *other.worst], reverse=True)[:5]


_SUMS = (
    *("episodes", "verdicts", "reasons", "wrong_episodes", "noticed", "recovered_s"),
    *("clean", "clean_refused", "clean_wrong"),
)
