"""Publishes to one broker. Each message is made after the one before it was acknowledged."""

from __future__ import annotations

import asyncio
import json
import random
import ssl
from collections.abc import Callable

import aiomqtt

from altd.config import MqttSettings
from altd.credentials.certificates import client_context
from altd.credentials.file import load_login
from altd.errors import BadInputError, unwrap_group
from altd.publish.mqtt import home_assistant
from altd.publish.mqtt.broker import Broker, BrokerError
from altd.publish.mqtt.messages import OFFLINE, ONLINE, Topics, birth_of, state_of, summary_of
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.measurement_json import checked_line, with_proof
from altd.status.proof import Stamps

SUMMARY_INTERVAL_S = 1.0
"""Home Assistant wants no more."""

NUMBERS_EXPIRY_S = 2
"""A broker that could not deliver a summary or a measurement for so long drops it."""

RETAINED_EXPIRY_S = 30
REFRESH_INTERVAL_S = 10.0
"""``online`` and the state are sent again so often, and expire where the unit does not: a broker may lose the
will in a crash, or send that of an older connection behind the ``online`` of this one."""

MAX_JITTER_S = 2.0
"""Before each further try, beside the growing back-off of supervision: when a broker restarts, its units do
not come all at once."""


class MqttPublisher:
    """Publishes summaries or measurements, state and identity while a broker takes them.

    Nothing is queued: what could not be sent is left out, and counted. Raises BadInputError for credentials
    or certificates that cannot be used.
    """

    def __init__(
        self,
        settings: MqttSettings,
        board: Board,
        health: Health,
        component: Component,
        chance: random.Random,
    ) -> None:
        self._settings = settings
        self._board = board
        self._health = health
        self._component = component
        self._clock = component.clock
        self._chance = chance
        self._serial = health.facts.get("serial", "")
        self._topics = Topics.of(settings.topic, self._serial)
        self._identifier = f"altd_{board.identity.unit or 0:08x}"
        self._stamps = Stamps(board)
        self._unsummarised = board.cursor()
        self._unsent = board.cursor()
        self._since_summary: list[Measurement] = []
        self._told: Measurement | None = None
        self._told_state: object = None
        self._refresh_ns = 0
        self._tries = 0
        self._secrets()

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve one connection until cancelled; raises BrokerError when there is none, or it was lost."""
        if self._tries:
            await self._clock.sleep(self._chance.uniform(0.0, MAX_JITTER_S))
        self._tries += 1
        try:
            login, tls = self._secrets()
        except BadInputError as error:  # a file was changed since the start
            raise BrokerError(str(error)) from error
        settings = self._settings
        will = aiomqtt.Will(self._topics.availability, OFFLINE, qos=1, retain=True)
        async with Broker(
            settings.host, settings.port_or_default, self._identifier, will, login, tls
        ) as broker:
            try:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(broker.lost(), name="mqtt connection")
                    tasks.create_task(self._collect(), name="mqtt measurements")
                    await self._introduce(broker)
                    ready()
                    self._component.set_state(State.OK, "connected" if tls else "connected, without TLS")
                    await self._publish(broker)
            except BaseExceptionGroup as group:
                lost = unwrap_group(group, BrokerError)
                if lost is None:
                    raise
                raise lost from None

    def _secrets(self) -> tuple[tuple[str, str] | None, ssl.SSLContext | None]:
        settings = self._settings
        login = None if settings.credentials is None else load_login(settings.credentials)
        if settings.ca is None:
            return login, None
        return login, client_context(settings.ca, settings.certificate, settings.key)

    async def _collect(self) -> None:
        """Take each measurement for the next summary. A connection without summaries ends in seconds."""
        self._since_summary.clear()
        while True:
            skipped = self._unsummarised.skipped
            self._since_summary.append(await self._unsummarised.next())
            self._component.count("measurements_not_summarised", self._unsummarised.skipped - skipped)

    async def _introduce(self, broker: Broker) -> None:
        """Say who this is; ``online`` comes last, so that a client that sees it has all the rest."""
        topics, version = self._topics, self._health.facts.get("version", "")
        birth = with_proof(birth_of(self._board, self._health, self._clock), self._board, self._stamps.next())
        await broker.send(topics.birth, birth, expiry_s=None, retain=True)
        if (prefix := self._settings.home_assistant) is not None:
            device = home_assistant.device_of(
                self._board.quantities, topics, self._identifier, self._serial, version
            )
            config = home_assistant.topic_of(prefix, self._identifier)
            await broker.send(config, json.dumps(device), expiry_s=None, retain=True)
        self._told = None
        await self._refresh(broker)

    async def _refresh(self, broker: Broker) -> None:
        self._refresh_ns = self._clock.monotonic_ns() + round(REFRESH_INTERVAL_S * 1e9)
        self._told_state = None
        await self._send_state(broker)
        await broker.send(self._topics.availability, ONLINE, expiry_s=RETAINED_EXPIRY_S, retain=True)

    async def _publish(self, broker: Broker) -> None:
        """One message after the other; time that was lost is not made up by a burst."""
        due_ns = self._clock.monotonic_ns() + round(SUMMARY_INTERVAL_S * 1e9)
        while True:
            left_s = (due_ns - self._clock.monotonic_ns()) * 1e-9
            if left_s <= 0:
                due_ns = max(due_ns + round(SUMMARY_INTERVAL_S * 1e9), self._clock.monotonic_ns())
                await self._each_second(broker)
            elif self._settings.every_measurement:
                await self._send_next(broker, left_s)
            else:
                await self._clock.sleep(left_s)

    async def _each_second(self, broker: Broker) -> None:
        """The state before the numbers: it is never better than they are."""
        if self._clock.monotonic_ns() >= self._refresh_ns:
            await self._refresh(broker)
        else:
            await self._send_state(broker)
        if self._settings.every_measurement:  # one that has gone stale, too
            await self._send_measurement(broker, self._board.read())
        summary = summary_of(self._since_summary, self._board, self._clock)
        self._since_summary.clear()
        line = with_proof(summary, self._board, self._stamps.next())
        await broker.send(self._topics.summary, line, expiry_s=NUMBERS_EXPIRY_S)
        self._component.count("messages_sent")
        self._component.gave_data()

    async def _send_next(self, broker: Broker, timeout_s: float) -> None:
        """Wait for a measurement and send it; those that the broker was too slow for are counted."""
        skipped = self._unsent.skipped
        try:
            async with asyncio.timeout(timeout_s):
                measurement = await self._unsent.next()
        except TimeoutError:
            return
        self._component.count("measurements_skipped", self._unsent.skipped - skipped)
        await self._send_measurement(broker, measurement)

    async def _send_measurement(self, broker: Broker, measurement: Measurement | None) -> None:
        if measurement is None or measurement == self._told:
            return
        self._told = measurement
        line = checked_line(self._board, measurement, self._stamps.next())
        await broker.send(self._topics.measurement, line, expiry_s=NUMBERS_EXPIRY_S)
        self._component.count("messages_sent")
        self._component.gave_data()

    async def _send_state(self, broker: Broker) -> None:
        """The state where it is another one than was sent last."""
        report = self._health.state()
        if report is None:
            return
        causes = [(shown.cause.kind, shown.cause.of, shown.is_active) for shown in report.causes]
        if (state := (report.signal, causes)) == self._told_state:
            return
        self._told_state = state
        line = with_proof(state_of(report, self._clock), self._board, self._stamps.next())
        await broker.send(self._topics.state, line, expiry_s=RETAINED_EXPIRY_S, retain=True)
