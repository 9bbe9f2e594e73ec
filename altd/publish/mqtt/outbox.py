"""Sends the outbox to the ingest, besides the live messages, and receives the ingest's acknowledgements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from altd.history.history import NoHistoryError
from altd.history.outbox import Outbox
from altd.history.records import OutboxMark, QueuedSecond
from altd.publish.mqtt.broker import Broker
from altd.publish.mqtt.limits import BrokerError, MessageTooLongError
from altd.status.health import Component, State, duration
from altd.status.outbox import MAX_NUMBERS, SCHEMA, Acknowledgement, Second
from altd.status.proof import is_sealed

LIVE_INTERVAL_S = 1.0
CATCH_UP_INTERVAL_S = 0.1
"""Time between two batches while more are waiting: 1000 seconds per second for a beam, 160 kB."""

MAX_UNACKNOWLEDGED_S = 2000
"""Maximum of seconds sent but not acknowledged by the ingest; it sets the rate of all units together."""

RESEND_AFTER_S = 30.0
"""Time without an acknowledgement until everything is sent again; doubled for each further repetition."""

MAX_RESEND_S = 480.0
BATCH_EXPIRY_S = 60
"""Time after which a broker discards a batch that no ingest reads; the unit then sends it again."""

NO_INGEST_S = 600.0
"""Time without an acknowledgement until the component is degraded."""


class OutboxSender:
    """Sends one batch at a time; only the ingest's acknowledgement, not the broker's, trims the outbox."""

    def __init__(
        self,
        outbox: Outbox,
        topics: tuple[str, str],
        serial: str,
        component: Component,
        with_proof: Callable[[Mapping[str, Any]], str],
    ) -> None:
        self._outbox = outbox
        self._topic, self._ack_topic = topics
        self._serial = serial
        self._component = component
        self._clock = component.clock
        self._with_proof = with_proof
        self._stream = ""
        self._acknowledged = 0
        self._sent = 0
        self._highest = 0
        self._heard_ns = self._resend_ns = self._clock.monotonic_ns()
        self._resend_s = RESEND_AFTER_S
        self._max_rows = _MAX_ROWS
        component.set_state(State.OK, self._waiting)

    def take_acknowledgement(self, payload: bytes, is_retained: bool) -> None:
        """Accept only an acknowledgement of data that was sent since the history was opened.

        A retained one may be of an earlier opening: it is ignored.
        """
        try:
            message = Acknowledgement.model_validate_json(payload) if is_sealed(payload) else None
        except ValidationError:
            message = None
        is_of_earlier = message is not None and message.stream != self._stream
        if is_retained and (is_of_earlier or not payload):
            return
        is_wrong = message is None or is_of_earlier or message.serial != self._serial
        if is_wrong or message is None or message.sequence > self._highest:
            self._component.count("acknowledgements_refused")
            return
        if message.sequence > self._acknowledged:
            self._acknowledged = message.sequence
            self._sent = max(self._sent, message.sequence)
            self._outbox.acknowledged = (self._stream, message.sequence)
            self._heard_ns, self._resend_s = self._clock.monotonic_ns(), RESEND_AFTER_S
            self._wait_for_answer()

    async def run(self, broker: Broker) -> None:
        """Send until cancelled; raises BrokerError."""
        while True:
            try:
                await broker.subscribe_to(self._ack_topic, self.take_acknowledgement, with_retained=True)
                break
            except BrokerError as error:  # live messages continue
                self._component.set_state(State.DEGRADED, str(error))
                await self._clock.sleep(RESEND_AFTER_S)
        self._sent = self._acknowledged  # unknown whether messages in flight have arrived
        self._max_rows = _MAX_ROWS
        while True:
            is_more = await self._send_next(broker)
            await self._clock.sleep(CATCH_UP_INTERVAL_S if is_more else LIVE_INTERVAL_S)

    async def _send_next(self, broker: Broker) -> bool:
        """Send a batch if one is due; return whether another one is due."""
        mark = self._outbox.mark
        if mark is None:
            return False
        self._follow(mark)
        if mark.complete > self._sent and self._sent - self._acknowledged < MAX_UNACKNOWLEDGED_S:
            after = self._sent  # an acknowledgement during the query may change it
            try:
                mark, rows, quantities = await self._outbox.after(after, _MAX_ROWS)
            except NoHistoryError as error:
                self._component.set_state(State.DEGRADED, str(error))
                return False
            if mark.stream != self._stream:
                return True
            most = MAX_NUMBERS // (len(Second._fields) + 4 * len(quantities))
            rows = rows[: max(min(most, self._max_rows), 1)]
            last = rows[-1].sequence if len(rows) else mark.complete
            document = {
                "schema": SCHEMA,
                "serial": self._serial,
                "file": mark.file,
                "stream": mark.stream,
                "oldest": min(mark.oldest, after + 1),
                "first": after + 1,
                "last": last,
                "newest": mark.complete,
                "dropped": mark.dropped,
                "quantities": quantities,
                "rows": [_row(row, quantities) for row in rows],
            }
            if self._sent == self._acknowledged:
                self._wait_for_answer()
            before = self._sent, self._highest
            self._sent, self._highest = max(self._sent, last), max(self._highest, last)
            try:
                await broker.send(self._topic, self._with_proof(document), expiry_s=BATCH_EXPIRY_S)
            except MessageTooLongError as error:
                self._sent, self._highest = before
                self._max_rows = max(len(rows) // 2, 1)
                if len(rows) <= 1:
                    self._component.set_state(State.DEGRADED, str(error))
                return len(rows) > 1
            self._component.count("batches_sent")
        self._report(mark)
        return mark.complete > self._sent and self._sent - self._acknowledged < MAX_UNACKNOWLEDGED_S

    def _follow(self, mark: OutboxMark) -> None:
        """Start again with a new stream, and after a timeout of the acknowledgement."""
        now_ns = self._clock.monotonic_ns()
        if mark.stream != self._stream:
            self._stream, self._acknowledged = mark.stream, mark.oldest - 1
            self._sent = self._highest = self._acknowledged
        elif mark.oldest - 1 > self._acknowledged:  # the oldest were dropped
            self._acknowledged = mark.oldest - 1
            self._sent = max(self._sent, self._acknowledged)
        elif self._sent > self._acknowledged and now_ns >= self._resend_ns:
            self._resend_s = min(2 * self._resend_s, MAX_RESEND_S)
            self._sent = self._acknowledged
            self._component.count("times_sent_again")

    def _wait_for_answer(self) -> None:
        self._resend_ns = self._clock.monotonic_ns() + round(self._resend_s * 1e9)

    def _report(self, mark: OutboxMark) -> None:
        self._component.counters["seconds_dropped"] = mark.dropped
        if mark.waiting <= 0:
            self._heard_ns = self._clock.monotonic_ns()
        silent_s = (self._clock.monotonic_ns() - self._heard_ns) * 1e-9
        if silent_s > NO_INGEST_S:
            text = f"no acknowledgement of an ingest for {duration(silent_s)}"
            self._component.set_state(State.DEGRADED, text)
        else:
            self._component.set_state(State.OK, self._waiting)

    def _waiting(self, _now_ns: int) -> str:
        mark = self._outbox.mark
        if mark is None:
            return "the history is not open yet"
        return f"seconds that wait for an acknowledgement: {mark.waiting}"


_MAX_ROWS = MAX_NUMBERS // (len(Second._fields) + 4)


def _row(second: QueuedSecond, quantities: Any) -> Second:
    point = second.point
    known = [point.values.get(key) for key in quantities]
    values = [None if each is None else (each.mean, each.sigma, each.low, each.high) for each in known]
    about = (point.n, point.n_valid, point.worst, point.worst_code, point.lost_to)
    return Second(second.sequence, second.epoch, point.t_us // 10**6, *about, values)
