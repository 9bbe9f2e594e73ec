"""Unplugs, renumbers and stalls the USB serial ports on which telegram, console and Modbus RTU are served.

The unit has the host's ends (cdc_acm, /dev/ttyACM…); the other ends are the gadget's, /dev/ttyGS…, at which
controllers listen. Leaves what they heard, and how long everything took.
"""

import asyncio
import contextlib
import json
import os
import re
import struct
import subprocess
import sys
import time
import tty
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from support.guest import leave_results
from support.measurements import measurement
from support.modbus_rtu_wire import frame

from altd.config import ConsolePortSettings, ModbusRtuPortSettings, TelegramPortSettings
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.modbus.registers import SIZE
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher
from altd.publish.serial.telegram import Nameplate
from altd.runtime.clock import SystemClock
from altd.runtime.supervision import Publisher, keep_running
from altd.status.board import Board
from altd.status.health import Health, State
from altd.status.unit import PublishedUnit

GADGET = Path("/sys/kernel/config/usb_gadget/adapter")
NAMES = Path("by-id")
SPEAKS = ("telegram", "console", "modbus_rtu")
UNIT = 7
EVERYTHING = frame(struct.pack(">BHH", 4, 0, SIZE), UNIT)
"""The request for all registers."""


def make_adapter() -> None:
    """A USB device with three serial ports; not plugged in yet."""
    (GADGET / "configs/c.1").mkdir(parents=True)
    (GADGET / "idVendor").write_text("0x1d6b\n")
    (GADGET / "idProduct").write_text("0x0104\n")
    for number in range(len(SPEAKS)):
        function = GADGET / f"functions/acm.{number}"
        function.mkdir()
        (GADGET / f"configs/c.1/acm.{number}").symlink_to(function)


def plug() -> None:
    (GADGET / "UDC").write_text("dummy_udc.0\n")


def unplug() -> None:
    (GADGET / "UDC").write_text("\n")


