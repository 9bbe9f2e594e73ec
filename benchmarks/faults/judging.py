"""Compares the outputs of all interfaces of a unit with the truth."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from altd.records import FloatArray
from benchmarks.campaign.judge import SIGMAS
from benchmarks.campaign.way import PERIOD_NS
from benchmarks.faults.wires import Published

WINDOW = 20
"""Default of ``[measuring] window``."""
LIMITS = np.array([0.15, 0.15, 0.03, 0.03])
"""Error limits in mm, mm, °, °."""
MAX_REASON_S, MAX_BACK_S = 1.0, 3.0
MAX_AGE_S = 1.0 + (WINDOW + 2) / 2 * PERIOD_NS * 1e-9
"""Default of ``stale_after_s``, counted from the window's last exposure, and one interval."""
UNANSWERED = "unanswered"
_CLOCK_SET = timedelta(seconds=1)
POLLED = ("http", "local", "modbus")
"""Interfaces that are polled at each exposure; reason and recovery are timed by them."""


@dataclass(slots=True)
class Result:
    """Sums of one run. Errors are the largest ones of displayed values, in mm, ° and sigmas."""

    judged: Counter[str] = field(default_factory=Counter)
    """Number of judged messages by interface."""
    reasons: Counter[str] = field(default_factory=Counter)
    valid: int = 0
    beyond_sigmas: int = 0
    beyond_limits: int = 0
    stale: int = 0
    contradicting: int = 0
    """Values without the valid flag, or the flag without values or time."""
    no_reason: int = 0
    unanswered: int = 0
    """Requests to a polled interface without an answer."""
    worst_mm: float = 0.0
    worst_deg: float = 0.0
    worst_sigmas: float = 0.0
    reason_s: float | None = None
    """Time from the onset until every polled interface was invalid with a reason; None: never."""
    back_s: float = math.inf
    """Time from the end until every polled interface was valid, and remained so."""
    back_by_comparison: bool = False
    """Whether after ``back_s`` it refuses where a unit without the fault refuses too."""
    was_invalid: bool = False
    """Whether no interface showed a value before the onset: the unit refuses the beam at this position."""

    @property
    def is_back(self) -> bool:
        """Whether the unit measured again in time, provided that it measured before."""
        return self.was_invalid or self.back_s <= MAX_BACK_S

    @property
    def wrong(self) -> int:
        """Number of values that must not be shown, except those above five sigmas."""
        return self.beyond_limits + self.stale + self.contradicting


class Judge:
    """Judges displayed messages. ``error_of`` returns the error of a value at its time, ns, from the truth.

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
        self.refusals: dict[int, frozenset[str]] = {}
        """Reasons of the polled interfaces after the end, by time, ns; empty: all showed a value."""
        self._error_of = error_of
        self._held_ns = held_ns
        self._utc_zeros: list[datetime] = []

    def take(self, shown: Sequence[Published], now_ns: int, utc_zero: datetime) -> None:
        """Judge all messages shown at an instant; ``utc_zero`` is UTC at 0 by the computer's clock."""
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
            self.refusals[now_ns] = frozenset(reason for one in invalid for reason in one.reasons)
            if len(polled) < len(POLLED):
                self.refusals[now_ns] |= {UNANSWERED}
            self.time_recovery({})

    def time_recovery(self, undisturbed: Mapping[int, frozenset[str]]) -> None:
        """Time the recovery: every later poll got a value, or the refusals of a unit without the fault."""
        self.back_ns = None
        for now_ns, reasons in self.refusals.items():
            if reasons and reasons != undisturbed.get(now_ns):
                self.back_ns = None
            elif self.back_ns is None:
                self.back_ns = now_ns
        back_ns = math.inf if self.back_ns is None else self.back_ns
        self.result.back_s = (back_ns - self.end_ns) * 1e-9

    def _judge(self, one: Published, now_ns: int) -> None:
        assert one.values is not None  # noqa: S101  checked by the caller
        assert one.sigma is not None  # noqa: S101  set together with the values
        result = self.result
        result.valid += 1
        if one.wire in POLLED and one.age_s is not None:
            t_ns = now_ns - one.age_s * 1e9
        elif one.utc is None:
            result.contradicting += 1
            return
        else:  # after the clock was set, some values still have the previous time
            labels = ((one.utc - zero).total_seconds() * 1e9 for zero in self._utc_zeros)
            t_ns = min(labels, key=lambda label_ns: abs(label_ns - now_ns))
        if one.wire == "mqtt" and one.age_s is not None:
            # the clock may be set while a message waits for its broker: it counts as read when it was sent
            now_ns = round(t_ns + one.age_s * 1e9)
        result.stale += now_ns - t_ns > MAX_AGE_S * 1e9
        error = self._error_of(one, t_ns, now_ns)
        sigmas = float((error / one.sigma).max())
        result.beyond_sigmas += not sigmas <= SIGMAS
        result.beyond_limits += bool(np.any(~(error <= LIMITS)))
        result.worst_mm = max(result.worst_mm, float(error[:2].max()))
        result.worst_deg = max(result.worst_deg, float(error[2:].max()))
        result.worst_sigmas = max(result.worst_sigmas, sigmas)


def error_of_times(errors: FloatArray, own: FloatArray, sigma: FloatArray) -> FloatArray:
    """Smallest of the errors at several times (times, 4) that are within all limits; else ``own``, (4,).

    ``own`` is the error at the value's own time: at another time a quantity can differ that is not wrong.
    """
    within = errors[(errors <= np.minimum(LIMITS, SIGMAS * sigma)).all(axis=1)]
    return np.asarray(within[(within / LIMITS).max(axis=1).argmin()]) if len(within) else own


def exposures_ns(t_ns: float, frames: int) -> FloatArray:
    """Exposure times of a mean over ``frames`` exposures with their middle at ``t_ns``."""
    return np.asarray(t_ns + PERIOD_NS * (np.arange(frames) - (frames - 1) / 2))
