"""Compares all that a unit's interfaces show with the truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from altd.records import FloatArray
from benchmarks.campaign.judge import SIGMAS
from benchmarks.campaign.ways.times import PERIOD_NS
from benchmarks.faults.wires import Published

WINDOW = 20
"""The default of ``[measuring] window``."""
LIMITS = np.array([0.15, 0.15, 0.03, 0.03])
"""Mm, mm, °, °."""
MAX_REASON_S, MAX_BACK_S = 1.0, 3.0
MAX_AGE_S = 1.0 + (WINDOW + 2) / 2 * PERIOD_NS * 1e-9
"""The default of ``stale_after_s``, from the window's last exposure, and one interval."""
_CLOCK_SET = timedelta(seconds=1)
POLLED = ("http", "local", "modbus")
"""Wires that are asked at each exposure: they time reason and recovery."""


@dataclass(slots=True)
class Result:
    """The sums of one run. Errors are the largest of values that were shown, in mm, ° and sigmas."""

    judged: Counter[str] = field(default_factory=Counter)
    """By wire."""
    reasons: Counter[str] = field(default_factory=Counter)
    valid: int = 0
    beyond_sigmas: int = 0
    beyond_limits: int = 0
    stale: int = 0
    contradicting: int = 0
    """Numbers without the flag, or the flag without numbers or time."""
    no_reason: int = 0
    unanswered: int = 0
    """Requests of a polled wire."""
    worst_mm: float = 0.0
    worst_deg: float = 0.0
    worst_sigmas: float = 0.0
    reason_s: float | None = None
    """From the onset until every polled wire was invalid with a reason; None: that never was."""
    back_s: float = math.inf
    """From the end until every polled wire was valid, and stayed so."""
    was_invalid: bool = False
    """No wire showed a value before the onset: the beam lies on something that the unit refuses."""

    @property
    def is_back(self) -> bool:
        """Whether the unit measured again in time, where it measured before."""
        return self.was_invalid or self.back_s <= MAX_BACK_S

    @property
    def wrong(self) -> int:
        """Values that no reader may be shown, those above five sigmas aside."""
        return self.beyond_limits + self.stale + self.contradicting


class Judge:
    """Judges what is shown. ``error_of`` gives the error of a value at its time, ns, from the truth.

    The fault lasts from ``onset_ns`` to ``end_ns``; the process is stopped for ``held_ns`` of it.
    """

    def __init__(
        self,
        error_of: Callable[[Published, float, int], FloatArray],
        onset_ns: float,
        end_ns: float,
        held_ns: int = 0,
    ) -> None:
        self.result = Result()
        self.onset_ns, self.end_ns = onset_ns, end_ns
        self.back_ns: float | None = None
        self._error_of = error_of
        self._held_ns = held_ns
        self._utc_zeros: list[datetime] = []

    def take(self, shown: Sequence[Published], now_ns: int, utc_zero: datetime) -> None:
        """Judge what all wires show at an instant; ``utc_zero`` is UTC at 0 by the computer's clock."""
        result = self.result
        if not self._utc_zeros or abs(self._utc_zeros[-1] - utc_zero) > _CLOCK_SET:
            self._utc_zeros.append(utc_zero)
        for one in shown:
            result.judged[one.wire] += 1
            result.contradicting += one.contradicts
            if one.values is not None:
                self._judge(one, now_ns)
            else:
                result.no_reason += not one.reasons
                result.reasons.update(one.reasons)
        if now_ns < self.onset_ns:
            result.was_invalid = result.valid == 0
        polled = {one.wire: one for one in shown if one.wire in POLLED}.values()
        invalid = [one for one in polled if one.values is None and one.reasons]
        result.unanswered += len(POLLED) - len(polled)
        shown_ns = now_ns - self.onset_ns - self._held_ns
        is_due = result.reason_s is None and now_ns < self.end_ns + MAX_REASON_S * 1e9
        if is_due and shown_ns >= 0 and len(invalid) >= len(POLLED):
            result.reason_s = shown_ns * 1e-9
        if now_ns >= self.end_ns:
            is_back = len(polled) - len(invalid) >= len(POLLED)
            if not is_back:
                self.back_ns = None
            elif self.back_ns is None:
                self.back_ns = now_ns
                result.back_s = (now_ns - self.end_ns) * 1e-9

    def _judge(self, one: Published, now_ns: int) -> None:
        assert one.values is not None  # noqa: S101  asked before
        assert one.sigma is not None  # noqa: S101  they come together
        result = self.result
        result.valid += 1
        if one.wire in POLLED and one.age_s is not None:
            t_ns = now_ns - one.age_s * 1e9
        elif one.utc is None:
            result.contradicting += 1
            return
        else:  # after a clock was set there are values with the time of before
            labels = ((one.utc - zero).total_seconds() * 1e9 for zero in self._utc_zeros)
            t_ns = min(labels, key=lambda label_ns: abs(label_ns - now_ns))
        if one.wire == "mqtt" and one.age_s is not None:
            # the clock is set while a message waits for its broker: it counts as read when it was sent
            now_ns = round(t_ns + one.age_s * 1e9)
        result.stale += now_ns - t_ns > MAX_AGE_S * 1e9
        error = self._error_of(one, t_ns, now_ns)
        sigmas = float((error / one.sigma).max())
        result.beyond_sigmas += not sigmas <= SIGMAS
        result.beyond_limits += bool(np.any(~(error <= LIMITS)))
        result.worst_mm = max(result.worst_mm, float(error[:2].max()))
        result.worst_deg = max(result.worst_deg, float(error[2:].max()))
        result.worst_sigmas = max(result.worst_sigmas, sigmas)


def exposures_ns(t_ns: float, frames: int) -> FloatArray:
    """The exposures of a mean over so many, whose middle is at ``t_ns``."""
    return np.asarray(t_ns + PERIOD_NS * (np.arange(frames) - (frames - 1) / 2))
