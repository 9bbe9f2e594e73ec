"""Faults that need a real process and real time: the daemon of ``hw_sim demo``, on the machine's clock."""

import asyncio
import contextlib
import math
import os
import resource
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from altd.calibration.file import save_calibration
from altd.errors import BadInputError
from altd.records import FloatArray
from benchmarks.campaign.clips import place_of
from benchmarks.campaign.units import calibrated
from benchmarks.faults.judging import Judge, Result, exposures_ns
from benchmarks.faults.wires import Published, TelegramLine, Wires
from benchmarks.harness import Child, child, meanwhile, module_command
from benchmarks.interfaces import Interfaces
from hw_sim.gige.command import make_unit
from hw_sim.ports import free_port

UNIT, _SEED = "plain", 1
_BEFORE_S, _LASTS_S, _STEADY_S = 1.0, 3.0, 0.5
_START_S, _BACK_S = 60.0, 60.0
_READ_INTERVAL_S = 0.05
_ANSWER_S = 0.5
"""Time after which a controller discards an answer."""
_SLICE_S, _SHARE = 0.1, 0.25
"""Period and share of a simulated control group with a quarter of a processor."""


class _Process:
    """The daemon's process, which can be restarted, and its folder, on a small disk if possible."""

    def __init__(self, command: list[str], folder: Path, life: contextlib.ExitStack) -> None:
        self.folder = folder
        self._command, self._life = command, life
        self._start()

    def _start(self) -> None:
        log = self.folder.with_suffix(".log")
        self.running: Child = self._life.enter_context(child(self._command, log))

    def start_again(self) -> None:
        self.running.process.wait()
        self._start()


@contextlib.contextmanager
def kill_9(unit: _Process) -> Iterator[None]:
    """The process is killed (SIGKILL), and started again after three seconds."""
    unit.running.send(signal.SIGKILL)
    yield
    unit.start_again()


@contextlib.contextmanager
def stopped(unit: _Process) -> Iterator[None]:
    """The process is stopped (SIGSTOP) for three seconds, and continued."""
    unit.running.send(signal.SIGSTOP)
    yield
    unit.running.send(signal.SIGCONT)


@contextlib.contextmanager
def memory(unit: _Process) -> Iterator[None]:
    """The process gets no more memory; one that ends for it is started again."""
    pid = unit.running.process.pid
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    unlimited = resource.prlimit(pid, resource.RLIMIT_AS)
    resource.prlimit(pid, resource.RLIMIT_AS, (pages * resource.getpagesize(), unlimited[1]))
    yield
    if unit.running.process.poll() is None:
        resource.prlimit(pid, resource.RLIMIT_AS, unlimited)
    else:
        unit.start_again()


@contextlib.contextmanager
def disk_full(unit: _Process) -> Iterator[None]:
    """The disk of history and recordings is full, and then is not."""
    if not unit.folder.is_mount():
        raise BadInputError("disk_full", "only root can mount a small disk")
    filler = unit.folder / "filler"
    with contextlib.suppress(OSError), filler.open("wb", 0) as file:
        while True:
            file.write(bytes(1 << 16))
    yield
    filler.unlink()


@contextlib.contextmanager
def cpu_quarter(unit: _Process) -> Iterator[None]:
    """The process, cameras included, gets a quarter of a processor: it is stopped for 75 of each 100 ms."""

    def limit(over: threading.Event) -> None:
        while not over.wait(_SLICE_S * _SHARE):
            unit.running.send(signal.SIGSTOP)
            over.wait(_SLICE_S * (1 - _SHARE))
            unit.running.send(signal.SIGCONT)

    with meanwhile(limit):
        yield


FAULTS = {fault.__name__: fault for fault in (kill_9, stopped, memory, disk_full, cpu_quarter)}


def run_real(name: str) -> Result:
    """Let a fault last three seconds and judge all outputs; raises BadInputError if it cannot be produced."""
    with contextlib.ExitStack() as parts:
        folder = Path(parts.enter_context(tempfile.TemporaryDirectory(prefix="altd-faults-")))
        save_calibration(calibrated(UNIT), folder / "calibration.json")
        disk = folder / "disk"
        disk.mkdir()
        if os.geteuid() == 0:
            mount = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(disk)]
            subprocess.run(mount, check=True)  # noqa: S603
            parts.callback(subprocess.run, ["umount", "-l", str(disk)], check=True)
        http, modbus = free_port(), free_port()
        ports = ("--http-port", http, "--modbus-port", modbus)
        files = ("--keep", disk, "--calibration", folder / "calibration.json")
        demo = module_command("hw_sim", "demo", "--seed", _SEED, *files, *ports)
        unit = _Process(demo, disk, parts)
        line = parts.enter_context(contextlib.closing(TelegramLine(folder / "unused")))
        wires = Wires(Interfaces({}, modbus, http, 0, -1, ()), line, disk / "altd.sock", _ANSWER_S)
        return asyncio.run(_watched(unit, wires, name))


async def _watched(unit: _Process, wires: Wires, name: str) -> Result:
    """Read as a controller does, from the first valid value until the recovery after the fault."""
    truth = make_unit(_SEED, drive=True)

    def error_of(one: Published, t_ns: float, _now_ns: int) -> FloatArray:
        assert one.values is not None  # noqa: S101  checked by the judge
        poses = [truth.truth(round(at_ns)) for at_ns in exposures_ns(t_ns, one.frames)]
        return np.asarray(np.abs(np.mean([place_of(pose) for pose in poses], axis=0) - one.values))

    async def read(judge: Judge, seconds: float, until_back: bool = False) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not (until_back and judge.back_ns is not None):
            asked_ns = time.monotonic_ns()
            shown = [replace(one, age_s=None) for one in await wires.read()]  # same computer: UTC is better
            utc_zero = datetime.now(UTC) - timedelta(seconds=time.monotonic())
            judge.take(shown, asked_ns, utc_zero)
            await asyncio.sleep(_READ_INTERVAL_S)

    await read(Judge(error_of, math.inf, 0.0), _START_S, until_back=True)
    judge = Judge(error_of, math.inf, math.inf)
    await read(judge, _BEFORE_S)
    judge.onset_ns = time.monotonic_ns()
    with FAULTS[name](unit):
        await read(judge, _LASTS_S)
    judge.end_ns = time.monotonic_ns()
    await read(judge, _BACK_S, until_back=True)
    await read(judge, _STEADY_S)
    wires.reset()
    return judge.result
