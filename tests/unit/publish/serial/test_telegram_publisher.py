"""Telegrams through a pseudo terminal, from the board to the client."""

import asyncio
import re
import zlib
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from support.clock import FakeClock
from support.serving import GONE, lines, serving
from support.wire import Wire

from altd.config import TelegramPortSettings
from altd.publish.serial import publisher as publisher_module
from altd.publish.serial.publisher import TelegramPublisher
from altd.records import Measurement
from altd.serial_port.port import Port
from altd.status.board import Board
from altd.status.health import Component, State
from examples.python.altd_telegram import Reader, Reading
from tools.pages.example import NAMEPLATE


def parse(telegram: bytes) -> Reading:
    [reading] = Reader().feed(telegram)
    return reading


Say = Callable[[bytes], Awaitable[None]]


def telegram_port(wire: Wire, **line: Any) -> TelegramPortSettings:
    return TelegramPortSettings(device=wire.device, speaks="telegram", interval_s=0.5, **line)


class TestTelegram:
    @pytest.fixture
    def publisher(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock
    ) -> TelegramPublisher:
        return TelegramPublisher(telegram_port(wire), board, component, clock, NAMEPLATE)

    @pytest.fixture
    def say(self, wire: Wire, clock: FakeClock, monkeypatch: pytest.MonkeyPatch) -> Say:
        """Send to the unit, and wait until it has read all of it and done what follows at once."""
        monkeypatch.setattr(publisher_module, "READ_INTERVAL_S", 0.0)  # real time, which no test waits for
        heard, read = bytearray(), Port.read

        async def read_and_note(port: Port, *arguments: Any, **named: Any) -> bytes:
            heard.extend(data := await read(port, *arguments, **named))
            return data

        async def say(data: bytes) -> None:
            heard.clear()
            wire.send(data)
            async with asyncio.timeout(60.0):
                while bytes(heard) != data:  # noqa: ASYNC110  the kernel has no event for it
                    await asyncio.sleep(0.002)
            await clock.settle()

        monkeypatch.setattr(Port, "read", read_and_note)
        return say

    @pytest.fixture
    def on_request(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock
    ) -> TelegramPublisher:
        port = telegram_port(wire, on_request=True, checked=True)
        return TelegramPublisher(port, board, component, clock, NAMEPLATE)

    async def test_it_speaks_at_its_interval_and_says_what_the_board_says(
        self,
        wire: Wire,
        board: Board,
        component: Component,
        clock: FakeClock,
        measured: Measurement,
        publisher: TelegramPublisher,
    ) -> None:
        async with serving(publisher):
            first = await wire.receive(lines(3))
            assert first.startswith(b"\r\n")  # ends what may have been torn before
            assert parse(first.removeprefix(b"\r\n")).reasons == ("warming_up",)
            board.publish(measured)
            await clock.jump(0.5)
            assert parse(await wire.receive(lines(2))).x_mm == 10.012
            board.publish(replace(measured, sequence=161))
            await clock.jump(0.5)
            assert parse(await wire.receive(lines(2))).sequence == 161
            await clock.jump(2.0)
            stale = parse(await wire.receive(lines(2)))
            assert (stale.mode, stale.x_mm, stale.reasons) == ("V", None, ("stale",))
        assert component.counters == {"telegrams_sent": 4}
        assert component.data_given == 4
        assert component.state is State.OK

    async def test_a_checked_telegram_has_a_third_sentence_that_counts_and_ages(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock, measured: Measurement
    ) -> None:
        board.publish(measured)
        clock.now_ns += 250_000_000
        port = telegram_port(wire, checked=True)
        async with serving(TelegramPublisher(port, board, component, clock, NAMEPLATE)):
            sent = [(await wire.receive(lines(4))).removeprefix(b"\r\n")]
            await clock.jump(0.5)
            sent.append(await wire.receive(lines(3)))
        for number, telegram in enumerate(sent, 1):
            plain, proof = telegram[: telegram.index(b"$PALTC")], telegram[telegram.index(b"$PALTC") :]
            assert parse(plain).x_mm == 10.012
            fields = proof.split(b"*")[0].split(b",")
            elapsed_ms = 250 + 500 * (number - 1)
            assert fields[3:7] == [b"%d" % number, b"%d" % elapsed_ms, b"20261120", b"%d" % elapsed_ms]
            assert fields[1] == b"%08X" % zlib.crc32(b"ALT-0007")
            assert fields[7] == b"%08X" % zlib.crc32(telegram[: telegram.rindex(b",") + 1])

    async def test_it_identifies_itself_at_first_and_then_rarely(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock
    ) -> None:
        port = telegram_port(wire, identify_every_s=60.0)
        async with serving(TelegramPublisher(port, board, component, clock, NAMEPLATE)):
            received = await wire.receive(lines(4))
            for number in range(1, 121):
                await clock.jump(0.5)
                received += await wire.receive(lines(2 + (number == 120)))
        names = re.findall(rb"\$(PALT.),", received)
        telegram = [b"PALTM", b"PALTQ"]
        assert names == [*telegram, b"PALTI", *telegram * 120, b"PALTI"]

    async def test_lost_time_is_not_made_up_by_a_burst(
        self, wire: Wire, say: Say, clock: FakeClock, component: Component, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher):
            await clock.jump(10.0)
            await clock.jump(0.4)
            assert component.counters == {"telegrams_sent": 2}
            await clock.jump(0.1)
            assert component.counters == {"telegrams_sent": 3}

    async def test_what_comes_in_is_ignored(
        self, wire: Wire, say: Say, clock: FakeClock, component: Component, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher) as task:
            await say(b"?\r\n" * 100)
            assert component.counters == {"telegrams_sent": 1}
            await clock.jump(0.5)
            assert b"?" not in await wire.receive(lines(4 + 1))
            assert not task.done()

    async def test_each_request_gets_one_telegram_of_the_moment_of_the_answer(
        self,
        wire: Wire,
        board: Board,
        component: Component,
        clock: FakeClock,
        measured: Measurement,
        say: Say,
        on_request: TelegramPublisher,
    ) -> None:
        board.publish(measured)
        began_ms = (clock.now_ns - measured.t_ns) // 1_000_000
        async with serving(on_request):
            assert component.message.startswith("telegram on request, at most every 0.5 s on /dev/")
            await clock.advance(10.0)
            assert component.counters == {}
            requests = (b"?\r\n", b"?\r", b"?\n", b"what?\r\n?\r\n", b"\x00\xff?\r", b"\n?\r")
            for number, request in enumerate(requests, 1):
                for byte in request:
                    await say(bytes([byte]))
                telegram = await wire.receive(lines(3 + (number == 1)))
                fields = telegram.split(b"$PALTC")[1].split(b",")
                assert (int(fields[3]), int(fields[6])) == (number, began_ms + 9000 + 1000 * number)
                await clock.advance(1.0)
        assert component.counters == {"telegrams_sent": 6}

    @pytest.mark.parametrize(
        "said", [b"?", b"??\r", b"x?\r\n", b"? \r\n", b"$PALTM?\r", b"\r\n", b"\xff\x00"]
    )
    async def test_what_is_no_request_gets_no_answer(
        self, say: Say, component: Component, clock: FakeClock, on_request: TelegramPublisher, said: bytes
    ) -> None:
        async with serving(on_request):
            for sent, counters in ((said, {}), (b"\n?\n", {"telegrams_sent": 1})):
                await say(sent)
                await clock.advance(1.0)
                assert component.counters == counters

    async def test_a_flood_of_requests_gets_no_more_than_a_telegram_an_interval(
        self, say: Say, component: Component, clock: FakeClock, on_request: TelegramPublisher
    ) -> None:
        async with serving(on_request):
            flood = b"?\r\n" * 100
            for step_s, said, sent in (
                (0.0, flood, 1),
                (0.49, flood, 1),
                (0.0, b"more\r\n", 1),
                (0.01, b"", 2),
                (0.7, flood, 3),
                (0.49, flood, 3),
                (0.01, b"", 4),
                (5.0, b"", 4),  # those that came too early got one answer together
            ):
                await clock.advance(step_s)
                await say(said)
                assert component.counters == {"telegrams_sent": sent}

    async def test_nobody_reads_then_telegrams_are_left_out_whole(
        self, wire: Wire, say: Say, clock: FakeClock, component: Component, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher):
            for _ in range(3000):
                await clock.jump(0.5)
                if component.counters.get("telegrams_dropped", 0) >= 5:
                    break
            assert component.state is State.DEGRADED
            sent = component.counters["telegrams_sent"]
            received = await wire.receive(lines(1 + 2 * sent))
            telegrams = received.removeprefix(b"\r\n").splitlines(keepends=True)
            assert len(telegrams) == 2 * sent
            assert set(telegrams) == set(telegrams[:2])
            await clock.jump(0.5)
            assert parse(await wire.receive(lines(2))).reasons == ("warming_up",)
        assert component.state is State.OK

    async def test_a_hang_up_ends_it_at_once_with_an_error(
        self, wire: Wire, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher) as task:
            wire.hang_up()
            with pytest.raises(OSError, match=GONE):
                await asyncio.wait_for(task, 60)

    async def test_a_missing_port_is_an_error_before_it_is_ready(
        self, board: Board, component: Component, clock: FakeClock
    ) -> None:
        settings = TelegramPortSettings.model_validate({"device": "/dev/none", "speaks": "telegram"})
        with pytest.raises(FileNotFoundError, match="/dev/none"):
            await TelegramPublisher(settings, board, component, clock, NAMEPLATE).run(
                lambda: pytest.fail("not ready")
            )
