"""The JSON profile, with the unit as a device of Home Assistant.

Each message is created after the previous one was acknowledged.
"""

from __future__ import annotations

import asyncio
import json
import random
import ssl
from collections.abc import Callable, Mapping
from typing import Any

import aiomqtt

from altd.config import HttpSettings, MqttSettings
from altd.history.outbox import Outbox
from altd.publish.mqtt.broker import Broker, Login
from altd.publish.mqtt.connecting import BrokerPublisher
from altd.publish.mqtt.home_assistant import discovery_of, discovery_topic, page_url
from altd.publish.mqtt.limits import MessageTooLongError
from altd.publish.mqtt.messages import OFFLINE, ONLINE, Topics, birth_of, state_of, summary_of
from altd.publish.mqtt.outbox import OutboxSender
from altd.records import Measurement
from altd.status.health import Component, State
from altd.status.measurement_json import checked_line, with_proof
from altd.status.proof import Stamps
from altd.status.unit import PublishedUnit

NUMBERS_EXPIRY_S = 2
"""Time after which a broker drops a summary or a measurement that it could not deliver."""

RETAINED_EXPIRY_S = 30
REFRESH_INTERVAL_S = 10.0
"""Interval at which ``online`` and the state are repeated, or else expire: a broker may lose the will
in a crash, or send that of an older connection after the ``online`` of this one."""

DISCOVERY_EXPIRY_S = 3600
DISCOVERY_INTERVAL_S = 600.0
"""Interval at which the discovery message is repeated, or else expires: that of a unit that is no device of
Home Assistant any more must not stay with the broker."""


class MqttPublisher(BrokerPublisher[Broker]):
    """Publishes summaries or measurements, state and identity as JSON, each on its own topic."""

    def __init__(
        self,
        settings: MqttSettings,
        unit: PublishedUnit,
        component: Component,
        chance: random.Random,
        outbox: Outbox | None = None,
        http: Callable[[], HttpSettings | None] = lambda: None,
    ) -> None:
        """``http`` returns the present settings of the unit's page; None: it has none."""
        super().__init__(settings, unit, component, chance)
        self._http = http
        self._topics = Topics.of(settings.topic, self._serial)
        self._stamps = Stamps(unit.board, component.name)
        self._sender: OutboxSender | None = None
        if outbox is not None:
            topics = self._topics.outbox, self._topics.ack
            self._sender = OutboxSender(
                outbox, topics, self._serial, unit.health.component("outbox"), self._with_proof
            )
        elif settings.store_and_forward:
            unit.health.component("outbox").set_state(State.DEGRADED, "no history: seconds are not stored")
        self._unsummarised = unit.board.cursor()
        self._since_summary: list[Measurement] = []
        self._sent: Measurement | None = None
        self._sent_state: object = None
        self._refresh_ns = self._discovery_ns = 0

    def _connection(self, login: Login, tls: ssl.SSLContext | None) -> Broker:
        limits = self._limits
        topic = self._topics.availability
        will = aiomqtt.Will(topic, OFFLINE, qos=limits.max_qos, retain=limits.has_retain)
        return Broker(self._settings, self._identifier, will, login, tls, limits)

    def _with_proof(self, document: Mapping[str, Any]) -> str:
        return with_proof(document, self._board, self._stamps.next())

    async def _listen(self, broker: Broker) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._collect(), name="mqtt summary")
            if self._sender is not None:
                tasks.create_task(self._sender.run(broker), name="mqtt outbox")

    async def _collect(self) -> None:
        """Collect each measurement for the next summary; a connection without summaries ends in seconds."""
        self._since_summary.clear()
        while True:
            skipped = self._unsummarised.skipped
            self._since_summary.append(await self._unsummarised.next())
            self._component.count("measurements_not_summarised", self._unsummarised.skipped - skipped)

    async def _announce(self, broker: Broker) -> None:
        """Send the identity; ``online`` is last, so that a client that receives it has everything else."""
        birth = self._with_proof(birth_of(self._unit.view()))
        await self._send(broker, self._topics.birth, birth, expiry_s=None, retain=True)
        self._sent = None
        self._discovery_ns = 0
        await self._refresh(broker)

    async def _send_discovery(self, broker: Broker, prefix: str) -> None:
        self._discovery_ns = self._clock.monotonic_ns() + round(DISCOVERY_INTERVAL_S * 1e9)
        device = discovery_of(
            self._board.quantities,
            self._topics,
            self._identifier,
            self._serial,
            self._unit.facts.version,
            page=page_url(self._http(), broker.own_address),
            is_rehearsal=self._board.is_rehearsal,
            product=self._unit.facts.product,
        )
        config = discovery_topic(prefix, self._identifier)
        await self._send(broker, config, json.dumps(device), expiry_s=DISCOVERY_EXPIRY_S, retain=True)

    async def _refresh(self, broker: Broker) -> None:
        prefix = self._settings.home_assistant
        if prefix is not None and self._clock.monotonic_ns() >= self._discovery_ns:
            await self._send_discovery(broker, prefix)
        self._refresh_ns = self._clock.monotonic_ns() + round(REFRESH_INTERVAL_S * 1e9)
        self._sent_state = None
        await self._send_state(broker)
        await self._send(broker, self._topics.availability, ONLINE, expiry_s=RETAINED_EXPIRY_S, retain=True)

    async def _send(
        self, broker: Broker, topic: str, line: str, *, expiry_s: int | None, retain: bool = False
    ) -> bool:
        """Return whether a message was sent; one that is too long for the broker is reported instead."""
        try:
            await broker.send(topic, line, expiry_s=expiry_s, retain=retain)
        except MessageTooLongError as error:
            self._component.count("messages_too_long")
            if topic not in self._too_long:
                self._too_long[topic] = error.size
                self._report()
            return False
        return True

    async def _each_second(self, broker: Broker) -> None:
        """Send the state before the numbers, so that it is never better than they are."""
        if self._clock.monotonic_ns() >= self._refresh_ns:
            await self._refresh(broker)
        else:
            await self._send_state(broker)
        if self._settings.every_measurement:  # also one that became stale
            await self._send_measurement(broker)
        summary = summary_of(self._since_summary, self._unit.view())
        self._since_summary.clear()
        line = self._with_proof(summary)
        if await self._send(broker, self._topics.summary, line, expiry_s=NUMBERS_EXPIRY_S):
            self._has_sent()

    async def _send_measurement(self, broker: Broker) -> None:
        measurement = self._board.read()
        if measurement is None or measurement == self._sent:
            return
        self._sent = measurement
        line = checked_line(self._board, measurement, self._stamps.next())
        if await self._send(broker, self._topics.measurement, line, expiry_s=NUMBERS_EXPIRY_S):
            self._has_sent()

    async def _send_state(self, broker: Broker) -> None:
        """Send the state if it differs from the one sent last."""
        report = self._unit.state()
        if report is None:
            return
        causes = [(shown.cause.kind, shown.cause.of, shown.is_active) for shown in report.causes]
        if (state := (report.signal, causes)) == self._sent_state:
            return
        self._sent_state = state
        line = self._with_proof(state_of(report, self._clock.utc(self._clock.monotonic_ns())))
        await self._send(broker, self._topics.state, line, expiry_s=RETAINED_EXPIRY_S, retain=True)
