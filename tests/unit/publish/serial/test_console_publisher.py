"""The console through a pseudo terminal, from the client's bytes to the board and back."""

import asyncio
import contextlib
import itertools
import os
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.serving import GONE, lines, serving
from support.wire import Wire

from altd.config import ConsolePortSettings
from altd.publish.serial.publisher import ConsolePublisher
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit


class TestConsole:
    @pytest.fixture
    def publisher(
        self, wire: Wire, published: PublishedUnit, component: Component, clock: FakeClock
    ) -> ConsolePublisher:
        settings = ConsolePortSettings(device=wire.device, speaks="console")
        return ConsolePublisher(settings, published, component)

    async def test_a_session(
        self,
        wire: Wire,
        board: Board,
        component: Component,
        clock: FakeClock,
        measured: Measurement,
        publisher: ConsolePublisher,
    ) -> None:
        board.publish(measured)
        async with serving(publisher):
            assert b"ALT-0007" in await wire.receive(lambda data: data.endswith(b"> "))
            wire.send(b"measure\r")
            assert b"10.012 mm" in await wire.receive(lambda data: data.endswith(b"\n> "))
            wire.send(b"watch 0.5\r")
            await wire.receive(lines(4))
            receiving = asyncio.ensure_future(wire.receive(lines(3)))
            while not receiving.done():
                await clock.jump(0.5)
                board.publish(replace(measured, t_ns=clock.now_ns))
                await asyncio.sleep(0.03)
            assert (await receiving).count(b"10.012") >= 3
            wire.send(b"q")
            assert (await wire.receive(lambda data: data.endswith(b"> "))).splitlines()[-1] == b"> "
            await clock.jump(0.5)
            wire.send(b"rubbish\r")
            assert b"no command 'rubbish'" in await wire.receive(lambda data: data.endswith(b"\n> "))
        assert component.counters == {"commands": 2}
        assert component.state is State.OK

    async def test_a_line_that_echoes_everything_does_not_keep_the_unit_busy(
        self, wire: Wire, publisher: ConsolePublisher
    ) -> None:
        async with serving(publisher):
            answers = 0
            async with asyncio.timeout(60):
                for _ in range(10):
                    wire.send(await wire.receive(bool))
                    answers += 1
                    await asyncio.sleep(0.02)
            assert answers == 10

    async def test_a_flood_of_commands_takes_one_turn_of_the_loop_for_each(
        self, wire: Wire, component: Component, publisher: ConsolePublisher
    ) -> None:
        async with serving(publisher):
            await wire.receive(lambda data: data.endswith(b"> "))
            wire.send(b"status\r" * 30)
            done = [0]
            async with asyncio.timeout(60):
                while done[-1] < 30:
                    await asyncio.sleep(0)
                    with contextlib.suppress(BlockingIOError):
                        os.read(wire.far, 65536)
                    done.append(component.counters.get("commands", 0))
        assert max(after - before for before, after in itertools.pairwise(done)) == 1

    async def test_answers_that_nobody_takes_are_counted_and_it_lives_on(
        self, wire: Wire, component: Component, publisher: ConsolePublisher
    ) -> None:
        async with serving(publisher) as task:
            for _ in range(2000):
                with contextlib.suppress(BlockingIOError):
                    wire.send(b"status\r" * 60)
                await asyncio.sleep(0.005)
                if component.counters.get("answers_dropped", 0):
                    break
            assert component.counters["answers_dropped"] > 0
            assert not task.done()

    async def test_a_hang_up_ends_it_with_an_error(self, wire: Wire, publisher: ConsolePublisher) -> None:
        async with serving(publisher) as task:
            wire.hang_up()
            with pytest.raises(OSError, match=GONE):
                await asyncio.wait_for(task, 60)

    async def test_a_key_whose_bytes_come_apart_is_one_key(
        self, wire: Wire, clock: FakeClock, publisher: ConsolePublisher
    ) -> None:
        async with serving(publisher):
            await wire.receive(lambda data: data.endswith(b"> "))
            for piece in (b"versionx", b"\x1b", b"[", b"D", b"\x1b[", b"3~"):
                wire.send(piece)
                await asyncio.sleep(0.04)
                await clock.advance(0.1)
            wire.send(b"\r")
            assert b"altd 0.1.0" in await wire.receive(lambda data: data.endswith(b"\n> "))

    async def test_escape_alone_is_over_after_a_moment(
        self, wire: Wire, clock: FakeClock, publisher: ConsolePublisher
    ) -> None:
        async with serving(publisher):
            await wire.receive(lambda data: data.endswith(b"> "))
            wire.send(b"\x1b")
            await wire.taken()
            await clock.advance(0.2)
            wire.send(b"[x\r")
            assert b"no command '[x'" in await wire.receive(lambda data: data.endswith(b"\n> "))

    async def test_noise_neither_ends_nor_delays_the_lines_of_watch(
        self, wire: Wire, board: Board, clock: FakeClock, measured: Measurement, publisher: ConsolePublisher
    ) -> None:
        board.publish(measured)
        async with serving(publisher):
            wire.send(b"watch 1\r")
            await wire.receive(lines(4))
            receiving = asyncio.ensure_future(wire.receive(lines(3)))
            while not receiving.done():  # noise that began the second again would let none of it end
                wire.send(b"\0\xfe")
                await asyncio.sleep(0.03)
                await clock.advance(0.3)
            assert (await receiving).count(b"08:15:30.125") >= 3
            wire.send(b"\x1b[15~")
            assert (await wire.receive(lambda data: data.endswith(b"> "))).splitlines()[-1] == b"> "