def give_names() -> dict[str, str]:
    """A stand-in for udev: names that stay when the ports' numbers do not; returns their targets."""
    found = {}
    for device in Path("/sys/class/tty").glob("ttyACM*/device/bInterfaceNumber"):
        with contextlib.suppress(OSError):
            found[SPEAKS[int(device.read_text(), 16) // 2]] = device.parts[-3]
    for name in SPEAKS:
        link = NAMES / name
        if name not in found:
            link.unlink(missing_ok=True)
        elif not link.is_symlink() or link.readlink().name != found[name]:
            link.unlink(missing_ok=True)
            link.symlink_to(Path("/dev") / found[name])
    return found


async def keep_names() -> None:
    while True:
        give_names()
        await asyncio.sleep(0.02)


class FarEnd:
    """A controller at the far end of one line, which reads at its own pace."""

    def __init__(self, number: int) -> None:
        self.device = f"/dev/ttyGS{number}"
        self.pace_bytes_s = 1e6
        self.heard = [b""]
        """The received text, plug by plug."""
        self.heard_at = [0.0]
        """When each of these began."""
        self._descriptor = -1

    def send(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    async def listen(self) -> None:
        try:
            while True:
                self._open()
                with contextlib.suppress(OSError):
                    await self._read()
                os.close(self._descriptor)
                self.heard.append(b"")
                self.heard_at.append(0.0)
                await asyncio.sleep(0.02)
        finally:
            os.close(self._descriptor)

    async def hears(self, words: bytes, within_s: float = 10.0) -> None:
        """Return once these words were heard since the last plug; otherwise say what was."""
        await until(
            lambda: words in self.heard[-1], within_s, lambda: f"{words!r}, but {self.heard[-1][-300:]!r}"
        )

    def _open(self) -> None:
        self._descriptor = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._descriptor)

    async def _read(self) -> None:
        while True:
            try:
                data = os.read(self._descriptor, 40)
                if not data:
                    return
                if not self.heard[-1]:
                    self.heard_at[-1] = time.monotonic()
                self.heard[-1] += data
                await asyncio.sleep(len(data) / self.pace_bytes_s)
            except BlockingIOError:
                await asyncio.sleep(0.005)


async def until(
    what: Callable[[], bool], within_s: float = 10.0, but: Callable[[], object] = lambda: "something else"
) -> float:
    """The time until it was so."""
    began = time.monotonic()
    while not what():
        assert time.monotonic() - began < within_s, f"waited for {but()}"
        await asyncio.sleep(0.005)
    return time.monotonic() - began


class Unit:
    """The three publishers of a daemon, supervised as it does."""

    def __init__(self) -> None:
        self.clock = SystemClock()
        self.board = Board(self.clock, 3600.0, QUANTITIES)
        self.health = Health(self.clock)
        self.published = PublishedUnit(self.board, self.health)
        self.slowest_s = 0.0
        """The longest that the event loop was held."""

    def publisher(self, speaks: str) -> Publisher:
        line: dict[str, Any] = {"device": (NAMES / speaks).absolute(), "speaks": speaks, "baud": 115200}
        component = self.health.component(speaks)
        if speaks == "telegram":
            telegram = TelegramPortSettings(**line, interval_s=0.05)
            nameplate = Nameplate(unit=None, serial="ALT-0007", firmware="", calibrated=None)
            return TelegramPublisher(telegram, self.board, component, self.clock, nameplate)
        if speaks == "console":
            return ConsolePublisher(ConsolePortSettings(**line), self.published, component)
        return ModbusRtuPublisher(ModbusRtuPortSettings(**line, unit_id=UNIT), self.published, component)

    def states(self) -> list[State]:
        return [component.state for component in self.health]

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(self._measure()), asyncio.create_task(self._watch_the_loop())]
        for speaks in SPEAKS:
            component = self.health.component(speaks)
            face = keep_running(f"serial {speaks}", self.publisher(speaks), component, self.clock)
            tasks.append(asyncio.create_task(face))
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    async def _measure(self) -> None:
        sequence = 0
        while True:
            sequence += 1
            self.board.publish(measurement(sequence, self.clock.monotonic_ns()))
            await asyncio.sleep(0.05)

    async def _watch_the_loop(self) -> None:
        while True:
            began = time.monotonic()
            await asyncio.sleep(0.01)
            self.slowest_s = max(self.slowest_s, time.monotonic() - began - 0.01)


async def mbpoll(device: str) -> str:
    """The value that mbpoll reads, or what it complains of."""
    command = ["mbpoll", "-0", "-1", "-B", "-m", "rtu", "-b", "115200", "-P", "none", "-a", str(UNIT)]
    command += ["-t", "4:float", "-r", "20", device]
    done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=20)
    values = re.findall(r"^\[20\]: \t(.*)$", done.stdout, re.MULTILINE)
    return str(values[0]) if values else done.stdout + done.stderr


