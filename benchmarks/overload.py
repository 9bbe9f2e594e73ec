"""``python -m benchmarks.overload`` (``make bench-overload``): requests and connections beyond the limits.

A unit on two cameras from memory, 20 pairs/s, runs in a separate process. Three measurements:

- refused: requests to keep the last seconds, all refused, because a recording is larger than ``disk_mb``.
- full disk: the same requests, and faults of the beam, while the file system of the recordings is full.
- connections: controllers at Modbus TCP while clients at 64 other addresses connect continuously. Two keep
  the connection that they had before, two connect for each poll; the address of one of these is reserved.

It must run where it may mount a file system and use all loopback addresses: ``unshare -rmn``.
"""

import asyncio
import contextlib
import itertools
import math
import multiprocessing
import os
import signal
import socket
import struct
import subprocess
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from http.client import HTTPConnection
from multiprocessing.connection import Connection
from pathlib import Path

from altd.records import Frame
from benchmarks.daemon import running
from benchmarks.harness import Parser, end
from benchmarks.interfaces import HOST
from benchmarks.material import FPS, Material, Source, make_config, make_material
from benchmarks.poller import read_registers
from benchmarks.process_memory import resident_mb
from hw_sim.ports import free_port

MAX_GROWTH_MB = 168.0
"""One ring of kept frames: default of ``memory_mb``, 160 · 2²⁰ bytes."""
DISK_MB = 260
FREE_MB = 3
ADDRESSES = 64
RESERVED = "127.0.2.4"

_PAIRS = 40
_CONNECTED_S = 2.0
"""Time in which the controllers connect before the others do."""
_REQUEST_EVERY_S = 2.0
_PATIENCE_S = 10.0
_HELD_PER_ADDRESS = 8
_PERIOD, _DARK = 420, 20
"""The beam is off in the last 20 of 420 pairs."""
_processes = multiprocessing.get_context("spawn")


class _Fresh(Material):
    """Material with memory of its own for each frame, as a camera's, so that kept frames take memory."""

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        front, rear = super().pair(sequence, t_ns)
        return replace(front, pixels=front.pixels.copy()), replace(rear, pixels=rear.pixels.copy())


