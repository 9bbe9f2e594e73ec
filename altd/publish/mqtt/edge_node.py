"""Sparkplug B 3.0 profile: the unit as an edge node, its numbers as metrics of the node."""

from __future__ import annotations

import asyncio
import random
import ssl
from collections.abc import Sequence
from urllib.parse import quote

import aiomqtt

from altd.config import MqttSettings
from altd.publish.mqtt.broker import Broker, Login
from altd.publish.mqtt.connecting import BrokerPublisher
from altd.publish.mqtt.limits import Limits
from altd.publish.mqtt.messages import birth_of
from altd.publish.mqtt.sparkplug import (
    NAMESPACE,
    REBIRTH,
    Metric,
    Type,
    commands_in,
    identity_metrics,
    measurement_metrics,
    payload_of,
    state_metrics,
    utc_ms,
)
from altd.records import Measurement
from altd.status.health import Component
from altd.status.unit import PublishedUnit

REBIRTH_INTERVAL_S = 1.0
"""Minimum time between two births, however many are requested."""


class EdgeNodeSession(Broker):
    """A connection that sends data with QoS 0, as Sparkplug requires."""

    def __init__(
        self,
        settings: MqttSettings,
        identifier: str,
        will: aiomqtt.Will,
        login: Login = None,
        tls: ssl.SSLContext | None = None,
        limits: Limits | None = None,
    ) -> None:
        super().__init__(settings, identifier, will, login, tls, limits)
        self._is_born = False

    async def send_data(self, topic: str, payload: bytes) -> None:
        """Publish with QoS 0, and wait until the broker has read it; raises BrokerError."""
        self._is_born = True
        self.limits.check(topic, payload, 0)
        async with self._acknowledged():
            await self.publish(topic, payload)
            await self._ping()

    async def check(self) -> None:
        """Wait for the broker's answer to a ping; raises BrokerError."""
        async with self._acknowledged():
            await self._ping()

    async def _leave(self) -> None:
        """Send NDEATH after a birth, and no DISCONNECT, so that the broker sends the will in any case."""
        if self._is_born:
            will = self._will
            await self.publish(will.topic, will.payload, will.qos, will.retain)


class EdgeNodePublisher(BrokerPublisher[EdgeNodeSession]):
    """Publishes births, deaths and data; accepts only the command to send the birth again."""

    def __init__(
        self,
        settings: MqttSettings,
        unit: PublishedUnit,
        component: Component,
        chance: random.Random,
    ) -> None:
        super().__init__(settings, unit, component, chance)
        assert settings.sparkplug is not None  # noqa: S101  its presence selects this profile
        self._group = settings.sparkplug.group
        self._node = settings.sparkplug.node or quote(self._serial, safe="")
        self._session: EdgeNodeSession | None = None
        self._bd_seq = 0
        self._seq = 0
        self._sending = asyncio.Lock()
        self._rebirth = asyncio.Event()
        self._born_ns: int | None = None
        self._sent: Measurement | None = None
        self._sent_state: list[object] = []

    def _topic(self, kind: str) -> str:
        return f"{NAMESPACE}/{self._group}/{kind}/{self._node}"

    def _connection(self, login: Login, tls: ssl.SSLContext | None) -> EdgeNodeSession:
        """Return a connection; the number of its NDEATH and births is one higher after each CONNECT.

        The number begins at 0 with the daemon: a broker ends the older connection of a client, with its
        will, before it answers the new one (MQTT 5, 3.1.4). No NDEATH of an earlier daemon follows a birth.
        """
        if self._session is not None and self._session.has_sent_connect:
            self._bd_seq = (self._bd_seq + 1) % 256
        now_ms = self._now_ms()
        payload = payload_of([self._bd_seq_metric(now_ms)], now_ms, None, is_birth=True)
        will = aiomqtt.Will(self._topic("NDEATH"), payload, qos=1, retain=False)
        self._session = EdgeNodeSession(self._settings, self._identifier, will, login, tls, self._limits)
        return self._session

    def _bd_seq_metric(self, now_ms: int) -> Metric:
        return Metric("bdSeq", Type.INT64, self._bd_seq, now_ms)

    async def _announce(self, broker: EdgeNodeSession) -> None:
        await broker.subscribe_to(self._topic("NCMD"), self._take_command)
        async with self._sending:
            await self._send_birth(broker)

    def _take_command(self, payload: bytes, is_retained: bool) -> None:
        """Handle a command; refuse a retained one, which would be repeated with each connection."""
        is_rebirth, refused = (False, 1) if is_retained else commands_in(payload)
        self._component.count("commands_refused", refused)
        if is_rebirth:
            self._component.count("rebirths_requested")
            self._rebirth.set()

    async def _listen(self, broker: EdgeNodeSession) -> None:
        """Send requested births. Between request and birth no data is sent."""
        while True:
            await self._rebirth.wait()
            async with self._sending:
                if self._born_ns is not None:
                    passed_s = (self._clock.monotonic_ns() - self._born_ns) * 1e-9
                    await self._clock.sleep(max(REBIRTH_INTERVAL_S - passed_s, 0.0))
                await self._send_birth(broker)

    async def _send_birth(self, broker: EdgeNodeSession) -> None:
        self._rebirth.clear()
        self._born_ns, self._seq = self._clock.monotonic_ns(), 0
        now_ms = self._now_ms()
        identity = identity_metrics(birth_of(self._unit.view()), now_ms)
        self._sent, self._sent_state = None, []
        metrics = [
            self._bd_seq_metric(now_ms),
            Metric(REBIRTH, Type.BOOLEAN, False, now_ms),
            *identity,
            *self._new_state(now_ms),
            *(self._new_measurement() or measurement_metrics(None, self._board, self._clock)),
        ]
        await self._send(broker, "NBIRTH", metrics)

    async def _each_second(self, broker: EdgeNodeSession) -> None:
        async with self._sending:
            if self._rebirth.is_set():
                return
            metrics = [*self._new_state(self._now_ms()), *self._new_measurement()]
            if metrics:
                await self._send(broker, "NDATA", metrics)
            else:
                await broker.check()

    async def _send_measurement(self, broker: EdgeNodeSession) -> None:
        async with self._sending:
            if not self._rebirth.is_set() and (metrics := self._new_measurement()):
                await self._send(broker, "NDATA", metrics)

    def _new_state(self, now_ms: int) -> list[Metric]:
        """Metrics of the state; empty if all values equal the ones sent last."""
        metrics = state_metrics(self._unit.state(), now_ms)
        values: list[object] = [each.value for each in metrics]
        before, self._sent_state = self._sent_state, values
        return [] if before == values else metrics

    def _new_measurement(self) -> list[Metric]:
        """All metrics of the measurement, also if it became stale; empty if it equals the one sent last."""
        shown = self._board.read()
        before, self._sent = self._sent, shown
        return [] if before == shown else measurement_metrics(shown, self._board, self._clock)

    async def _send(self, broker: EdgeNodeSession, kind: str, metrics: Sequence[Metric]) -> None:
        is_birth = kind == "NBIRTH"
        payload = payload_of(metrics, self._now_ms(), self._seq, is_birth=is_birth)
        self._seq = (self._seq + 1) % 256
        await broker.send_data(self._topic(kind), payload)
        self._has_sent()

    def _now_ms(self) -> int:
        return utc_ms(self._clock, self._clock.monotonic_ns())
