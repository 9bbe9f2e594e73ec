"""The payload of Sparkplug B 3.0: metrics as protobuf, and the one command that a unit takes.

Names, numbers and types of the fields are those of chapter 6.4 of the specification. Fields that the unit
neither writes nor reads are left out, and protobuf skips them. Metrics have names and no aliases: a host that
has the birth of an older program could take the alias of one quantity for another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

NAMESPACE = "spBv1.0"
REBIRTH = "Node Control/Rebirth"


class Quality(IntEnum):
    """The codes of the property ``Quality``."""

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
        """The field that holds a value of this type."""
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
    """A value with the UTC of its capture, ms since 1970; None: it is not known.

    ``is_historical`` keeps a host from showing it as the present value. ``about`` are properties that a birth
    has beside the quality, such as the unit.
    """

    name: str
    type: Type
    value: float | str | None
    time_ms: int
    quality: Quality = Quality.GOOD
    is_historical: bool = False
    about: dict[str, str] = field(default_factory=dict)


def payload_of(metrics: Iterable[Metric], time_ms: int, seq: int | None, *, is_birth: bool) -> bytes:
    """The payload that is sent at ``time_ms``; None: it has no sequence number, as NDEATH.

    Metrics come in the order of their times, each with its datatype and its quality; a birth has all their
    properties. Data should not have datatypes (payloads-metric-datatype-not-req), but the decoder of npm,
    ``sparkplug-payload``, reads null without them.
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
    """Whether an NCMD asks for a rebirth, and how many commands it has that no unit takes."""
    try:
        metrics = Payload.FromString(payload).metrics
    except DecodeError:
        return False, 1
    rebirths = sum(metric.name == REBIRTH and metric.boolean_value for metric in metrics)
    return rebirths > 0, len(metrics) - rebirths if metrics else 1
