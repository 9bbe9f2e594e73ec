"""Topics and payloads of the messages, and their pydantic models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, Self
from urllib.parse import quote

from pydantic import BaseModel, Field, create_model
from pydantic.json_schema import models_json_schema

from altd.reasons import Reason
from altd.records import Measurement, Quantities, Quantity, utc_text
from altd.status import models
from altd.status.answer import Answer
from altd.status.calibration_summary import CalibrationIdentity
from altd.status.cause import StateReport
from altd.status.measurement_json import measurement_model
from altd.status.unit import UnitView

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
        """Return the topics below ``beginning`` and the serial number, percent-encoded for topics."""
        return cls(*(f"{beginning}/{quote(serial, safe='')}/{name}" for name in cls.__slots__))


def birth_of(view: UnitView) -> dict[str, Any]:
    """Return the birth message: the identity of the unit, and what it publishes."""
    return {
        "time": _text(view.utc),
        "serial": view.facts.serial or None,
        "version": view.facts.version or None,
        **({"kind": view.facts.kind} if view.facts.kind else {}),
        "instrument": view.quantities.instrument,
        "calibration": view.calibration_identity.as_object(),
        "targets": [target.name for target in view.targets],
        "quantities": {
            quantity.key: {"label": quantity.label, "unit": quantity.unit, "meaning": quantity.meaning}
            for quantity in view.quantities.of_unit
        },
    }


def state_of(report: StateReport, utc: datetime | None) -> dict[str, Any]:
    """Return the state message: the state of the unit at the time of sending."""
    return {"time": _text(utc), **models.state_of(report).as_object()}


def summary_of(measurements: Sequence[Measurement], view: UnitView) -> dict[str, Any]:
    """Return the summary of ``measurements``; without any, statistics null and the present ``status``.

    The mean of a quantity covers the valid measurements, or those in which its own sensor knows it. ``sigma``
    is the root mean square of their sigmas: the uncertainty of one measurement, not their scatter.
    ``sigma_now`` is that of the last measurement as a statement about the truth at sending.
    """
    valid = sum(measurement.valid for measurement in measurements)
    shown = measurements or ([] if view.measurement is None else [view.measurement])
    codes = [str(fault) for measurement in shown for fault in measurement.status]
    first, last = (measurements[0], measurements[-1]) if measurements else (None, None)
    return {
        "time": _text(view.utc),
        "first": _instant(first),
        "last": _instant(last),
        "count": len(measurements),
        "valid_share": round(valid / len(measurements), 4) if measurements else None,
        "status": list(dict.fromkeys(codes)) if shown else [str(Reason.WARMING_UP)],
        **{
            quantity.key: _statistics(measurements, quantity, view.age_s)
            for quantity in view.quantities.shown
        },
    }


def _statistics(
    measurements: Sequence[Measurement], quantity: Quantity, age_s: float | None
) -> dict[str, float | None]:
    known = [value for each in measurements if (value := each.known(quantity.key)) is not None]
    if not known:
        return dict.fromkeys(("mean", "min", "max", "sigma", "sigma_now"))
    values = [value.value for value in known]
    sigmas = [value.sigma for value in known if value.sigma is not None]
    numbers = {
        "mean": math.fsum(values) / len(values),
        "min": min(values),
        "max": max(values),
        "sigma": math.hypot(*sigmas) / math.sqrt(len(sigmas)) if sigmas else None,
        "sigma_now": None if age_s is None else measurements[-1].sigma_at(quantity.key, age_s),
    }
    return {
        name: None if number is None else round(number, quantity.decimals) for name, number in numbers.items()
    }


def _instant(measurement: Measurement | None) -> dict[str, Any] | None:
    if measurement is None:
        return None
    time = measurement.time
    return {"sequence": measurement.sequence, "time": None if time is None else utc_text(time)}


def _text(utc: datetime | None) -> str | None:
    return None if utc is None else utc_text(utc)


class _Checked(Answer):
    """Keys that every JSON payload has."""

    time: str | None
    """Time of sending, UTC, ISO 8601."""
    unit: str | None
    """CRC-32 of the serial number, 8 hexadecimal digits."""
    session: str | None
    """Random number that is drawn at the start of the daemon, 8 hexadecimal digits."""
    message: int
    """Number of this message among the JSON messages of this interface."""
    published: int
    """Number of measurements since the start of the daemon."""
    clock_ms: int
    """Milliseconds since the start of the daemon."""
    age_s: float | None
    """Seconds from the middle of the exposures of the newest measurement to the sending."""
    crc32: str
    """CRC-32 of all bytes before `, "crc32":`, 8 hexadecimal digits."""


class Calibration(CalibrationIdentity):
    """The calibration in use."""


class PublishedQuantity(Answer):
    """A quantity that the unit publishes."""

    label: str
    unit: str
    meaning: str


class Birth(_Checked):
    """Identity of the unit; retained, sent at each connection."""

    serial: str | None
    version: str | None
    """Version of the program."""
    kind: Literal["desk"] | None = None
    """`desk`: a unit on a desk; absent: a machine's unit."""
    instrument: str
    """Kind of unit."""
    calibration: Calibration
    """Calibration in use: `created`, `checksum`, and whether it was made from `simulated` frames."""
    targets: list[str]
    """Names of the targets in beam order."""
    quantities: dict[str, PublishedQuantity]
    """`label`, `unit` and `meaning` of each quantity, by its key in the payloads."""