async def unplugged(times: int) -> dict[str, Any]:
    """Pull the plug while a slow controller keeps a telegram and an answer of the console waiting."""
    unit = Unit()
    telegrams, console = FarEnd(0), FarEnd(1)
    plug()
    await until(lambda: len(give_names()) == len(SPEAKS))
    rounds: list[dict[str, Any]] = []
    others = [asyncio.create_task(work) for work in (keep_names(), telegrams.listen(), console.listen())]
    async with unit.running():
        for number in range(times):
            await console.hears(b"> ")
            console.send(b"measure\r")
            await console.hears(b"10.012 mm")
            value = await mbpoll("/dev/ttyGS2")
            telegrams.pace_bytes_s = 1000.0
            dropped = unit.health.component("telegram").counters.get("telegrams_dropped", 0)
            await until(
                lambda before=dropped: (
                    unit.health.component("telegram").counters.get("telegrams_dropped", 0) > before
                ),
                30.0,
            )
            console.pace_bytes_s = 500.0
            console.send(b"status\r" * 12)
            for _ in range(16):  # each echo waits in a buffer of its own, which cdc_acm counts as full
                await asyncio.sleep(0.03)
                console.send(b"x")
            half_a_request = os.open("/dev/ttyGS2", os.O_WRONLY | os.O_NOCTTY)
            os.write(half_a_request, EVERYTHING[:3])
            await asyncio.sleep(0.2)
            names = give_names()
            holds = [
                os.open(f"/dev/{name}", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) for name in names.values()
            ]
            unplug()
            failed_s = await until(lambda: unit.states() == [State.FAILED] * 3)
            messages = {component.name: component.message for component in unit.health}
            os.close(half_a_request)
            await asyncio.sleep(0.1 + 0.4 * number)
            telegrams.pace_bytes_s = console.pace_bytes_s = 1e6
            plug()
            await until(lambda: len(give_names()) == len(SPEAKS))
            there = time.monotonic()
            await until(lambda: unit.states() == [State.OK] * 3)
            served_s = time.monotonic() - there
            await telegrams.hears(b"$PALTQ")
            for hold in holds:
                os.close(hold)
            rounds.append(
                {
                    "names": names,
                    "messages": messages,
                    "failed_s": failed_s,
                    "served_s": served_s,
                    "first_telegram_s": telegrams.heard_at[-1] - there,
                    "value": value,
                }
            )
        await console.hears(b"> ")
        console.send(b"measure\r")
        await console.hears(b"10.012 mm")
        value = await mbpoll("/dev/ttyGS2")
        await asyncio.sleep(0.5)
        stranger = await asyncio.to_thread(opened_by_a_stranger, (NAMES / "telegram").resolve())
    for task in others:
        task.cancel()
    await asyncio.wait(others)
    unplug()
    return {
        "rounds": rounds,
        "last_value": value,
        "telegrams": [data.decode("latin-1") for data in telegrams.heard],
        "console": [data.decode("latin-1") for data in console.heard],
        "counters": {component.name: component.counters for component in unit.health},
        "slowest_s": unit.slowest_s,
        "stranger": stranger,
    }


def opened_by_a_stranger(device: Path) -> str:
    """The message for a program that is not root and ignores locks when it opens the port."""
    device.chmod(0o666)
    stranger = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "sh", "-c", f": <>{device}"]
    return subprocess.run(stranger, capture_output=True, text=True, check=False).stderr


async def stalled() -> dict[str, Any]:
    """Controllers who listen to nothing: in a process of its own, to see it end."""
    plug()
    await until(lambda: len(give_names()) == len(SPEAKS))
    controller = os.open("/dev/ttyGS2", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(controller)
    child = await asyncio.create_subprocess_exec(sys.executable, __file__, "child", stdout=subprocess.PIPE)
    assert child.stdout is not None
    assert await child.stdout.readline() == b"serving\n"
    for _ in range(100):
        os.write(controller, EVERYTHING)
        await asyncio.sleep(0.03)
    said = json.loads(await child.stdout.readline())
    began = time.monotonic()
    status = await child.wait()
    ended_s = time.monotonic() - began
    os.close(controller)
    unplug()
    return {"status": status, "ended_s": ended_s, **said}


async def serve_the_stalled() -> dict[str, Any]:
    unit = Unit()
    async with unit.running():
        await until(lambda: State.STARTING not in unit.states())
        print("serving", flush=True)
        await asyncio.sleep(4.0)
        messages = {component.name: component.message for component in unit.health}
        counters = {component.name: dict(component.counters) for component in unit.health}
        began = time.monotonic()
    stopped_s = time.monotonic() - began
    return {"messages": messages, "counters": counters, "stopped_s": stopped_s, "slowest_s": unit.slowest_s}


if __name__ == "__main__":
    if sys.argv[1:] == ["child"]:
        print(json.dumps(asyncio.run(serve_the_stalled())), flush=True)
    else:
        NAMES.mkdir()
        make_adapter()
        leave_results(
            {"unplugged": asyncio.run(unplugged(int(sys.argv[1]))), "stalled": asyncio.run(stalled())}
        )
