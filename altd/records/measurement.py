"""The measurement: values with their units and uncertainties, or the reasons why there are none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from altd.reasons import Reason
from altd.records.faults import Fault
from altd.records.frames import FloatArray
from altd.records.joint import Joint, Linear
from altd.records.sensors import SensorValue
from altd.records.spots import CrossCheckedBeam, Motion


def counted(number: int, thing: str) -> str:
    """Return number and noun, ``1 frame`` or ``2 frames``; the plural adds an s."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number that an instrument publishes.

    ``key`` names it in JSON and ends in the unit, ``label`` names it on screens. ``decimals`` are those of
    JSON; displays show one less. ``has_sigma``: its standard deviation is published too. ``is_optional``: a
    valid measurement may lack it. ``is_also`` is the key of the same quantity in another unit of measurement.
    ``is_from_sensor``: another sensor measures it, at its own times, whether or not the beam is visible.
    ``place`` is the target of a row to whose place it belongs, ``point`` the point of the machine; the key
    begins with that name.
    """

    key: str
    label: str
    unit: str
    meaning: str
    decimals: int
    has_sigma: bool = True
    is_optional: bool = False
    is_also: str = ""
    is_from_sensor: bool = False
    place: str = ""
    point: str = ""


UNITS_OF_PRODUCTS = ("mm²", "mm²/m", "mm²/m²")
"""Units of a covariance of two displacements, of a displacement and a slope, of two slopes."""


@dataclass(frozen=True, slots=True)
class Quantities:
    """Quantities that a kind of unit publishes: of the whole unit, and of each of its targets.

    ``has_motion``: the instrument estimates their rates. ``joint`` names those whose covariance is published,
    in its order; roll, of another sensor, is the last. ``has_cross_check``: valid measurements have one.
    """

    instrument: str
    of_unit: tuple[Quantity, ...]
    of_target: tuple[Quantity, ...] = ()
    has_motion: bool = False
    joint: tuple[str, ...] = ()
    has_cross_check: bool = False

    @property
    def main(self) -> tuple[Quantity, ...]:
        """Quantities of the unit in every valid measurement, each in one unit of measurement."""
        return tuple(each for each in self.of_unit if not (each.is_also or each.is_optional))

    @property
    def shown(self) -> tuple[Quantity, ...]:
        """Quantities for a display: the main ones, and those of fitted sensors, places and points."""
        of = tuple(each for each in self.of_unit if each.is_from_sensor or each.place or each.point)
        return self.main + of

    @property
    def has_places(self) -> bool:
        """Whether they are those of a row, in which each target is measured independently."""
        return any(quantity.place for quantity in self.of_unit)

    def with_sensor(self, key: str) -> Quantities:
        """Return the quantities of a unit with a sensor for the quantity ``key``, including its sigma."""
        of_unit = tuple(
            replace(each, has_sigma=True, is_from_sensor=True) if each.key == key else each
            for each in self.of_unit
        )
        return replace(self, of_unit=of_unit, joint=(*self.joint, f"{key.removesuffix('_deg')}_mm_per_m"))


@dataclass(frozen=True, slots=True)
class Value:
    """Value of a quantity with its combined standard uncertainty (1 sigma); None: it has none of its own.

    ``sigma_random`` is the random part of ``sigma``, which varies with place and time; the rest is common to
    all measurements with one calibration. None: all of it is random.
    """

    value: float
    sigma: float | None = None
    sigma_random: float | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding about a solved measurement: faults, and values of other sensors.

    ``withdraws``: the measurement loses its numbers, and these faults come first in its status, else last.
    """

    faults: tuple[Fault, ...] = ()
    withdraws: bool = False
    from_sensors: Mapping[str, SensorValue] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The result of one window of exposures.

    ``sequence`` is that of the window's last exposure, ``t_ns`` the middle of the averaged exposures and
    ``time`` the same instant in UTC (None if the source of the frames does not provide it). ``values``
    contains the known values of ``quantities`` by their keys. It is empty if the measurement is invalid;
    ``status`` then contains at least one reason that is not a warning. ``targets`` contains the values of
    each target of the unit, None if not known. ``last_exposure_ns`` is the time of the window's last
    exposure; None: ``t_ns`` is. ``motions`` contains the motion of the quantities with a sigma, by their
    keys; empty if not known. ``joint`` is the joint uncertainty of ``values``, None if not known;
    ``linear`` is how others depend on them, by key. ``cross_check`` is the result by the second maps.
    ``from_sensors`` contains other sensors' values of quantities, each at its own time. They do not affect
    ``valid`` and remain when the beam is lost.
    """

    sequence: int
    t_ns: int
    time: datetime | None
    frames: int
    quantities: Quantities
    values: Mapping[str, Value]
    targets: Mapping[str, Mapping[str, Value] | None]
    status: tuple[Fault, ...] = ()
    last_exposure_ns: int | None = None
    motions: Mapping[str, Motion] = field(default_factory=dict)
    from_sensors: Mapping[str, SensorValue] = field(default_factory=dict)
    joint: Joint | None = field(default=None, compare=False)
    linear: Mapping[str, Linear] = field(default_factory=dict, compare=False)
    cross_check: CrossCheckedBeam | None = field(default=None, compare=False)

    @property
    def light_ns(self) -> int:
        """Time of the newest exposure in this measurement, ns."""
        return self.t_ns if self.last_exposure_ns is None else self.last_exposure_ns

    def without_numbers(self, status: tuple[Fault, ...]) -> Measurement:
        """Return the measurement of the same moment, invalid for these reasons."""
        none = dict.fromkeys(self.targets)
        return replace(
            self, values={}, targets=none, status=status, motions={}, joint=None, linear={}, cross_check=None
        )

    def with_findings(self, *findings: Finding | None) -> Measurement:
        """Return the finished measurement: with all that is found about it; later only its age changes it."""
        status, from_sensors, is_withdrawn = self.status, dict(self.from_sensors), False
        for finding in filter(None, findings):
            status = (*finding.faults, *status) if finding.withdraws else (*status, *finding.faults)
            from_sensors |= finding.from_sensors
            is_withdrawn |= finding.withdraws
        if (status, from_sensors) == (self.status, self.from_sensors):
            return self
        whole = replace(self, status=status, from_sensors=from_sensors)
        return whole.without_numbers(status) if is_withdrawn else whole

    @property
    def valid(self) -> bool:
        """Whether the numbers may be used."""
        return bool(self.values)

    def with_sensors(self, from_sensors: Mapping[str, SensorValue]) -> Measurement:
        """Return the measurement with the sensors' present values, and a warning for each missing one."""
        others = tuple(fault for fault in self.status if fault.reason is not Reason.ROLL_MISSING)
        missing = [said.detail for said in from_sensors.values() if said.value is None]
        status = (*others, *(Fault(Reason.ROLL_MISSING, detail=detail) for detail in missing))
        return replace(self, from_sensors=from_sensors, status=status)

    def at(self, now_ns: int) -> Measurement:
        """Return the measurement at that moment: unchanged, or without sensor values that are too old."""
        now = {key: said.at(now_ns) for key, said in self.from_sensors.items()}
        return self if now == self.from_sensors else self.with_sensors(now)

    def known(self, key: str) -> Value | None:
        """Return a quantity of the unit, from whichever sensor; None: not known."""
        said = self.from_sensors.get(key)
        if said is None:
            return self.values.get(key)
        return None if said.value is None else Value(said.value, said.sigma)

    def known_of(self, key: str) -> Value | None:
        """Return a quantity of the unit, or the value ``TARGET.KEY`` of a target; None: not known."""
        target, _, of_target = key.rpartition(".")
        return (self.targets.get(target) or {}).get(of_target) if target else self.known(key)

    def number(self, key: str) -> float | None:
        """Return the value of a quantity; None: not known."""
        value = self.known(key)
        return None if value is None else value.value

    def sigma(self, key: str) -> float | None:
        """Return the combined standard uncertainty of a quantity; None: not known."""
        value = self.known(key)
        return None if value is None else value.sigma

    def sigma_random(self, key: str) -> float | None:
        """Return the random part of ``sigma``, all of it if it has no separate one; None: not known."""
        value = self.known(key)
        if value is None:
            return None
        return value.sigma if value.sigma_random is None else value.sigma_random

    @property
    def rates(self) -> Mapping[str, Value]:
        """Rates of the quantities, in their unit per second, by their keys."""
        return {key: Value(motion.rate, motion.sigma_rate) for key, motion in self.motions.items()}

    def sigma_at(self, key: str, age_s: float) -> float | None:
        """Return a quantity's standard deviation as a statement about the true value at ``age_s``.

        ``age_s`` counts from ``t_ns``; an earlier instant counts as ``t_ns``. None: not known, because the
        quantity has no sigma, or its motion has not been determined yet.
        """
        if key in self.linear:
            return self.linear[key].sigma(self.covariance(age_s))
        sigma, motion = self.sigma(key), self.motions.get(key)
        since = None if motion is None else motion.variance_since(max(age_s, 0.0))
        return None if sigma is None or since is None else math.sqrt(sigma**2 + since)

    def covariance(self, age_s: float | None = None) -> FloatArray | None:
        """Return the covariance (n, n) of ``quantities.joint``, in its units. NaN, None: not known.

        ``age_s`` is as in ``sigma_at``; without it, the covariance is that of the values at their own time.
        Roll is the reading of another sensor, whose errors are independent of the beam's.
        """
        of_beam = None if self.joint is None else self.joint.at(self.motions, age_s)
        if "roll_mm_per_m" not in self.quantities.joint:
            return of_beam
        size, of_roll = len(self.quantities.joint), self.known("roll_deg")
        covariance = np.full((size, size), np.nan)
        if of_beam is not None:
            covariance[: len(of_beam), : len(of_beam)] = of_beam
        if of_roll is not None and of_roll.sigma is not None:
            covariance[-1, :-1] = covariance[:-1, -1] = 0.0 * np.diag(covariance)[:-1]
            per_deg = 1000.0 * math.radians(1.0) / math.cos(math.radians(of_roll.value)) ** 2
            covariance[-1, -1] = (per_deg * of_roll.sigma) ** 2
        return None if np.isnan(covariance.diagonal()).all() else covariance


def utc_text(time: datetime) -> str:
    """Return ISO 8601 in UTC with milliseconds and ``Z``."""
    return time.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
