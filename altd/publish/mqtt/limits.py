"""Limits of a broker, and one sentence for each reason of a refusal."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from dataclasses import dataclass

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.properties import Properties, VariableByteIntegers
from paho.mqtt.reasoncodes import ReasonCode

NO_MQTT = "the broker sent data that is not MQTT"
NO_RETAIN = "the broker keeps no retained messages"
ONLY_QOS_0 = "the broker supports only QoS 0"
_RETAIN_REFUSED, _QOS_REFUSED = 0x9A, 0x9B

_SENTENCES = {
    0x82: NO_MQTT,
    0x8D: "the broker is silent",
    0x8E: "another client uses this identifier; check the serial numbers of all units",
    0x95: "the broker accepts only shorter messages",
    _RETAIN_REFUSED: NO_RETAIN,
    _QOS_REFUSED: ONLY_QOS_0,
}
"""Sentence for a reason code of MQTT 5 (table 2.6) that has a cause of its own."""

_LOGIN = {0x86, 0x87, 0x8C}
"""Reason codes of a refused login."""


class BrokerError(OSError):
    """The connection could not be made, or was lost; the message gives the reason."""


class MessageTooLongError(BrokerError):
    """A message of ``size`` bytes is longer than the broker accepts, and was not sent."""

    def __init__(self, sentence: str, size: int) -> None:
        super().__init__(sentence)
        self.size = size


@dataclass(slots=True)
class Limits:
    """Limits of the broker, from its last CONNACK: also from a refusal, for the next connection."""

    max_qos: int = 1
    has_retain: bool = True
    max_packet_bytes: int | None = None

    def take(self, reason: ReasonCode, properties: Properties | None) -> None:
        """Take the limits of a CONNACK (MQTT 5, 3.2.2.3); an absent property is no limit."""
        if reason.value in (_RETAIN_REFUSED, _QOS_REFUSED):
            self.has_retain = self.has_retain and reason.value != _RETAIN_REFUSED
            self.max_qos = 0 if reason.value == _QOS_REFUSED else self.max_qos
        elif not reason.is_failure:
            self.max_qos = min(getattr(properties, "MaximumQoS", 1), 1)
            self.has_retain = bool(getattr(properties, "RetainAvailable", 1))
            self.max_packet_bytes = getattr(properties, "MaximumPacketSize", None)

    def check(self, topic: str, payload: bytes, qos: int, properties: Properties | None = None) -> None:
        """Raise MessageTooLongError for a PUBLISH packet that is longer than the broker accepts."""
        packed = 1 if properties is None else len(properties.pack())  # type: ignore[no-untyped-call]
        size = 2 + len(topic.encode()) + (2 if qos else 0) + packed + len(payload)
        size += 1 + len(VariableByteIntegers.encode(size))  # type: ignore[no-untyped-call]
        if self.max_packet_bytes is not None and size > self.max_packet_bytes:
            raise MessageTooLongError(self.not_sent({topic: size}), size)

    def not_sent(self, sizes: Mapping[str, int]) -> str:
        """Return the sentence for messages that are too long, by topic, bytes."""
        topics = ", ".join(f"{topic} ({size})" for topic, size in sizes.items())
        return f"the broker accepts only {self.max_packet_bytes} bytes in a message; not sent: {topics}"

    @property
    def sentences(self) -> list[str]:
        """Sentences for what the broker cannot do."""
        return [*([] if self.has_retain else [NO_RETAIN]), *([] if self.max_qos else [ONLY_QOS_0])]


def why_ended(reason: ReasonCode, *, is_by_server: bool, was_connected: bool) -> str:
    """Return the reason of a lost connection; ``is_by_server``: the broker has sent it in DISCONNECT.

    Some brokers, as mosquitto 2.0.11, do not say that another client has taken the identifier.
    """
    other = "the broker closed the connection"
    if is_by_server:
        other = f"the broker ended the connection: {reason}"
    elif was_connected:
        other += "; if this continues, check whether another client uses this identifier"
    else:
        other += " before it answered; check TLS, certificate and how many connections and files it may have"
    return _SENTENCES.get(reason.value, other)


def why_not_taken(reason: ReasonCode) -> str:
    """Return the reason of a message that the broker refuses."""
    return _SENTENCES.get(reason.value, f"the broker refuses a message: {reason}")


def why_refused(error: OSError | aiomqtt.MqttError) -> str:
    """Return the reason of a failed connection."""
    if isinstance(error, MqttConnectError):
        code = error.rc.value if isinstance(error.rc, ReasonCode) else error.rc
        hint = "; see user name, password and certificate" if code in _LOGIN else ""
        return _SENTENCES.get(code or 0, f"the broker refuses the unit: {error.rc}{hint}")
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the broker's certificate is refused: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        return f"no TLS with the broker: {(error.reason or str(error)).replace('_', ' ').lower()}"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"no answer of an MQTT 5 broker: {error}"
