"""The measurement: values with their units and uncertainties, or the reasons why there are none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from altd.reasons import Reason
from altd.records.faults import Fault
from altd.records.sensors import SensorValue
from altd.records.spots import Motion


def counted(number: int, thing: str) -> str:
    """``1 frame``, ``2 frames``: the number and the thing, whose plural takes an s."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number that an instrument publishes.

    ``key`` names it in JSON and ends in the unit, ``label`` on screens; ``decimals`` are those of JSON, a
    person sees one less. ``has_sigma``: its standard deviation is published too. ``is_optional``: a valid
    measurement may be without it. ``is_also`` is the key of the quantity that this one is in another unit.
    ``is_from_sensor``: another sensor measures it, at its own times, whether or not the beam is seen.
    ``place`` is the target of a row whose place it tells of; its key begins with that name.
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


@dataclass(frozen=True, slots=True)
class Quantities:
    """The quantities that a kind of unit publishes: of the whole unit, and of each of its targets.

    ``has_motion``: the instrument estimates how fast they change.
    """

    instrument: str
    of_unit: tuple[Quantity, ...]
    of_target: tuple[Quantity, ...] = ()
    has_motion: bool = False

    @property
    def main(self) -> tuple[Quantity, ...]:
        """The quantities of the unit that every valid measurement has, each in one unit of measurement."""
        return tuple(each for each in self.of_unit if not (each.is_also or each.is_optional))

    @property
    def shown(self) -> tuple[Quantity, ...]:
        """The quantities for a display: the main ones, and those of fitted sensors and of places."""
        return self.main + tuple(each for each in self.of_unit if each.is_from_sensor or each.place)

    @property
    def has_places(self) -> bool:
        """Whether they are those of a row: each of its targets is measured, or not, on its own."""
        return any(quantity.place for quantity in self.of_unit)

    def with_sensor(self, key: str) -> Quantities:
        """The same of a unit that has a sensor for the quantity ``key``: it comes with its sigma."""
        of_unit = tuple(
            replace(each, has_sigma=True, is_from_sensor=True) if each.key == key else each
            for each in self.of_unit
        )
        return replace(self, of_unit=of_unit)


@dataclass(frozen=True, slots=True)
class Value:
    """A quantity's value with its combined standard uncertainty (1 sigma); None: it has none of its own.

    ``sigma_random`` is the part of ``sigma`` that scatters from place to place and from time to time; the
    rest is common to all measurements with one calibration. None: all of it scatters.
    """

    value: float
    sigma: float | None = None
    sigma_random: float | None = None


@dataclass(frozen=True, slots=True)
class Measurement:
    """The result of one window of exposures.

    ``sequence`` is that of the window's last exposure, ``t_ns`` the middle of the exposures that were
    averaged and ``time`` the same instant in UTC (None where the source of the frames does not know it).
    ``values`` holds the values of ``quantities`` by their keys, those that are known; it is empty when the
    measurement is invalid, and ``status`` then holds at least one reason that is not a warning. ``targets``
    holds the values of each target of the unit, None where not known.
    ``last_exposure_ns`` is the time of the window's last exposure; None: ``t_ns`` is. ``motions`` holds how
    the quantities that have a sigma move, by their keys; empty where that is not known.
    ``from_sensors`` holds what other sensors say of quantities, each at its own time: ``valid`` does not look
    at it, and it stays when the beam is lost.
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

    @property
    def light_ns(self) -> int:
        """When the newest light fell of which this tells."""
        return self.t_ns if self.last_exposure_ns is None else self.last_exposure_ns

    def without_numbers(self, status: tuple[Fault, ...]) -> Measurement:
        """The same moment, invalid for these reasons."""
        return replace(self, values={}, targets=dict.fromkeys(self.targets), status=status, motions={})

    def with_motion_in_sigma(self) -> Measurement | None:
        """The same, its sigmas those of the truth at ``t_ns`` itself, vibration included.

        None: how a quantity with a sigma moves is not known.
        """
        values = dict(self.values)
        for quantity in self.quantities.of_unit:
            value = values.get(quantity.key)
            if value is None or value.sigma is None:
                continue
            sigma = self.sigma_at(quantity.key, 0.0)
            if sigma is None:
                return None
            values[quantity.key] = Value(value.value, sigma)
        motions = {key: replace(motion, is_in_sigma=True) for key, motion in self.motions.items()}
        return replace(self, values=values, motions=motions)

    @property
    def valid(self) -> bool:
        """Whether the numbers may be used."""
        return bool(self.values)

    def with_sensors(self, from_sensors: Mapping[str, SensorValue]) -> Measurement:
        """The same with what sensors say now, and a warning where one says nothing."""
        others = tuple(fault for fault in self.status if fault.reason is not Reason.ROLL_MISSING)
        missing = [said.detail for said in from_sensors.values() if said.value is None]
        status = (*others, *(Fault(Reason.ROLL_MISSING, detail=detail) for detail in missing))
        return replace(self, from_sensors=from_sensors, status=status)

    def at(self, now_ns: int) -> Measurement:
        """The same at that moment: itself, or without what is too old of sensors by then."""
        now = {key: said.at(now_ns) for key, said in self.from_sensors.items()}
        return self if now == self.from_sensors else self.with_sensors(now)

    def known(self, key: str) -> Value | None:
        """A quantity of the unit, of whichever sensor; None: not known."""
        said = self.from_sensors.get(key)
        if said is None:
            return self.values.get(key)
        return None if said.value is None else Value(said.value, said.sigma)

    def known_of(self, key: str) -> Value | None:
        """The same, or the value ``TARGET.KEY`` of a target."""
        target, _, of_target = key.rpartition(".")
        return (self.targets.get(target) or {}).get(of_target) if target else self.known(key)

    def number(self, key: str) -> float | None:
        """The value of a quantity; None: not known."""
        value = self.known(key)
        return None if value is None else value.value

    def sigma(self, key: str) -> float | None:
        """The combined standard uncertainty of a quantity; None: not known."""
        value = self.known(key)
        return None if value is None else value.sigma

    def sigma_random(self, key: str) -> float | None:
        """The part of ``sigma`` that scatters; all of it where it has none. None: not known."""
        value = self.known(key)
        if value is None:
            return None
        return value.sigma if value.sigma_random is None else value.sigma_random

    @property
    def rates(self) -> Mapping[str, Value]:
        """Rates of the quantities, in their unit per second, by their keys."""
        return {key: Value(motion.rate, motion.sigma_rate) for key, motion in self.motions.items()}

    def sigma_at(self, key: str, age_s: float) -> float | None:
        """The standard deviation of a quantity as a statement about the truth ``age_s`` after ``t_ns``.

        None: not known, for it has no sigma, or the unit has not yet seen how it moves. An instant before
        ``t_ns`` counts as ``t_ns``.
        """
        sigma, motion = self.sigma(key), self.motions.get(key)
        since = None if motion is None else motion.variance_since(max(age_s, 0.0))
        return None if sigma is None or since is None else math.sqrt(sigma**2 + since)


def utc_text(time: datetime) -> str:
    """ISO 8601 in UTC with milliseconds and ``Z``."""
    return time.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
