"""``altd ingest``: takes batches from the broker, commits them, then acknowledges to the broker and the unit.

It keeps no state: the units send again what it had not committed when it ended.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, TypeVar
from urllib.parse import quote

import psycopg
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from psycopg.errors import InsufficientPrivilege, ReadOnlySqlTransaction, UndefinedTable

from altd.credentials.certificates import client_context
from altd.credentials.file import load_login
from altd.errors import BadInputError, one_line
from altd.fleet.database import Progress, Writer, connect, identity_of, maintain, migrate
from altd.fleet.intake import MAX_BYTES, Intake, RefusalReason
from altd.fleet.settings import FleetSettings
from altd.status.outbox import Batch, acknowledgement_of

MAX_WAITING = 1000
"""Maximum number of unacknowledged messages in flight (Receive Maximum of MQTT 5)."""

MAX_BYTES_AT_ONCE = 4 << 20
"""Maximum size of the messages in one transaction: about 20,000 seconds."""

GATHER_S = 0.05
"""Time within which arriving messages share a transaction."""

CLAIM_TIMEOUT_S = 5.0
"""Time within which the broker must return the question to an ingest that asks for another database."""

MAINTENANCE_INTERVAL_S = 60.0
ROUND_INTERVAL_S = 5.0
"""Time between two rounds of roll-ups: a unit with many stale hours must not keep the database busy."""

_NOT_OF_CONTENT = (
    psycopg.OperationalError,
    psycopg.InterfaceError,
    InsufficientPrivilege,
    ReadOnlySqlTransaction,
    UndefinedTable,
)
"""Errors of any batch: the server is away, became a replica, or its tables and rights were changed."""

_MIN_BACKOFF_S, _MAX_BACKOFF_S = 0.2, 10.0
_REPORT_INTERVAL_S = 60.0

log = logging.getLogger("altd")

Result = TypeVar("Result")


class Ingest:
    """One instance. Any number of instances share the messages of a broker."""

    def __init__(self, settings: FleetSettings) -> None:
        """Raises BadInputError for credentials and certificates that cannot be used."""
        self._settings = settings
        broker = settings.broker
        self._intake = Intake(broker.topic)
        self._messages: queue.Queue[tuple[int, MQTTMessage]] = queue.Queue()
        self._claim_topic = f"{broker.topic}/ingest/{broker.group}"
        self._question = f"question {secrets.token_hex(8)}"
        self._claim = ""
        """Claim of the group by this ingest's database."""
        self._is_foreign = False
        self._asked_s: float | None = None
        """Time of the connection; None: the outboxes are subscribed."""
        self._connections = 0
        self._refused: Counter[tuple[str, str]] = Counter()
        self._writer: Writer | None = None
        self._connection: psycopg.Connection | None = None
        self._reported_s = time.monotonic()
        self.rows = 0
        """Number of committed seconds, including those that existed before."""
        self._client = Client(
            CallbackAPIVersion.VERSION2,
            f"altd_ingest_{secrets.token_hex(8)}",
            protocol=MQTTProtocolVersion.MQTTv5,
            manual_ack=True,
        )
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        if broker.credentials is not None:
            self._client.username_pw_set(*load_login(broker.credentials))
        if broker.ca is not None:
            self._client.tls_set_context(client_context(broker.ca, broker.certificate, broker.key))

    def run(self) -> None:
        """Take messages until a signal ends the process, also while the broker or the database hangs.

        A signal interrupts the main thread only where Python waits, not while a name is resolved. Raises
        BadInputError if another ingest of the group writes to another database: each would take a part of
        the messages, and the units delete what one of them has acknowledged.
        """
        failed: Future[None] = Future()

        def work() -> None:
            try:
                self._run()
            except BaseException as error:
                failed.set_exception(error)

        threading.Thread(target=work, name="ingest", daemon=True).start()
        failed.result()

    def _run(self) -> None:
        self._retry("no database yet", self._open_database)
        threading.Thread(target=self._maintain, name="maintenance", daemon=True).start()
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.ReceiveMaximum = MAX_WAITING
        properties.MaximumPacketSize = MAX_BYTES
        broker = self._settings.broker
        self._client.reconnect_delay_set(1, 30)
        self._client.connect_async(
            broker.host, broker.port_or_default, keepalive=10, clean_start=True, properties=properties
        )
        self._client.loop_start()
        while True:
            self._check_claim()
            self.take(self._next_messages())

    def _on_connect(self, client: Client, userdata: Any, flags: Any, code: ReasonCode, _: Any) -> None:
        if code.is_failure:
            log.warning("ingest: the broker refuses the connection: %s", code)
            return
        self._connections += 1
        with contextlib.suppress(queue.Empty):
            while True:  # they can no longer be acknowledged, and are sent again
                self._messages.get_nowait()
        self._asked_s = time.monotonic()
        client.subscribe(self._claim_topic, qos=0)

    def _on_subscribe(self, client: Client, userdata: Any, mid: int, codes: list[ReasonCode], _: Any) -> None:
        if self._asked_s is not None:  # it comes back after the claim, if there is one
            client.publish(self._claim_topic, self._question, qos=0)
        elif any(code.is_failure for code in codes):
            log.warning("ingest: the broker refuses the subscription: %s", ", ".join(map(str, codes)))
        else:
            log.info("ingest: connected to %s", self._settings.broker.host)

    def _on_disconnect(self, client: Client, userdata: Any, flags: Any, code: ReasonCode, _: Any) -> None:
        log.warning("ingest: the connection to the broker has ended: %s", code)

    def _on_message(self, client: Client, userdata: Any, message: MQTTMessage) -> None:
        if message.topic != self._claim_topic:
            self._messages.put((self._connections, message))
        elif bytes(message.payload) == self._question.encode():
            if not self._is_foreign:
                client.publish(self._claim_topic, self._claim, qos=0, retain=True)
                self._subscribe()
        elif message.payload.startswith(b"database ") and bytes(message.payload) != self._claim.encode():
            self._is_foreign = True

    def _subscribe(self) -> None:
        self._asked_s = None
        broker = self._settings.broker
        self._client.subscribe(f"$share/{broker.group}/{broker.topic}/+/outbox", qos=1)

    def _check_claim(self) -> None:
        """Raise BadInputError if the group belongs to another database."""
        if self._is_foreign:
            text = (
                "an ingest of this group writes to another database; if that is out of use, delete its claim"
            )
            raise BadInputError("broker.group", f"{text}: mosquitto_pub -r -n -t {self._claim_topic}")
        if self._asked_s is not None and time.monotonic() - self._asked_s > CLAIM_TIMEOUT_S:
            log.warning("ingest: the broker does not let it read %s", self._claim_topic)
            self._subscribe()

    def _next_messages(self) -> list[tuple[int, MQTTMessage]]:
        """Wait up to a second for messages and return those that have arrived."""
        try:
            messages = [self._messages.get(timeout=1.0)]
        except queue.Empty:
            return []
        time.sleep(GATHER_S)
        size = len(messages[0][1].payload)
        while size < MAX_BYTES_AT_ONCE and len(messages) < MAX_WAITING and not self._messages.empty():
            messages.append(self._messages.get_nowait())
            size += len(messages[-1][1].payload)
        return messages

    def take(self, messages: list[tuple[int, MQTTMessage]]) -> None:
        """Verify and commit messages, then acknowledge them to the broker and to the units."""
        now_s = time.monotonic()
        batches = []
        for _, message in messages:
            found = self._intake.check(message.topic, bytes(message.payload), now_s)
            if isinstance(found, Batch):
                batches.append(found)
            else:
                self._refuse(self._intake.unit_of(message.topic), found)
        progress = self._commit(batches)
        for connection, message in messages:
            if connection == self._connections:
                self._client.ack(message.mid, message.qos)
        for each in progress:
            topic = f"{self._settings.broker.topic}/{quote(each.serial, safe='')}/ack"
            text = acknowledgement_of(each.serial, each.stream, each.sequence)
            self._client.publish(topic, text, qos=0, retain=True)  # if it is lost, the batch is sent again
        self._report(now_s)

    def _refuse(self, unit: str, reason: RefusalReason) -> None:
        if len(self._refused) < 10_000:
            self._refused[unit, str(reason)] += 1
        else:
            self._refused["", str(reason)] += 1

    def _commit(self, batches: list[Batch]) -> list[Progress]:
        """Write batches and the numbers of refused messages; a batch that cannot be written is refused."""
        if not batches and not self._refused:
            return []
        try:
            progress = self._write(batches, self._refused)
        except psycopg.Error:
            progress = self._isolate(batches)
            try:
                self._write([], self._refused)
            except psycopg.Error as error:
                log.warning("ingest: the database refuses its counters: %s", one_line(str(error).strip()))
        self._refused.clear()
        return progress

    def _isolate(self, batches: list[Batch]) -> list[Progress]:
        """Write batches of which the database refuses some, and refuse those."""
        now_s = time.monotonic()
        held = [batch for batch in batches if self._intake.is_held(batch.serial, now_s)]
        for batch in held:
            self._refuse(batch.serial, RefusalReason.DATABASE)
        batches = [batch for batch in batches if not self._intake.is_held(batch.serial, now_s)]
        if not batches:
            return []
        try:
            return self._write(batches, {})
        except psycopg.Error as error:
            middle = len(batches) // 2
            if middle:
                return self._isolate(batches[:middle]) + self._isolate(batches[middle:])
            unit = batches[0].serial
            self._refuse(unit, RefusalReason.DATABASE)
            self._intake.note_database_refusal(unit, now_s)
            log.warning("ingest: the database refuses a batch of %s: %s", unit, one_line(str(error).strip()))
            return []

    def _write(self, batches: list[Batch], refused: Mapping[tuple[str, str], int]) -> list[Progress]:
        """Write in one transaction, and retry until the database answers.

        Raises psycopg.Error if it refuses the content; then nothing is written.
        """

        def write() -> list[Progress]:
            return (self._writer or self._open_database()).write(batches, refused)

        progress = self._retry("the database does not take it", write)
        self.rows += sum(len(batch.rows) for batch in batches)
        return progress

    def _retry(self, failure: str, use: Callable[[], Result]) -> Result:
        """Return what ``use`` returns once the database answers; log each of its complaints once."""
        backoff_s, logged = _MIN_BACKOFF_S, set[str]()
        while True:
            try:
                return use()
            except psycopg.Error as error:
                is_limit = (error.sqlstate or "").startswith("54")  # such as a text too long for an index
                if is_limit or not isinstance(error, _NOT_OF_CONTENT):
                    raise
                if (line := f"{failure}: {one_line(str(error).strip())}") not in logged:
                    logged.add(line)
                    log.warning("ingest: %s; trying again", line)
            self._close_database()
            time.sleep(backoff_s)
            backoff_s = min(2 * backoff_s, _MAX_BACKOFF_S)

    def _open_database(self) -> Writer:
        self._connection = connect(self._settings)
        migrate(self._connection)
        self._claim = f"database {identity_of(self._connection)}"
        self._writer = Writer(self._connection, self._settings)
        return self._writer

    def _close_database(self) -> None:
        self._writer = None
        if self._connection is not None:
            self._connection.close()

    def _maintain(self) -> None:
        """Roll up and delete, in a thread with a connection of its own."""
        while True:
            try:
                with connect(self._settings) as connection:
                    while True:
                        is_more = maintain(connection, self._settings)
                        time.sleep(ROUND_INTERVAL_S if is_more else MAINTENANCE_INTERVAL_S)
            except psycopg.Error as error:
                log.warning("ingest: maintenance of the database: %s", one_line(str(error).strip()))
                time.sleep(_MAX_BACKOFF_S)

    def _report(self, now_s: float) -> None:
        if now_s - self._reported_s > _REPORT_INTERVAL_S:
            self._reported_s = now_s
            log.info("ingest: %d seconds committed since the start", self.rows)
