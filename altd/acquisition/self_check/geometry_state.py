"""The effect of the last checks on a measurement."""

from __future__ import annotations

from collections.abc import Mapping

from altd.config import SelfCheckSettings
from altd.measuring.calibration import Calibration
from altd.ports import Clock
from altd.reasons import Reason
from altd.records import Fault, Finding, MeanSpots
from altd.selfcheck.records import DriftLimits, SelfCheck, Similarity, Verdict
from altd.selfcheck.verdict import SIGNIFICANT, Compensation, compensated, compensation_of
from altd.status.health import State

MAX_UNCONFIRMED_INTERVALS = 3
"""Intervals of the schedule for which a correction is applied after the check that it is based on. By then
about nine checks have ended without a verdict: the current drift is unknown."""
_AFTER_SHOCK = "the spots of all targets have jumped, and the check after it has not ended"
_BEFORE_START = "bad at the last check before this start, and no check since has a verdict"


class GeometryState:
    """The known state of the unit's geometry. Before the first check no measurement is valid.

    A check without a verdict changes nothing: a bad geometry stays bad, and a correction continues until a
    check has another verdict or the correction lapses.
    """

    def __init__(
        self, settings: SelfCheckSettings, limits: DriftLimits, calibration: Calibration, clock: Clock
    ) -> None:
        self._settings = settings
        self._limits = limits
        self.calibration = calibration
        self._clock = clock
        self._known: SelfCheck | None = None
        self._known_ns = 0
        self._slow_drift = ""
        self._compensation: Compensation | None = None
        self._refusal = ""
        self._of_known: tuple[Fault, ...] = ()
        self._of_unknown: tuple[Fault, ...] = ()
        self._pending: tuple[Fault, ...] = (
            Fault(Reason.SELF_CHECKING, detail="the first self-check is under way"),
        )
        if not settings.enabled:
            self._pending = ()

    @property
    def verdict(self) -> Verdict | None:
        """The last verdict other than unknown; None: none yet."""
        return None if self._known is None else self._known.verdict

    @property
    def awaits_first(self) -> bool:
        """Whether no measurement is valid because no check has ended yet."""
        return bool(self._pending)

    def correct(self, mean: MeanSpots) -> MeanSpots:
        """Return the mean spots corrected for the drift that the last check proved, if it did."""
        return mean if self._compensation is None else compensated(mean, self._compensation)

    def take(self, check: SelfCheck, slow_drift: str = "") -> None:
        """Apply a completed check; ``slow_drift`` is the finding of all checks together, as text."""
        self._pending = ()
        is_unknown = check.verdict is Verdict.UNKNOWN
        is_all_known = check.is_whole and not is_unknown
        self._of_unknown = () if is_all_known else (self._fault_of_unknown("; ".join(check.reasons)),)
        if self._changes_nothing(check):
            return
        self._known = check
        self._known_ns, self._slow_drift = self._clock.monotonic_ns(), slow_drift
        self._compensation, self._refusal = self._compensation_of(check)
        self._of_known = self._faults(check)

    def note_shock(self) -> None:
        """Note that the unit may have been struck: until the next check, the geometry is unknown."""
        if self._settings.enabled:
            self._of_unknown = (self._fault_of_unknown(_AFTER_SHOCK),)

    def recall_bad(self) -> None:
        """Restore a bad verdict from before this start, unless a check has had a verdict since."""
        if self._known is None:
            self._known = SelfCheck(Verdict.BAD, {}, {}, (_BEFORE_START,))
            self._of_known = self._faults(self._known)

    def lapse(self) -> bool:
        """End a correction that no check has confirmed for too long; return whether it ended now.

        The faults of the last known check then apply without the correction.
        """
        if self._compensation is None or self._known is None:
            return False
        since_s = (self._clock.monotonic_ns() - self._known_ns) * 1e-9
        if since_s <= MAX_UNCONFIRMED_INTERVALS * self._settings.interval_s:
            return False
        self._compensation = None
        self._refusal = f"; no longer corrected: no check has confirmed it for {since_s:.0f} s"
        self._of_known = self._faults(self._known)
        return True

    def transforms_after(self, check: SelfCheck) -> Mapping[str, Similarity]:
        """Return the ``transforms`` that would result from ``take`` with this check."""
        if self._changes_nothing(check):
            return self.transforms
        compensation, _ = self._compensation_of(check)
        return {} if compensation is None else compensation.transforms

    @property
    def transforms(self) -> Mapping[str, Similarity]:
        """Transforms of the image's movement by corrected target; empty: no correction."""
        return {} if self._compensation is None else self._compensation.transforms

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults of every measurement now, worst first."""
        return self._pending or (*self._of_known, *self._of_unknown)

    @property
    def state(self) -> State:
        """State of the self-check as a component: failed if it forbids all numbers."""
        if any(not fault.reason.is_warning for fault in self.faults):
            return State.FAILED
        return State.DEGRADED if self.faults else State.OK

    def finding(self, is_valid: bool) -> Finding:
        """Return the faults of a measurement now; an error takes the numbers of a valid one."""
        faults = self.faults
        return Finding(faults, is_valid and any(not fault.reason.is_warning for fault in faults))

    def _changes_nothing(self, check: SelfCheck) -> bool:
        """Whether the earlier state remains: no verdict, or corrected and suspect from some targets only."""
        in_part = check.verdict is Verdict.SUSPECT and not check.is_whole
        return check.verdict is Verdict.UNKNOWN or (in_part and self._compensation is not None)

    def _fault_of_unknown(self, detail: str) -> Fault:
        is_invalid = self._settings.when_unknown == "invalid"
        return Fault(Reason.GEOMETRY_UNVERIFIED if is_invalid else Reason.GEOMETRY_UNKNOWN, detail=detail)

    def _compensation_of(self, check: SelfCheck) -> tuple[Compensation | None, str]:
        if not self._settings.compensate or not _is_proven(check):
            return None, ""
        compensation = compensation_of(check, self.calibration, self._limits)
        if isinstance(compensation, Compensation):
            return compensation, ""
        return None, f"; not corrected: {compensation.detail}"

    def _faults(self, check: SelfCheck) -> tuple[Fault, ...]:
        detail = "; ".join(check.reasons) + self._refusal
        faults = []
        if self._compensation is not None:
            faults.append(Fault(Reason.COMPENSATED, detail=detail))
        elif check.verdict is Verdict.BAD and self._settings.when_bad == "invalid":
            faults.append(Fault(Reason.GEOMETRY_DRIFT, detail=detail))
        elif check.verdict in (Verdict.BAD, Verdict.SUSPECT):
            faults.append(Fault(Reason.GEOMETRY_SUSPECT, detail=detail))
        if self._slow_drift and not faults:
            faults.append(Fault(Reason.GEOMETRY_SUSPECT, detail=self._slow_drift))
        return tuple(faults)


def _is_proven(check: SelfCheck) -> bool:
    """Whether the drift of any target is significant."""
    return any((target.significance or 0.0) > SIGNIFICANT for target in check.targets.values())