class State(models.UnitState, _Checked):
    """State of the unit in the signals of NAMUR NE 107; retained, sent when it changes and every 10 s."""


class Instant(Answer):
    """Number and time of a measurement."""

    sequence: int
    time: str | None
    """Middle of its exposures, UTC, ISO 8601."""


class Statistics(Answer):
    """A quantity over the valid measurements since the last summary; null: it was never known."""

    mean: float | None
    min: float | None
    max: float | None
    sigma: float | None
    """Combined standard uncertainty (1 sigma) of one measurement."""
    sigma_now: float | None
    """Sigma of the last measurement as a statement about the truth at sending; null: it is not known."""


class _Summary(_Checked):
    """Summary of the measurements since the last summary."""

    first: Instant | None
    """`sequence` and `time` of the first measurement; null: there was none."""
    last: Instant | None
    """`sequence` and `time` of the last measurement; null: there was none."""
    count: int
    """Number of measurements, valid or not."""
    valid_share: float | None
    """Share of valid measurements, 0 to 1; null: there was no measurement."""
    status: list[str]
    """Codes of all reasons and warnings."""


def summary_model(quantities: Quantities) -> type[_Summary]:
    """Return the summary model of a unit with these quantities."""
    fields: dict[str, Any] = {
        quantity.key: (Statistics, Field(description=f"{quantity.unit}: {quantity.meaning}"))
        for quantity in quantities.shown
    }
    return create_model("Summary", __base__=_Summary, __doc__=_Summary.__doc__, **fields)


def schema_of(quantities: Quantities) -> Mapping[str, Any]:
    """Return the JSON Schema of the payloads of a unit with these quantities, each an entry of ``$defs``.

    ``topics`` has the schema of each topic, by its last level.
    """
    by_topic: dict[str, type[BaseModel]] = {
        "birth": Birth,
        "state": State,
        "summary": summary_model(quantities),
        "measurement": measurement_model(quantities),
    }
    models = by_topic.values()
    _, schema = models_json_schema([(model, "serialization") for model in models])
    for definition in schema["$defs"].values():
        if definition.get("additionalProperties") is False:  # keys may be added in later versions
            del definition["additionalProperties"]
    topics = {topic: {"$ref": f"#/$defs/{model.__name__}"} for topic, model in by_topic.items()}
    root = {"$schema": "https://json-schema.org/draft/2020-12/schema", "anyOf": list(topics.values())}
    return {**root, "topics": topics, **schema}
