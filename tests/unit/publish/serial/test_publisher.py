"""Telegram and console through a pseudo terminal, from the board to the client."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import re
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest
from support.clock import FakeClock, stop
from support.foreign import need_program
from support.telegram_reader import parse
from support.wire import Wire

from altd.config import ConsolePortSettings, TelegramPortSettings
from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher
from altd.records import Measurement
from altd.runtime.clock import SystemClock
from altd.status.board import Board
from altd.status.health import Component, Health, State
from hw_sim.demo_lines import Line

GONE = "the port is gone"


def lines(count: int) -> Callable[[bytes], bool]:
    return lambda data: data.count(b"\n") >= count


def telegram_port(wire: Wire, **line: Any) -> TelegramPortSettings:
    return TelegramPortSettings(device=wire.device, speaks="telegram", interval_s=0.5, **line)


@contextlib.asynccontextmanager
async def serving(publisher: TelegramPublisher | ConsolePublisher) -> AsyncIterator[asyncio.Task[None]]:
    ready = asyncio.Event()
    task = asyncio.ensure_future(publisher.run(ready.set))
    await ready.wait()
    yield task
    task.cancel()
    await asyncio.wait({task})


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
                await asyncio.wait_for(task, 1.0)

    async def test_a_missing_port_is_an_error_before_it_is_ready(
        self, board: Board, component: Component, clock: FakeClock
    ) -> None:
        settings = TelegramPortSettings.model_validate({"device": "/dev/none", "speaks": "telegram"})
        with pytest.raises(FileNotFoundError, match="/dev/none"):
            await TelegramPublisher(settings, board, component, clock).run(lambda: pytest.fail("not ready"))


class TestConsole:
    @pytest.fixture
    def publisher(
        self, wire: Wire, board: Board, health: Health, component: Component, clock: FakeClock
    ) -> ConsolePublisher:
        settings = ConsolePortSettings(device=wire.device, speaks="console")
        return ConsolePublisher(settings, board, health, component, clock)

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
            await asyncio.sleep(0.03)
            for _ in range(3):
                await clock.jump(0.5)
                assert b"10.012" in await wire.receive(lines(1))
                board.publish(replace(measured, t_ns=clock.now_ns))
            wire.send(b"q")
            assert await wire.receive(lambda data: data.endswith(b"> ")) == b"> "
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
            async with asyncio.timeout(5.0):
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
            async with asyncio.timeout(10.0):
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
                await asyncio.wait_for(task, 1.0)

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
            await asyncio.sleep(0.05)
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
            await asyncio.sleep(0.03)
            for _ in range(10):
                wire.send(b"\0\xfe")
                await asyncio.sleep(0.03)
                await clock.advance(0.3)
            assert (await wire.receive(lines(3))).count(b"08:15:30.125") == 3
            wire.send(b"\x1b[15~")
            assert await wire.receive(lambda data: data.endswith(b"> ")) == b"> "


class Picocom:
    """The terminal program that the manual names, itself at a terminal of 24 lines."""

    def __init__(self, device: Path) -> None:
        self._program = need_program("picocom")
        self.screen, near = os.openpty()
        os.set_blocking(self.screen, False)
        self._process = subprocess.Popen(
            [self._program, "--quiet", "--noreset", "--baud", "9600", str(device)],
            stdin=near,
            stdout=near,
            stderr=near,
            start_new_session=True,
        )
        os.close(near)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self.screen)

    async def await_prompt(self) -> None:
        """Press Enter until it and the line are there."""
        seen = b""
        async with asyncio.timeout(20.0):
            while not seen.endswith(b"> "):
                os.write(self.screen, b"\r")
                await asyncio.sleep(0.3)
                with contextlib.suppress(BlockingIOError):
                    seen += os.read(self.screen, 65536)

    async def press(self, keys: bytes, shown: bytes) -> bytes:
        """Press keys one by one; gives what the screen got, once it ends so."""
        seen = b""
        async with asyncio.timeout(10.0):
            for key in re.findall(rb"\x1b[O\[][0-9;]*[A-Za-z~]|.", keys, re.DOTALL):
                os.write(self.screen, key)
                await asyncio.sleep(0.03)
            while not seen.endswith(shown):
                await asyncio.sleep(0.01)
                with contextlib.suppress(BlockingIOError):
                    seen += os.read(self.screen, 65536)
        return seen


async def test_a_technician_at_a_real_terminal(
    board: Board, health: Health, component: Component, measured: Measurement
) -> None:
    """The keys as xterm sends them, through picocom; the system's clock tells an escape from a key."""
    board.publish(replace(measured, t_ns=time.monotonic_ns()))
    with Line() as line:
        forwarding = asyncio.create_task(line.forward())
        settings = ConsolePortSettings.model_validate({"device": line.unit_end, "speaks": "console"})
        publisher = ConsolePublisher(settings, board, health, component, SystemClock())
        async with serving(publisher):
            with Picocom(line.far_end) as terminal:
                await terminal.await_prompt()
                edited = b"xeasure\x1b[Hm\x1b[3~\x1b[F\r"
                assert b"10.012 mm" in await terminal.press(edited, b"\r\n> ")
                assert b"10.012 mm" in await terminal.press(b"\x1b[A\r", b"\r\n> ")
                for keys in (
                    b"\x0c",
                    b"\x1bOP",
                    b"\x1b[15~",
                    b"\x1b[5~",
                    b"\0",
                    b"\x1b[1;5D",
                    b"\t",
                    b"\xc3\xa4",
                ):
                    shown = await terminal.press(keys + b"\x05\x15version\r", b"\r\n> ")
                    assert b"altd 0.1.0" in shown
                    assert b"baud" not in shown
        await stop(forwarding)
