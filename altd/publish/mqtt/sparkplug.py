"""Sparkplug B 3.0: the metrics of a unit, their protobuf payload, and the one command that a unit accepts.

Names, numbers and types of the fields follow chapter 6.4 of the specification. Fields that the unit neither
writes nor reads are omitted; protobuf skips them. Metrics have names but no aliases: a host with the birth of
an older program could take the alias of one quantity for another.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import IntEnum
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from altd.ports import Clock
from altd.publish.mqtt.limits import BrokerError
from altd.reasons import NOT_FROM_CAMERAS, Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.cause import StateReport

NAMESPACE = "spBv1.0"
REBIRTH = "Node Control/Rebirth"


class Quality(IntEnum):
    """Codes of the property ``Quality``."""

    BAD = 0
    GOOD = 192
    STALE = 500


class Type(IntEnum):
    """Datatypes of metrics and properties."""

    INT32 = 3
    INT64 = 4
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12

    @property
    def of_value(self) -> str:
        """Name of the field for a value of this type."""
        return _VALUE_FIELDS[self]


_VALUE_FIELDS = {
    Type.INT32: "int_value",
    Type.INT64: "long_value",
    Type.DOUBLE: "double_value",
    Type.BOOLEAN: "boolean_value",
    Type.STRING: "string_value",
}

_MESSAGES = {
    "Payload": {"timestamp": (1, "uint64"), "metrics": (2, "Metric"), "seq": (3, "uint64")},
    "Metric": {
        "name": (1, "string"),
        "timestamp": (3, "uint64"),
        "datatype": (4, "uint32"),
        "is_historical": (5, "bool"),
        "is_null": (7, "bool"),
        "properties": (9, "PropertySet"),
        "int_value": (10, "uint32"),
        "long_value": (11, "uint64"),
        "double_value": (13, "double"),
        "boolean_value": (14, "bool"),
        "string_value": (15, "string"),
    },
    "PropertySet": {"keys": (1, "string"), "values": (2, "PropertyValue")},
    "PropertyValue": {"type": (1, "uint32"), "int_value": (3, "uint32"), "string_value": (8, "string")},
}
_REPEATED = {"metrics", "keys", "values"}


def _message_class() -> Any:
    file = FileDescriptorProto(name="altd/sparkplug", package="altd")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for key, (number, kind) in fields.items():
            label = "LABEL_REPEATED" if key in _REPEATED else "LABEL_OPTIONAL"
            added = message.field.add(name=key, number=number, label=FieldDescriptorProto.Label.Value(label))
            if kind in _MESSAGES:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".altd.{kind}"
            else:
                added.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("altd.Payload"))


Payload = _message_class()
"""The protobuf message ``Payload``."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A value with the UTC of its capture, ms since 1970; ``value`` None: not known.

    ``is_historical`` stops a host from showing it as the current value. ``about`` contains properties that a
    birth has besides the quality, such as the unit.
    """

    name: str
    type: Type
    value: float | str | None
    time_ms: int
    quality: Quality = Quality.GOOD
    is_historical: bool = False
    about: dict[str, str] = field(default_factory=dict)


def payload_of(metrics: Iterable[Metric], time_ms: int, seq: int | None, *, is_birth: bool) -> bytes:
    """Return the payload that is sent at ``time_ms``; ``seq`` None: without sequence number, as in NDEATH.

    Metrics are in the order of their times, each with its datatype and quality; a birth has all their
    properties. Data should have no datatypes (payloads-metric-datatype-not-req), but the npm decoder
    ``sparkplug-payload`` reads null without them.
    """
    payload = Payload(timestamp=time_ms, seq=seq)
    for each in sorted(metrics, key=lambda metric: metric.time_ms):
        metric = payload.metrics.add(name=each.name, timestamp=each.time_ms, datatype=each.type)
        if each.value is None:
            metric.is_null = True
        else:
            setattr(metric, each.type.of_value, each.value)
        if each.is_historical:
            metric.is_historical = True
        properties: dict[str, int | str] = {"Quality": int(each.quality)}
        if is_birth:
            properties |= each.about
        for key, value in properties.items():
            kind = Type.INT32 if isinstance(value, int) else Type.STRING
            metric.properties.keys.append(key)
            metric.properties.values.add(type=kind, **{kind.of_value: value})
    encoded: bytes = payload.SerializeToString()
    return encoded


def commands_in(payload: bytes) -> tuple[bool, int]:
    """Return whether an NCMD requests a rebirth, and the number of its commands that no unit accepts."""
    try:
        metrics = Payload.FromString(payload).metrics
    except DecodeError:
        return False, 1
    rebirths = sum(metric.name == REBIRTH and metric.boolean_value for metric in metrics)
    return rebirths > 0, len(metrics) - rebirths if metrics else 1


_NOT_LIVE = NOT_FROM_CAMERAS | {Reason.NOT_LIVE, Reason.REHEARSAL}


def identity_metrics(birth: Mapping[str, Any], now_ms: int) -> list[Metric]:
    """Return the properties of the unit as metrics, from its birth message in JSON."""
    unit = {key: birth[key] for key in ("serial", "version", "instrument")}
    unit |= {f"calibration_{key}": value for key, value in birth["calibration"].items()}
    return [
        Metric(
            f"Properties/{key}",
            Type.BOOLEAN if key == "calibration_simulated" else Type.STRING,
            value,
            now_ms,
            Quality.BAD if value is None else Quality.GOOD,
        )
        for key, value in unit.items()
    ]


def state_metrics(report: StateReport | None, now_ms: int) -> list[Metric]:
    """Return the NE 107 signal, and the codes of its causes, the worst first, as metrics."""
    signal = causes = None
    quality = Quality.BAD if report is None else Quality.GOOD
    if report is not None:
        signal, causes = str(report.signal), " ".join(str(shown.cause.kind) for shown in report.causes)
    return [
        Metric("State/signal", Type.STRING, signal, now_ms, quality),
        Metric("State/causes", Type.STRING, causes, now_ms, quality),
    ]


def measurement_metrics(measurement: Measurement | None, board: Board, clock: Clock) -> list[Metric]:
    """Return the metrics of ``measurement``; None: no measurement has been made yet.

    Only current measurements of this unit's cameras are good. Played, simulated and rehearsed values are
    historical and bad. Unknown values are null: stale if nothing is measured any more, otherwise bad.
    """
    now_ms = utc_ms(clock, clock.monotonic_ns())
    shown = measurement or Measurement(0, 0, None, 0, board.quantities, {}, {}, (Fault(Reason.WARMING_UP),))
    reasons = {fault.reason for fault in shown.status}
    is_live, is_stale = not reasons & _NOT_LIVE, Reason.STALE in reasons
    without = Quality.STALE if is_stale else Quality.BAD
    if measurement is None or is_stale:  # newer than the last values, which a host could keep otherwise
        captured_ms = now_ms
    else:
        captured_ms = utc_ms(clock, shown.t_ns) if shown.time is None else _ms(shown.time)

    def metric(name: str, kind: Type, value: float | str | None, time_ms: int = captured_ms) -> Metric:
        quality = without if value is None else Quality.GOOD if is_live else Quality.BAD
        return Metric(name, kind, value, time_ms, quality, is_historical=value is not None and not is_live)

    metrics = [
        metric("valid", Type.BOOLEAN, shown.valid),
        metric("status", Type.STRING, " ".join(map(str, shown.status))),
        metric("sequence", Type.INT64, None if measurement is None else shown.sequence),
    ]
    age_s = board.age_s()
    for quantity in board.quantities.shown:
        said, known = shown.from_sensors.get(quantity.key), shown.known(quantity.key)
        at_ms = captured_ms if said is None or said.value is None else utc_ms(clock, said.t_ns)
        about = {"engUnit": quantity.unit, "documentation": quantity.meaning}
        numbers = {quantity.key: None if known is None else known.value}
        if quantity.has_sigma:
            now = shown.sigma_at(quantity.key, age_s) if known is not None and age_s is not None else None
            numbers[f"sigma/{quantity.key}"] = None if known is None else known.sigma
            numbers[f"sigma_now/{quantity.key}"] = now
        for name, number in numbers.items():
            rounded = None if number is None else round(number, quantity.decimals)
            metrics.append(replace(metric(name, Type.DOUBLE, rounded, at_ms), about=about))
    return metrics


def utc_ms(clock: Clock, t_ns: int) -> int:
    """UTC of a monotonic time in ms since 1970; raises BrokerError if it is not known."""
    if (utc := clock.utc(t_ns)) is None:
        raise BrokerError("the unit does not know the UTC, which Sparkplug requires")
    return _ms(utc)


def _ms(utc: datetime) -> int:
    return round(utc.timestamp() * 1e3)