class _Interrupted(_Fresh):
    """Fresh material whose beam is off periodically, so that recordings are written without a request."""

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        front, rear = super().pair(sequence, t_ns)
        if sequence % _PERIOD >= _PERIOD - _DARK:
            front.pixels[:] = 0
            rear.pixels[:] = 0
        return front, rear


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit in a separate process."""

    pid: int
    http: int
    modbus: int

    def keep(self) -> int:
        """Request a recording of the last seconds; return the status of the answer."""
        with contextlib.closing(HTTPConnection(HOST, self.http, timeout=60)) as link:
            link.request("POST", "/api/v1/recordings", headers={"X-Altd-Request": "1"})
            return link.getresponse().status


@contextlib.contextmanager
def unit(material: Material, folder: Path, disk_mb: int) -> Iterator[Unit]:
    """Run a unit that keeps its recordings in ``folder``, from its first valid value on."""
    here, there = _processes.Pipe()
    process = _processes.Process(target=_run, args=(material, folder, disk_mb, there), daemon=True)
    process.start()
    there.close()
    try:
        yield Unit(process.pid or 0, *here.recv())
    finally:
        process.kill()
        process.join()


def _run(material: Material, folder: Path, disk_mb: int, ready: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    asyncio.run(_serve(material, folder, disk_mb, ready))


async def _serve(material: Material, folder: Path, disk_mb: int, ready: Connection) -> None:
    http, modbus = free_port(), free_port()
    config = make_config(
        http={"host": HOST, "port": http},
        modbus_tcp={"host": HOST, "port": modbus, "reserved": [RESERVED]},
        kept_frames={"folder": folder, "disk_mb": disk_mb, "again_after_s": 10},
    )
    async with running(Source(material, FPS), config) as daemon:
        cursor = daemon.board.cursor()
        while not (await cursor.next()).valid:
            pass
        ready.send((http, modbus))
        await asyncio.Event().wait()


def requested(unit: Unit, count: int, every_s: float) -> float:
    """Request recordings; print the statuses and the memory; return how much it grew at most, MB."""
    sizes_mb, statuses = [resident_mb(unit.pid)], Counter[int]()
    for _ in range(count):
        statuses[unit.keep()] += 1
        sizes_mb.append(resident_mb(unit.pid))
        time.sleep(every_s)
    answers = ", ".join(f"{count} of status {status}" for status, count in sorted(statuses.items()))
    print(f"  answers: {answers}")
    print(f"  memory: {sizes_mb[0]:.1f} MB before, {sizes_mb[-1]:.1f} after, {max(sizes_mb):.1f} at most")
    return max(sizes_mb) - sizes_mb[0]


@contextlib.contextmanager
def full_file_system(folder: Path) -> Iterator[None]:
    """Mount a file system in ``folder`` that has space for ``FREE_MB`` only."""
    subprocess.run(  # noqa: S603
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)],  # noqa: S607
        check=True,
    )
    try:
        with (folder / "full").open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, (DISK_MB - FREE_MB) << 20)
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)  # noqa: S603, S607


@dataclass
class Controller:
    """A client that polls the input registers from its own address."""

    address: str
    rate_hz: float
    reconnects: bool = False
    polls: int = 0
    cut: int = 0
    slowest_s: float = 0.0

    def run(self, port: int, seconds: float) -> None:
        """Poll; after a poll that failed, connect again."""
        link: socket.socket | None = None
        due_s = time.monotonic()
        end_s = due_s + seconds
        while due_s < end_s:
            time.sleep(max(due_s - time.monotonic(), 0.0))
            self.polls += 1
            asked_s = time.monotonic()
            try:
                if link is None:
                    link = socket.create_connection((HOST, port), _PATIENCE_S, (self.address, 0))
                read_registers(link)
            except OSError:
                self.cut += 1
                link = None
            self.slowest_s = max(self.slowest_s, time.monotonic() - asked_s)
            due_s = max(due_s + 1 / self.rate_hz, time.monotonic())
            if link is not None and self.reconnects:
                link.close()
                link = None

    def __str__(self) -> str:
        """Result as text."""
        way = "a new connection each" if self.reconnects else "one connection"
        polls = f"{self.cut} of {self.polls} polls cut"
        reserved = ", reserved" if self.address == RESERVED else ""
        return f"  {self.rate_hz:g} Hz, {way}{reserved}: {polls}, slowest answer {self.slowest_s:.2f} s"


def polled(unit: Unit, seconds: float) -> int:
    """Poll while others connect; print the result; return the polls cut that must not be.

    A new connection whose address is not reserved may fail.
    """
    here, there = _processes.Pipe()
    crowd = _processes.Process(target=_connect_continuously, args=(unit.modbus, there), daemon=True)
    controllers = [
        Controller("127.0.2.1", 10.0),
        Controller("127.0.2.2", 1.0),
        Controller("127.0.2.3", 1.0, reconnects=True),
        Controller(RESERVED, 1.0, reconnects=True),
    ]
    threads = [threading.Thread(target=each.run, args=(unit.modbus, seconds)) for each in controllers]
    for thread in threads:
        thread.start()
    time.sleep(_CONNECTED_S)
    crowd.start()
    there.close()
    try:
        here.recv()
        for thread in threads:
            thread.join()
        here.send(None)
        attempts, took_s = here.recv()
    finally:
        crowd.kill()
        crowd.join()
    rate = attempts / took_s
    print(f"  {attempts} attempts to connect from {ADDRESSES} addresses, {rate:.0f} a second")
    print("\n".join(map(str, controllers)))
    return sum(each.cut for each in controllers if not each.reconnects or each.address == RESERVED)


def _connect_continuously(port: int, parent: Connection) -> None:
    """Connect from address after address, and keep the newest few of each, until the parent sends a word."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    held: deque[socket.socket] = deque()
    start_s = time.monotonic()
    for number in itertools.count(1):
        link = socket.socket()
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # no TIME_WAIT
        link.bind((f"127.0.1.{number % ADDRESSES + 1}", 0))
        link.connect_ex((HOST, port))
        held.append(link)
        if len(held) > _HELD_PER_ADDRESS * ADDRESSES:
            held.popleft().close()
        if number == ADDRESSES:
            parent.send(None)
        if number % ADDRESSES == 0 and parent.poll():
            parent.send((number, time.monotonic() - start_s))
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 if memory grew by more than a ring or a poll was cut that must not be."""
    parser = Parser("benchmarks.overload", __doc__)
    parser.count("--refused", 100, "number of refused requests")
    parser.number("--full-disk", 600.0, "of requests on a full disk")
    parser.number("--connections", 60.0, "of connections")
    parser.number("--settle", 25.0, "until memory is full")
    options = parser.parse_args(arguments)
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)  # noqa: S607
    made = make_material(_PAIRS, 1)
    steady, interrupted = (
        kind(made.pairs, made.calibration, made.without_flats) for kind in (_Fresh, _Interrupted)
    )
    with tempfile.TemporaryDirectory(prefix="altd-overload-") as name:
        folder = Path(name)
        with unit(steady, folder, disk_mb=1) as small:
            print("refused:", flush=True)
            time.sleep(options.settle)
            growth_mb = requested(small, options.refused, 0.0)
            print("connections:", flush=True)
            cut = polled(small, options.connections)
        with full_file_system(folder), unit(interrupted, folder, DISK_MB) as full:
            print("full disk:", flush=True)
            time.sleep(options.settle)
            full_mb = requested(full, math.ceil(options.full_disk / _REQUEST_EVERY_S), _REQUEST_EVERY_S)
    return 1 if cut or max(growth_mb, full_mb) > MAX_GROWTH_MB else 0


if __name__ == "__main__":
    end(main, "benchmarks.overload")
