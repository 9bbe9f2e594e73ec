"""The console through the terminal program that the manual names."""

import asyncio
import contextlib
import os
import re
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Self

from support.clock import stop
from support.foreign import need_program
from support.serving import serving

from altd.config import ConsolePortSettings
from altd.publish.serial.publisher import ConsolePublisher
from altd.records import Measurement
from altd.runtime.clock import SystemClock
from altd.status.board import Board
from altd.status.health import Component
from altd.status.unit import PublishedUnit
from hw_sim.demo_lines import Line


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
        async with asyncio.timeout(60):
            while not seen.endswith(b"> "):
                os.write(self.screen, b"\r")
                await asyncio.sleep(0.3)
                with contextlib.suppress(BlockingIOError):
                    seen += os.read(self.screen, 65536)

    async def press(self, keys: bytes, shown: bytes) -> bytes:
        """Press keys one by one; gives what the screen got, once it ends so."""
        seen = b""
        async with asyncio.timeout(60):
            for key in re.findall(rb"\x1b[O\[][0-9;]*[A-Za-z~]|.", keys, re.DOTALL):
                os.write(self.screen, key)
                await asyncio.sleep(0.03)
            while not seen.endswith(shown):
                await asyncio.sleep(0.01)
                with contextlib.suppress(BlockingIOError):
                    seen += os.read(self.screen, 65536)
        return seen


async def test_a_technician_at_a_real_terminal(
    board: Board, published: PublishedUnit, measured: Measurement
) -> None:
    """The keys as xterm sends them, through picocom; the system's clock tells an escape from a key."""
    board.publish(replace(measured, t_ns=time.monotonic_ns()))
    with Line() as line:
        forwarding = asyncio.create_task(line.forward())
        settings = ConsolePortSettings.model_validate({"device": line.unit_end, "speaks": "console"})
        publisher = ConsolePublisher(settings, published, Component("serial", SystemClock()))
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
