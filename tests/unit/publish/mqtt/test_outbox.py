"""The sender of the outbox: in order, within its limits, and deaf to wrong acknowledgements."""

import asyncio
import itertools
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from support.clock import FakeClock, settle, stop
from support.history import ABOUT, MAX_BYTES, START_S, batch, renamed, sample

from altd.history.history import History
from altd.history.outbox import Outbox
from altd.history.store import Store
from altd.publish.mqtt.limits import BrokerError, MessageTooLongError
from altd.publish.mqtt.outbox import MAX_UNACKNOWLEDGED_S, OutboxSender
from altd.status.health import Component, State
from altd.status.outbox import Batch, acknowledgement_of
from altd.status.proof import is_sealed, sealed


@dataclass
class Taking:
    """A connection that takes all that is sent."""

    batches: list[Batch] = field(default_factory=list)
    refuses: bool = False
    most_bytes: int = 1 << 20
    acknowledge: Callable[[bytes, bool], None] = lambda payload, is_retained: None

    async def subscribe_to(self, topic: str, take: Callable[[bytes, bool], None], **_: Any) -> None:
        assert topic == "ack"
        if self.refuses:
            raise BrokerError("the broker refuses the subscription")
        self.acknowledge = take

    async def send(self, topic: str, payload: str, **_: Any) -> None:
        assert topic == "outbox"
        assert is_sealed(payload.encode())
        if len(payload) > self.most_bytes:
            raise MessageTooLongError("too long", len(payload))
        self.batches.append(Batch.model_validate_json(payload))


class Sending:
    """A unit with a history, its sender and what a broker got of it."""

    def __init__(self, folder: Path, clock: FakeClock) -> None:
        self.clock = clock
        path = folder / "history.db"
        self.history = History(path)
        self.store = Store(path, MAX_BYTES, renamed(ABOUT, serial="ALT-1"), has_outbox=True)
        self.outbox = Outbox(self.history)
        self.component = Component("outbox", clock)
        self.sender = OutboxSender(
            self.outbox, ("outbox", "ack"), "ALT-1", self.component, lambda batch: sealed(json.dumps(batch))
        )
        self.broker = Taking()
        self.seconds = 0
        self._is_answered = asyncio.Event()
        self._is_answered.set()
        self._after, self.outbox.after = self.outbox.after, self._noted_after  # type: ignore[method-assign]

    async def _noted_after(self, sequence: int, limit: int) -> Any:
        self._is_answered.clear()
        try:
            return await self._after(sequence, limit)
        finally:
            self._is_answered.set()

    def write(self, count: int = 0) -> None:
        items = [sample(START_S + self.seconds + n + 0.1, 10.0) for n in range(count)]
        self.seconds += count
        made = replace(batch(START_S + self.seconds + 5, items), acknowledged=self.outbox.acknowledged)
        self.outbox.mark = self.store.write(made).outbox

    def acknowledge(self, sequence: int, is_retained: bool = False, **changes: str) -> None:
        about = {"serial": "ALT-1", "stream": self.stream} | changes
        self.broker.acknowledge(acknowledgement_of(**about, sequence=sequence).encode(), is_retained)

    @property
    def stream(self) -> str:
        assert self.outbox.mark is not None
        return self.outbox.mark.stream

    @property
    def refused(self) -> int:
        return self.component.counters.get("acknowledgements_refused", 0)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        task = asyncio.create_task(self.sender.run(self.broker))  # type: ignore[arg-type]
        try:
            yield
        finally:
            await stop(task)

    async def until(self, condition: Callable[[], bool], step_s: float = 0.05) -> None:
        """Let time pass until it is so, not during a query: the clock does not know the history's thread."""
        for _ in range(20_000):
            if condition():
                return
            await self.clock.advance(step_s)
            await self._is_answered.wait()
            await settle()
        raise AssertionError(self.broker.batches)

    async def advance(self, seconds: float) -> None:
        end_ns = self.clock.now_ns + round(seconds * 1e9)
        await self.until(lambda: self.clock.now_ns >= end_ns)

    async def sent(self, last: int) -> None:
        await self.until(lambda: bool(self.broker.batches) and self.broker.batches[-1].last >= last)


@pytest.fixture
async def sending(tmp_path: Path) -> AsyncIterator[Sending]:
    made = Sending(tmp_path, FakeClock(10**12))
    yield made
    await made.history.end()
    made.store.end(None)


async def test_all_is_sent_in_order_and_kept_until_it_is_acknowledged(sending: Sending) -> None:
    sending.write(1000)
    async with sending.running():
        await sending.sent(1000)
        spans = [(each.first, each.last) for each in sending.broker.batches]
        assert spans[0][0] == 1
        assert all(after[0] == before[1] + 1 for before, after in itertools.pairwise(spans))
        rows = [row for each in sending.broker.batches for row in each.rows]
        assert [row.sequence for row in rows] == list(range(1, 1001))
        assert [row.t_s for row in rows] == list(range(START_S, START_S + 1000))
        assert sending.component.message == "seconds that wait for an acknowledgement: 1000"
        sending.acknowledge(600)
        sending.write()
        assert sending.component.message == "seconds that wait for an acknowledgement: 400"
        sending.acknowledge(500)  # of another instance, which is behind
        sending.acknowledge(1000)
        sending.write()
    assert sending.component.message.endswith(": 0")
    assert sending.refused == 0


