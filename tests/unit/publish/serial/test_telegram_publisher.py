"""Telegrams through a pseudo terminal, from the board to the client."""

from __future__ import annotations

import asyncio
import zlib
from dataclasses import replace
from typing import Any

import pytest
from support.clock import FakeClock
from support.serving import GONE, lines, serving
from support.telegram_reader import parse
from support.wire import Wire

from altd.config import TelegramPortSettings
from altd.publish.serial.publisher import TelegramPublisher
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, State


def telegram_port(wire: Wire, **line: Any) -> TelegramPortSettings:
    return TelegramPortSettings(device=wire.device, speaks="telegram", interval_s=0.5, **line)


class TestTelegram:
    @pytest.fixture
    def publisher(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock
    ) -> TelegramPublisher:
        return TelegramPublisher(telegram_port(wire), board, component, clock)

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
        async with serving(TelegramPublisher(port, board, component, clock)):
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

    async def test_lost_time_is_not_made_up_by_a_burst(
        self, wire: Wire, clock: FakeClock, component: Component, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher):
            await clock.jump(10.0)
            await clock.jump(0.4)
            assert component.counters == {"telegrams_sent": 2}
            await clock.jump(0.1)
            assert component.counters == {"telegrams_sent": 3}

    async def test_what_comes_in_is_ignored(
        self, wire: Wire, clock: FakeClock, publisher: TelegramPublisher
    ) -> None:
        async with serving(publisher) as task:
            wire.send(b"hello\r\n" * 100)
            await asyncio.sleep(0.05)
            await clock.jump(0.5)
            assert b"hello" not in await wire.receive(lines(4))
            assert not task.done()

    async def test_nobody_reads_then_telegrams_are_left_out_whole(
        self, wire: Wire, clock: FakeClock, component: Component, publisher: TelegramPublisher
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

    async def test_a_line_that_is_too_slow_is_told(
        self, wire: Wire, board: Board, component: Component, clock: FakeClock, measured: Measurement
    ) -> None:
        board.publish(measured)
        async with serving(TelegramPublisher(telegram_port(wire, baud=1200), board, component, clock)):
            await wire.receive(lines(2))
        assert component.state is State.DEGRADED
        assert "takes 0.88 s at 1200 baud but one is due every 0.5 s" in component.message

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
            await TelegramPublisher(settings, board, component, clock).run(lambda: pytest.fail("not ready"))
