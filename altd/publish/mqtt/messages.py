"""Messages: topics, payloads, and their shape as pydantic models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self
from urllib.parse import quote

from pydantic import Field, create_model
from pydantic.json_schema import models_json_schema

from altd.ports import Clock
from altd.reasons import Reason
from altd.records import Measurement, Quantities, Quantity, utc_text
from altd.status.board import Board
from altd.status.cause import StateReport
from altd.status.health import Health
from altd.status.models import Answer, UnitState, measurement_model

ONLINE, OFFLINE = "online", "offline"


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one unit."""

    availability: str
    birth: str
    state: str
    summary: str
    measurement: str
    outbox: str
    ack: str

    @classmethod
    def of(cls, beginning: str, serial: str) -> Self:
        """Below ``beginning`` and the serial number, in which what no topic may hold is percent-encoded."""
        return cls(*(f"{beginning}/{quote(serial, safe='')}/{name}" for name in cls.__slots__))


def birth_of(board: Board, health: Health, clock: Clock) -> dict[str, Any]:
    """Which unit this is, and what it publishes."""
    calibration = health.calibration.summary
    file = calibration.get("file", {})
    return {
        "time": _now(clock),
        "serial": health.facts.get("serial"),
        "version": health.facts.get("version"),
        "instrument": board.quantities.instrument,
        "calibration": {
            "created": calibration.get("created"),
            "checksum": file.get("checksum"),
            "simulated": calibration.get("simulated"),
        },
        "targets": [target.name for target in health.targets],
        "quantities": {
            quantity.key: {"label": quantity.label, "unit": quantity.unit, "meaning": quantity.meaning}
            for quantity in board.quantities.of_unit
        },
    }


def state_of(report: StateReport, clock: Clock) -> dict[str, Any]:
    """The unit's state when it is sent."""
    return {"time": _now(clock), **report.as_object()}


def summary_of(measurements: Sequence[Measurement], board: Board, clock: Clock) -> dict[str, Any]:
    """The measurements since the last summary; none: all numbers are null, and ``status`` is the board's.

    The mean of a quantity is that of the valid measurements, or of those in which its own sensor knows it;
    ``sigma`` is the root of the mean of their variances: the uncertainty of one of them, not their scatter.
    """
    valid = sum(measurement.valid for measurement in measurements)
    shown = measurements or [now for now in (board.read(),) if now is not None]
    codes = [str(fault) for measurement in shown for fault in measurement.status]
    first, last = (measurements[0], measurements[-1]) if measurements else (None, None)
    return {
        "time": _now(clock),
        "first": _instant(first),
        "last": _instant(last),
        "count": len(measurements),
        "valid_share": round(valid / len(measurements), 4) if measurements else None,
        "status": list(dict.fromkeys(codes)) if shown else [str(Reason.WARMING_UP)],
        **{quantity.key: _statistics(measurements, quantity) for quantity in board.quantities.shown},
    }


def _statistics(measurements: Sequence[Measurement], quantity: Quantity) -> dict[str, float | None]:
    known = [value for each in measurements if (value := each.known(quantity.key)) is not None]
    if not known:
        return dict.fromkeys(("mean", "min", "max", "sigma"))
    values = [value.value for value in known]
    sigmas = [value.sigma for value in known if value.sigma is not None]
    numbers = {
        "mean": math.fsum(values) / len(values),
        "min": min(values),
        "max": max(values),
        "sigma": math.hypot(*sigmas) / math.sqrt(len(sigmas)) if sigmas else None,
    }
    return {
        name: None if number is None else round(number, quantity.decimals) for name, number in numbers.items()
    }


def _instant(measurement: Measurement | None) -> dict[str, Any] | None:
    if measurement is None:
        return None
    time = measurement.time
    return {"sequence": measurement.sequence, "time": None if time is None else utc_text(time)}


def _now(clock: Clock) -> str | None:
    utc = clock.utc(clock.monotonic_ns())
    return None if utc is None else utc_text(utc)


class _Checked(Answer):
    """The values of the keys of every payload in JSON."""

    time: str | None
    """UTC, ISO 8601, when it was sent."""
    unit: str | None
    """CRC-32 of the serial number, 8 hexadecimal digits."""
    session: str | None
    """Drawn by chance at the start of the daemon."""
    message: int
    """Counts the messages in JSON of this interface."""
    published: int
    """Measurements since the start of the daemon."""
    clock_ms: int
    """Milliseconds since the start of the daemon."""
    age_s: float | None
    """Seconds from the middle of the exposures of the newest measurement until it was sent."""
    crc32: str
    """Of all bytes before `, "crc32":`."""


class Calibration(Answer):
    """The calibration that is measured with."""

    created: str | None
    checksum: str | None
    simulated: bool | None
    """Whether it was made of simulated frames."""


class PublishedQuantity(Answer):
    """One number that the unit publishes."""

    label: str
    unit: str
    meaning: str


class Birth(_Checked):
    """Which unit this is; retained, sent at each connection."""

    serial: str | None
    version: str | None
    """Of the program."""
    instrument: str
    """The kind of unit."""
    calibration: Calibration
    """`created`, `checksum`, and whether it was made of `simulated` frames."""
    targets: list[str]
    """In beam order."""
    quantities: dict[str, PublishedQuantity]
    """`label`, `unit` and `meaning` by the keys of the payloads."""


class State(UnitState, _Checked):
    """The unit's state in the signals of NAMUR NE 107; retained, sent when it changes."""


class Instant(Answer):
    """A measurement."""

    sequence: int
    time: str | None
    """UTC, ISO 8601, of the middle of its exposures."""


class Statistics(Answer):
    """A quantity in the valid measurements since the last summary; null: it was never known."""

    mean: float | None
    min: float | None
    max: float | None
    sigma: float | None
    """The combined standard uncertainty (1 sigma) of one measurement."""


class _Summary(_Checked):
    """The measurements since the last summary."""

    first: Instant | None
    """`sequence` and `time` of the first measurement; null: there was none."""
    last: Instant | None
    """The same of the last one."""
    count: int
    """Measurements, valid or not."""
    valid_share: float | None
    """The share of valid measurements; null: there was no measurement."""
    status: list[str]
    """The codes of all reasons and warnings."""


def summary_model(quantities: Quantities) -> type[_Summary]:
    """The summary of a unit with these quantities."""
    fields: dict[str, Any] = {
        quantity.key: (Statistics, Field(description=f"{quantity.unit}: {quantity.meaning}"))
        for quantity in quantities.shown
    }
    return create_model("Summary", __base__=_Summary, __doc__=_Summary.__doc__, **fields)


def schema_of(quantities: Quantities) -> Mapping[str, Any]:
    """The JSON Schema of the payloads of a unit with these quantities, one of ``$defs`` each."""
    models = (Birth, State, summary_model(quantities), measurement_model(quantities))
    _, schema = models_json_schema([(model, "serialization") for model in models])
    for definition in schema["$defs"].values():
        if definition.get("additionalProperties") is False:  # keys may be added in later versions
            del definition["additionalProperties"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
