"""Common part of both MQTT profiles: one connection at a time, and one message in flight."""

from __future__ import annotations

import asyncio
import random
import ssl
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from altd.config import MqttSettings
from altd.credentials.certificates import client_context
from altd.credentials.file import load_login
from altd.errors import BadInputError, unwrap_group
from altd.publish.mqtt.broker import Broker, Login
from altd.publish.mqtt.limits import BrokerError, Limits
from altd.runtime.threads import SingleCall
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit

INTERVAL_S = 1.0
"""Interval of the summaries; Home Assistant needs no shorter one."""

MAX_JITTER_S = 2.0
"""Maximum random delay before each retry, in addition to the growing back-off of supervision: when a broker
restarts, its units do not reconnect all at once."""

Connection = TypeVar("Connection", bound=Broker)


class BrokerPublisher(ABC, Generic[Connection]):
    """Publishes to one broker while it accepts the messages; a subclass defines the profile.

    Nothing is queued: what could not be sent is dropped and counted. Raises BadInputError for credentials or
    certificates that cannot be used.
    """

    def __init__(
        self,
        settings: MqttSettings,
        unit: PublishedUnit,
        component: Component,
        chance: random.Random,
    ) -> None:
        self._settings = settings
        self._unit = unit
        self._board = unit.board
        self._component = component
        self._clock = component.clock
        self._chance = chance
        self._serial = unit.facts.serial
        self._identifier = f"altd_{unit.board.identity.unit or 0:08x}"
        self._unsent = unit.board.cursor()
        self._tries = 0
        self._connecting = SingleCall("mqtt connect")
        self._limits = Limits()
        self._too_long: dict[str, int] = {}
        """Size of the first message that was not sent, by its topic, bytes."""
        self._secrets()

    @abstractmethod
    def _connection(self, login: Login, tls: ssl.SSLContext | None) -> Connection:
        """Return a connection that is not opened yet."""

    @abstractmethod
    async def _announce(self, broker: Connection) -> None:
        """Send the identity of the unit."""

    @abstractmethod
    async def _listen(self, broker: Connection) -> None:
        """Run concurrently with the publishing, from before the first message, until cancelled."""

    @abstractmethod
    async def _each_second(self, broker: Connection) -> None:
        """Send what is due once per ``INTERVAL_S``."""

    @abstractmethod
    async def _send_measurement(self, broker: Connection) -> None:
        """Send the measurement of the board if it differs from the one sent last."""

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve one connection until cancelled; raises BrokerError if it cannot be made or is lost."""
        if self._tries:
            await self._clock.sleep(self._chance.uniform(0.0, MAX_JITTER_S))
        self._tries += 1
        try:
            login, tls = self._secrets()
        except BadInputError as error:  # a file was changed since the start
            raise BrokerError(str(error)) from error
        connection = self._connection(login, tls)
        connection.connecting = self._connecting  # a try that hangs is not joined by a second one
        async with connection as broker:
            try:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(broker.lost(), name="mqtt connection")
                    tasks.create_task(self._listen(broker), name="mqtt beside")
                    self._too_long.clear()
                    await self._announce(broker)
                    ready()
                    self._report()
                    await self._publish(broker)
            except BaseExceptionGroup as group:
                lost = unwrap_group(group, BrokerError)
                if lost is None:
                    raise
                raise lost from None

    def _report(self) -> None:
        """Set the state of the component, with what the broker cannot do."""
        how = "connected, without TLS" if self._settings.ca is None else "connected"
        text = "; ".join([how, *self._limits.sentences])
        if self._too_long:
            self._component.set_state(State.DEGRADED, self._limits.not_sent(self._too_long))
        else:
            self._component.set_state(State.OK, text)

    def _secrets(self) -> tuple[Login, ssl.SSLContext | None]:
        settings = self._settings
        login = None if settings.credentials is None else load_login(settings.credentials)
        if settings.ca is None:
            return login, None
        return login, client_context(settings.ca, settings.certificate, settings.key)

    async def _publish(self, broker: Connection) -> None:
        """Send one message after the other; lost time is not made up by a burst."""
        due_ns = self._clock.monotonic_ns() + round(INTERVAL_S * 1e9)
        while True:
            left_s = (due_ns - self._clock.monotonic_ns()) * 1e-9
            if left_s <= 0:
                due_ns = max(due_ns + round(INTERVAL_S * 1e9), self._clock.monotonic_ns())
                await self._each_second(broker)
            elif self._settings.every_measurement:
                await self._send_next(broker, left_s)
            else:
                await self._clock.sleep(left_s)

    async def _send_next(self, broker: Connection, timeout_s: float) -> None:
        """Wait for a measurement and send it; count those that were skipped for a slow broker."""
        skipped = self._unsent.skipped
        try:
            async with asyncio.timeout(timeout_s):
                await self._unsent.next()
        except TimeoutError:
            return
        self._component.count("measurements_skipped", self._unsent.skipped - skipped)
        await self._send_measurement(broker)

    def _has_sent(self) -> None:
        """Count a message that the broker has accepted."""
        self._component.count("messages_sent")
        self._component.gave_data()
