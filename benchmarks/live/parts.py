"""Processes of a unit on a real wire: cameras that can be disturbed, the daemon, and its reader."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.live.watch import Ports, Watch
from benchmarks.unit_toml import unit_toml
from hw_sim.unit import EXPOSURES_MS

ROOT = Path(__file__).resolve().parents[2]
SEED = 1
FRONT, REAR = "127.0.0.1", "127.0.0.2"
LINKED, NEAR = "10.77.0.2", "10.77.0.1"
"""Addresses of the far and the near end of a link."""
_READY = "Ctrl-C ends it"
_START_TIMEOUT_S = 20.0
_DAEMON_CORE = min(os.sched_getaffinity(0))


@dataclass(frozen=True, slots=True)
class Running:
    """A process of the unit, with its output in a file."""

    process: subprocess.Popen[bytes]
    log: Path

    @property
    def output(self) -> str:
        """Complete output so far."""
        return self.log.read_text()

    def await_text(self, word: str, timeout_s: float = _START_TIMEOUT_S) -> None:
        """Wait until the output contains ``word``; raises RuntimeError with the actual output."""
        deadline_s = time.monotonic() + timeout_s
        while word not in self.output:
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError(f"{self.process.args!r} did not say {word!r} but {self.output!r}")
            time.sleep(0.01)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process."""
        self.process.send_signal(number)

    def cpu_s(self) -> float:
        """Processor seconds of all its threads so far (proc(5), /proc/PID/stat)."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(") ")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        """Request the process to end; kill it if it does not."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


@contextlib.contextmanager
def running(command: Sequence[str | Path], log: Path) -> Iterator[Running]:
    """Run a process within the block."""
    with log.open("ab") as output:
        process = subprocess.Popen(  # noqa: S603  our own programs
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
        )
    part = Running(process, log)
    try:
        yield part
    finally:
        part.end()


def cameras_command(seed: int, *more: str) -> list[str]:
    """Command that serves the unit of ``seed`` as GigE Vision cameras."""
    return [sys.executable, "-m", "hw_sim", "gige", "--seed", str(seed), *more]


def daemon_command(config: Path) -> list[str]:
    """Command of the daemon as on a unit, on a processor that nothing else here uses.

    A real camera takes no time of the unit's processor, nor does a controller.
    """
    python = ["taskset", "-c", str(_DAEMON_CORE), sys.executable]
    return [*python, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]


@contextlib.contextmanager
def off_the_daemons_core() -> Iterator[None]:
    """Keep this process and its children off the daemon's processor, if there is another one."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, allowed - {_DAEMON_CORE} or allowed)
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def calibrate(seed: int, folder: Path) -> Path:
    """Calibrate the unit of ``seed`` from its own scan and flat, as ``make demo`` does."""
    scan, flat, calibration = folder / "scan", folder / "flat", folder / "calibration.json"
    for arguments in (
        ("hw_sim", "scan", "--seed", str(seed), "-o", scan),
        ("hw_sim", "flat", "--seed", str(seed), "-o", flat),
        ("altd.cli", "calibrate", scan, "--flat", flat, "-o", calibration),
    ):
        subprocess.run(  # noqa: S603  our own programs
            [sys.executable, "-m", *map(str, arguments)], check=True, cwd=ROOT, stdout=subprocess.DEVNULL
        )
    return calibration


def write_config(
    path: Path, serial: str, calibration: Path, addresses: Sequence[str], ports: Ports, more: str = ""
) -> Path:
    """Write the settings of a unit with two GigE Vision cameras, front and rear, and ``more`` tables."""
    front, rear = (
        f'driver = "aravis"\ndevice = "{address}"\nexposure.exposure_ms = {EXPOSURES_MS[name]}'
        for name, address in zip(("front", "rear"), addresses, strict=True)
    )
    path.write_text(
        f"{unit_toml(serial, calibration, front, rear)}\n"
        f'[http]\nhost = "127.0.0.1"\nport = {ports.http}\n\n'
        f'[modbus_tcp]\nhost = "127.0.0.1"\nport = {ports.modbus}\n{more}'
    )
    return path


class Camera(contextlib.AbstractContextManager["Camera"]):
    """One camera in a separate process, which can be killed, stopped and started."""

    def __init__(self, folder: Path, name: str, address: str) -> None:
        self._command = cameras_command(SEED, "--only", name, f"--{name}", address)
        self._log = folder / f"{name}.log"
        self._life = contextlib.ExitStack()
        self.start()

    def __exit__(self, *_: object) -> None:
        self._life.close()

    def start(self) -> float:
        """Start serving; return when the camera was available, monotonic s."""
        self._log.write_bytes(b"")
        self._running = self._life.enter_context(running(self._command, self._log))
        self._running.await_text(_READY)
        return time.monotonic()

    def kill(self) -> None:
        """Kill the process without notice."""
        self._running.process.kill()
        self._running.process.wait()

    def stop(self) -> None:
        """Suspend the process: nothing is answered."""
        self._running.send(signal.SIGSTOP)

    def go_on(self) -> float:
        """Resume the process; return when, monotonic s."""
        self._running.send(signal.SIGCONT)
        return time.monotonic()


@contextlib.contextmanager
def both_cameras(folder: Path, *more: str) -> Iterator[Running]:
    """Serve both cameras in one process; yield when they are available."""
    with running(cameras_command(SEED, *more), folder / "cameras.log") as cameras:
        cameras.await_text(_READY)
        yield cameras


@contextlib.contextmanager
def behind_link(command: Sequence[str], log: Path) -> Iterator[Running]:
    """Run a command in its own namespace, at the far end of a pair of virtual Ethernet cards."""
    setup = f"ip link set lo up; until ip address add {LINKED}/24 dev far 2>/dev/null; do sleep 0.05; done"
    shell = f'{setup}; ip link set far up; exec "$@"'
    with running(["unshare", "-n", "sh", "-c", shell, "sh", *command], log) as process:
        time.sleep(0.3)  # until unshare has made the namespace
        ip("link", "add", "near", "type", "veth", "peer", "name", "far", "netns", str(process.process.pid))
        ip("address", "add", f"{NEAR}/24", "dev", "near")
        set_link("up")
        yield process


@contextlib.contextmanager
def camera_behind_link(folder: Path) -> Iterator[Running]:
    """Serve the front camera behind a link."""
    serve = cameras_command(SEED, "--only", "front", "--front", LINKED)
    with behind_link(serve, folder / "linked.log") as camera:
        camera.await_text(_READY)
        yield camera


def set_link(state: str) -> float:
    """Disconnect the link (``down``) or reconnect it (``up``); return when, monotonic s."""
    ip("link", "set", "near", state)
    return time.monotonic()


@contextlib.contextmanager
def measuring_daemon(
    folder: Path, calibration: Path, addresses: tuple[str, str], more: str = ""
) -> Iterator[tuple[Running, Watch]]:
    """Run the daemon on the cameras at these addresses, with ``more`` tables, and a client that reads it."""
    ports = Ports.free()
    config = write_config(folder / "altd.toml", f"SIM-{SEED}", calibration, addresses, ports, more)
    log = folder / "altd.log"
    log.write_bytes(b"")
    with running(daemon_command(config), log) as daemon:
        daemon.await_text("measuring")
        with Watch(ports) as watch:
            yield daemon, watch


def ip(*arguments: str) -> None:
    """Change the network configuration; raises CalledProcessError."""
    subprocess.run(["ip", *arguments], check=True)  # noqa: S603, S607
