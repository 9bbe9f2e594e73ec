"""Where the values of registers come from: each function reads one of them out of a snapshot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from altd.publish.modbus.status import reason_code, status_word
from altd.records import Measurement
from altd.status.proof import Stamp

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one request is answered from: the board at one instant.

    ``age_s`` is None before the first measurement; ``published`` counts the measurements put up so far.
    ``stamp`` is None where the checked block is not read; ``state`` is the number of the unit's
    signal, None where nobody finds it out.
    """

    measurement: Measurement | None
    age_s: float | None
    published: int
    stamp: Stamp | None = None
    state: int | None = None


Reading = Callable[[Snapshot], float | None]
"""A value of a snapshot; None: not known."""


def status(snapshot: Snapshot) -> int:
    """The status word."""
    return status_word(snapshot.measurement)


def reason(target: str | None) -> Reading:
    """The code of the first reason that concerns a target; None: the whole unit."""
    return lambda snapshot: reason_code(snapshot.measurement, target)


def of_measurement(field: str) -> Reading:
    """A number that the measurement has as an attribute."""
    return lambda snapshot: getattr(snapshot.measurement, field, None)


def number(key: str) -> Reading:
    """The value of a quantity."""
    return lambda snapshot: snapshot.measurement.number(key) if snapshot.measurement else None


def sigma(key: str) -> Reading:
    """The standard deviation of a quantity."""
    return lambda snapshot: snapshot.measurement.sigma(key) if snapshot.measurement else None


def sigma_now(key: str) -> Reading:
    """The standard deviation of a quantity as a statement about the truth when it is read."""

    def sigma(snapshot: Snapshot) -> float | None:
        if snapshot.measurement is None or snapshot.age_s is None:
            return None
        return snapshot.measurement.sigma_at(key, snapshot.age_s)

    return sigma


def rate(key: str) -> Reading:
    """How fast a quantity changes, per second."""

    def value(snapshot: Snapshot) -> float | None:
        known = snapshot.measurement and snapshot.measurement.rates.get(key)
        return known.value if known else None

    return value


def of_target(target: str, key: str) -> Reading:
    """The value of a quantity on a target."""

    def coordinate(snapshot: Snapshot) -> float | None:
        values = (snapshot.measurement and snapshot.measurement.targets.get(target)) or {}
        return values[key].value if key in values else None

    return coordinate


def sequence(snapshot: Snapshot) -> int | None:
    """The number of the last exposure, which after 0xFFFFFFFE begins again at 0."""
    return snapshot.measurement.sequence % 0xFFFF_FFFF if snapshot.measurement else None


def age_ms(snapshot: Snapshot) -> float | None:
    """Milliseconds since the middle of the exposures."""
    return None if snapshot.age_s is None else 1000.0 * snapshot.age_s


def utc_s(snapshot: Snapshot) -> int | None:
    """Seconds since 1970 in UTC of the middle of the exposures."""
    ms = _utc_ms(snapshot)
    return None if ms is None else ms // 1000


def utc_rest_ms(snapshot: Snapshot) -> int | None:
    """The milliseconds that go with ``utc_s``."""
    ms = _utc_ms(snapshot)
    return None if ms is None else ms % 1000


def _utc_ms(snapshot: Snapshot) -> int | None:
    time = snapshot.measurement and snapshot.measurement.time
    return (time - _EPOCH) // timedelta(milliseconds=1) if time else None


def constant(value: float | None) -> Reading:
    """Always the same; None: never known."""
    return lambda _: value