async def test_no_more_than_a_window_waits_for_the_ingest(sending: Sending) -> None:
    sending.write(MAX_UNACKNOWLEDGED_S + 1500)
    async with sending.running():
        await sending.sent(MAX_UNACKNOWLEDGED_S)
        last = sending.broker.batches[-1].last
        await sending.advance(20.0)
        assert sending.broker.batches[-1].last == last
        sending.acknowledge(last)
        await sending.sent(MAX_UNACKNOWLEDGED_S + 1500)


async def test_a_broker_that_accepts_only_short_messages_gets_short_batches(sending: Sending) -> None:
    sending.write(100)
    sending.broker.most_bytes = 3000
    async with sending.running():
        await sending.sent(100)
        assert [row.sequence for each in sending.broker.batches for row in each.rows] == list(range(1, 101))
        sending.acknowledge(100)
        sending.write(100)
        sending.broker.most_bytes = 100
        await sending.until(lambda: sending.component.state is State.DEGRADED)
        assert sending.component.message == "too long"
    assert sending.broker.batches[-1].last == 100


async def test_what_is_not_acknowledged_comes_again_and_less_and_less_often(sending: Sending) -> None:
    sending.write(10)
    times_s = []
    async with sending.running():
        for _ in range(7):
            number = len(sending.broker.batches)
            await sending.until(lambda before=number: len(sending.broker.batches) > before, 0.5)
            times_s.append(sending.clock.now_ns * 1e-9)
        waits_s = [after - before for before, after in itertools.pairwise(times_s)]
        assert waits_s == pytest.approx([30, 60, 120, 240, 480, 480], abs=3)
        assert sending.component.state is State.DEGRADED
        assert "no acknowledgement of an ingest for" in sending.component.message
        sending.acknowledge(10)
        sending.write()
        await sending.advance(2.0)
        assert sending.component.state is State.OK
    assert {(each.first, each.last) for each in sending.broker.batches} == {(1, 10)}


async def test_a_refused_subscription_is_said_and_tried_again_while_live_messages_continue(
    sending: Sending,
) -> None:
    sending.write(10)
    sending.broker.refuses = True
    async with sending.running():
        await sending.advance(100.0)
        assert (sending.component.state, sending.broker.batches) == (State.DEGRADED, [])
        assert sending.component.message == "the broker refuses the subscription"
        sending.broker.refuses = False
        await sending.sent(10)
        assert sending.component.state is State.OK


async def test_an_acknowledgement_during_a_query_makes_no_wrong_batch(sending: Sending) -> None:
    """Of a batch that is sent again: the rows were asked for before the acknowledgement came."""
    sending.write(10)
    after = sending.outbox.after

    async def acknowledged_meanwhile(sequence: int, limit: int) -> Any:
        found = await after(sequence, limit)
        if sending.broker.batches:
            sending.acknowledge(10)
        return found

    async with sending.running():
        await sending.sent(10)
        sending.outbox.after = acknowledged_meanwhile  # type: ignore[method-assign]
        await sending.until(lambda: len(sending.broker.batches) == 2, 1.0)
    assert [(each.first, each.last, len(each.rows)) for each in sending.broker.batches] == [(1, 10, 10)] * 2


WRONG = {
    "above what was sent": lambda unit: acknowledgement_of("ALT-1", unit.stream, 11),
    "of another stream": lambda unit: acknowledgement_of("ALT-1", "0" * 16, 10),
    "of another unit": lambda unit: acknowledgement_of("ALT-2", unit.stream, 10),
    "with a wrong CRC": lambda unit: acknowledgement_of("ALT-1", unit.stream, 9).replace(" 9", " 10"),
    "no JSON": lambda unit: "nonsense",
    "of another schema": lambda unit: sealed(
        json.dumps({"schema": 2, "serial": "ALT-1", "stream": unit.stream, "sequence": 10})
    ),
    "with a fraction": lambda unit: sealed(
        json.dumps({"schema": 1, "serial": "ALT-1", "stream": unit.stream, "sequence": 9.5})
    ),
    "negative": lambda unit: acknowledgement_of("ALT-1", unit.stream, -1),
    "empty": lambda unit: "",
}


@pytest.mark.parametrize("wrong", WRONG)
async def test_a_wrong_acknowledgement_is_counted_and_changes_nothing(sending: Sending, wrong: str) -> None:
    sending.write(10)
    async with sending.running():
        await sending.sent(10)
        sending.broker.acknowledge(WRONG[wrong](sending).encode(), False)
        assert sending.refused == 1
        assert sending.outbox.acknowledged is None
        sending.acknowledge(10)
        assert sending.outbox.acknowledged == (sending.stream, 10)


async def test_the_retained_acknowledgement_of_an_earlier_opening_is_passed_over(sending: Sending) -> None:
    """A history that was restored counts again from where its copy was made: 900 is not what 900 was."""
    sending.write(10)
    async with sending.running():
        sending.acknowledge(900, is_retained=True, stream="0" * 16)
        await sending.sent(10)
        assert (sending.refused, sending.outbox.acknowledged) == (0, None)
