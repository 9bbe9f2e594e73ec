"""Parts that need maintenance, or exceed the specification, before they make a measurement invalid.

Each class is a watch of ``altd.status.state``: called for an instant of the monotonic clock, it yields the
faults at that instant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from altd.config import Maintenance
from altd.measuring.spot_locator import Located
from altd.measuring.spot_trend import DustShare, MedianTrend, residual_share
from altd.records import NoSpot, counted
from altd.status.cause import Cause
from altd.status.conditions import Condition
from altd.status.health import Component

TEMPERATURE_HYSTERESIS_K = 1.0
"""Distance inside a limit, K, that the temperature must reach before the limit no longer counts as passed."""

_RECOVERY = 1.1
"""Hysteresis factor: a value below its limit is good again above the limit times this; for an upper limit,
below the limit divided by it."""

_MAX_CLOCK_ERROR = timedelta(days=1)
"""Maximum clock error: time zones and slow clocks explain a day; above it, the clock was never set."""


def due_date(created: datetime, due_days: float) -> str:
    """Return the date, UTC, until which a calibration is valid; empty: after the year 9999."""
    try:
        return f"{created + timedelta(days=due_days):%Y-%m-%d}"
    except OverflowError:
        return ""


class CalibrationAge:
    """Whether the calibration is due, by the time of day because it was made on another computer.

    A time without a zone, possible in a file written by hand, counts as UTC.
    """

    def __init__(self, created: datetime, due_days: float, utc: Callable[[int], datetime | None]) -> None:
        self._created = created if created.tzinfo is not None else created.replace(tzinfo=UTC)
        self._due = timedelta(days=due_days)
        self._utc = utc

    def __call__(self, now_ns: int) -> Iterator[Cause]:
        """Yield the fault, if any; none while the time of day is not known."""
        now = self._utc(now_ns)
        if now is None:
            return
        age = now - self._created
        if age < -_MAX_CLOCK_ERROR:
            yield Cause(
                Condition.CLOCK_WRONG, detail=f"it is {now:%Y-%m-%d}, calibrated {self._created:%Y-%m-%d}"
            )
        elif age > self._due:
            yield Cause(
                Condition.CALIBRATION_DUE,
                detail=f"made {self._created:%Y-%m-%d}, {counted(age.days, 'day')} ago",
            )


@dataclass(frozen=True, slots=True)
class TemperatureLimits:
    """Limits of a temperature, °C."""

    lowest: float
    highest: float


class Temperatures:
    """Whether temperatures are within their limits; an unknown one is its component's fault."""

    def __init__(
        self, limits: Mapping[str, TemperatureLimits], component: Callable[[str], Component]
    ) -> None:
        self._limits = {name: (component(f"temperature {name}"), limit) for name, limit in limits.items()}
        self._passed: dict[str, Condition] = {}

    def __call__(self, now_ns: int) -> Iterator[Cause]:
        """Yield each temperature that is too low or too high."""
        for name, (component, limits) in self._limits.items():
            celsius = component.figures.get("celsius")
            if not isinstance(celsius, float):
                continue
            passed = _passed_limit(celsius, limits, self._passed.get(name))
            if passed is None:
                self._passed.pop(name, None)
                continue
            self._passed[name] = passed
            yield Cause(passed, name, f"{celsius:.1f} C")


def _passed_limit(celsius: float, limits: TemperatureLimits, before: Condition | None) -> Condition | None:
    above = TEMPERATURE_HYSTERESIS_K * (before is Condition.TOO_HOT)
    below = TEMPERATURE_HYSTERESIS_K * (before is Condition.TOO_COLD)
    if celsius > limits.highest - above:
        return Condition.TOO_HOT
    if celsius < limits.lowest + below:
        return Condition.TOO_COLD
    return None


class SpotTrends:
    """Trends of each target's light, residuals and dust, compared with their limits.

    ``targets`` maps each camera to its target.
    """

    def __init__(self, targets: Mapping[str, str], limits: Maintenance) -> None:
        self._target_of = targets
        self._targets = tuple(targets.values())
        self.light = {target: MedianTrend() for target in self._targets}
        self.residual = {target: MedianTrend() for target in self._targets}
        self.dust = {target: DustShare() for target in self._targets}
        self._limits = limits
        self._warned: set[tuple[Condition, str]] = set()

    def add(self, located: Located) -> None:
        """Add a frame's located spot."""
        if isinstance(located.spot, NoSpot):
            return
        target = self._target_of[located.camera]
        if located.spot.light_per_ms is not None:
            self.light[target].add(located.t_ns, located.spot.light_per_ms)
        if located.dust is not None:
            self.dust[target].add(located.dust)
        self.residual[target].add(located.t_ns, residual_share(located.spot))

    def __call__(self, now_ns: int) -> Iterator[Cause]:
        """Yield each target with too little light, too large residuals or dust."""
        for target in self._targets:
            share = self.light[target].figures.share
            if self._is_below(Condition.LASER_WEAK, target, share, self._limits.min_light_share):
                yield Cause(Condition.LASER_WEAK, target, f"{share:.0%} of its reference's light")
        for target in self._targets:
            recent = self.residual[target].figures.recent
            if self._is_above(Condition.RESIDUALS_RISING, target, recent, self._limits.max_residual_share):
                yield Cause(Condition.RESIDUALS_RISING, target, f"{recent:.0%} of what makes it distorted")
        for target in self._targets:
            covered = self.dust[target].share
            if self._is_above(Condition.DUSTY, target, covered, self._limits.max_dust_share):
                yield Cause(Condition.DUSTY, target, f"{covered:.2%} of the area under the spot are covered")

    def _is_below(self, condition: Condition, target: str, value: float | None, limit: float) -> bool:
        """Whether a value is below its limit; after a warning, until it is well above."""
        limit *= _RECOVERY if (condition, target) in self._warned else 1
        return self._warns(condition, target, is_bad=value is not None and value < limit)

    def _is_above(self, condition: Condition, target: str, value: float | None, limit: float) -> bool:
        limit /= _RECOVERY if (condition, target) in self._warned else 1
        return self._warns(condition, target, is_bad=value is not None and value > limit)

    def _warns(self, condition: Condition, target: str, *, is_bad: bool) -> bool:
        (self._warned.add if is_bad else self._warned.discard)((condition, target))
        return is_bad
