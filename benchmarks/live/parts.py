"""Processes of a unit on a real wire: cameras that can be disturbed, the daemon, and its reader."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.harness import ROOT, Child, child, module_command
from benchmarks.live.watch import Ports, Watch
from benchmarks.unit_toml import unit_toml
from hw_sim.unit import EXPOSURES_MS

SEED = 1
FRONT, REAR = "127.0.0.1", "127.0.0.2"
LINKED, NEAR = "10.77.0.2", "10.77.0.1"
"""Addresses of the far and the near end of a link."""
_READY = "Ctrl-C ends it"
_DAEMON_CORE = min(os.sched_getaffinity(0))


def cameras_command(seed: int, *more: str) -> list[str]:
    """Command that serves the unit of ``seed`` as GigE Vision cameras."""
    return module_command("hw_sim", "gige", "--seed", seed, *more)


def daemon_command(config: Path) -> list[str]:
    """Command of the daemon as on a unit, on a processor that nothing else here uses.

    A real camera takes no time of the unit's processor, nor does a controller.
    """
    run = module_command("altd.cli", "run", "--rehearsal", "--config", config)
    return ["taskset", "-c", str(_DAEMON_CORE), *run]


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
        command = module_command(*arguments)
        subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)  # noqa: S603  our own
    return calibration


def write_config(  # noqa: PLR0913  the parts of a unit
    path: Path,
    serial: str,
    calibration: Path,
    addresses: Sequence[str],
    ports: Ports,
    more: str = "",
    trigger: str = "free",
) -> Path:
    """Write the settings of a unit with two GigE Vision cameras, front and rear, and ``more`` tables."""
    front, rear = (
        f'driver = "aravis"\ndevice = "{address}"\ntrigger = "{trigger}"\n'
        f"exposure.exposure_ms = {EXPOSURES_MS[name]}"
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
        self._running = self._life.enter_context(child(self._command, self._log))
        self._running.await_text(_READY)
        return time.monotonic()

    def kill(self) -> None:
        """Kill the process without notice."""
        self._running.kill()

    def stop(self) -> None:
        """Suspend the process: nothing is answered."""
        self._running.send(signal.SIGSTOP)

    def go_on(self) -> float:
        """Resume the process; return when, monotonic s."""
        self._running.send(signal.SIGCONT)
        return time.monotonic()


@contextlib.contextmanager
def both_cameras(folder: Path, *more: str) -> Iterator[Child]:
    """Serve both cameras in one process; yield when they are available."""
    with child(cameras_command(SEED, *more), folder / "cameras.log") as cameras:
        cameras.await_text(_READY)
        yield cameras


@contextlib.contextmanager
def camera_behind_link(folder: Path) -> Iterator[Child]:
    """Serve the front camera in its own namespace, at the far end of a pair of virtual Ethernet cards."""
    serve = cameras_command(SEED, "--only", "front", "--front", LINKED)
    setup = f"ip link set lo up; until ip address add {LINKED}/24 dev far 2>/dev/null; do sleep 0.05; done"
    shell = f'{setup}; ip link set far up; exec "$@"'
    with child(["unshare", "-n", "sh", "-c", shell, "sh", *serve], folder / "linked.log") as camera:
        time.sleep(0.3)  # until unshare has made the namespace
        ip("link", "add", "near", "type", "veth", "peer", "name", "far", "netns", str(camera.process.pid))
        ip("address", "add", f"{NEAR}/24", "dev", "near")
        set_link("up")
        camera.await_text(_READY)
        yield camera


def set_link(state: str) -> float:
    """Disconnect the link (``down``) or reconnect it (``up``); return when, monotonic s."""
    ip("link", "set", "near", state)
    return time.monotonic()


@contextlib.contextmanager
def measuring_daemon(
    folder: Path, calibration: Path, addresses: tuple[str, str], more: str = "", trigger: str = "free"
) -> Iterator[tuple[Child, Watch]]:
    """Run the daemon on the cameras at these addresses, with ``more`` tables, and a client that reads it."""
    ports = Ports.free()
    config = write_config(folder / "altd.toml", f"SIM-{SEED}", calibration, addresses, ports, more, trigger)
    log = folder / "altd.log"
    log.write_bytes(b"")
    with child(daemon_command(config), log) as daemon:
        daemon.await_text("measuring")
        with Watch(ports) as watch:
            yield daemon, watch


def ip(*arguments: str) -> None:
    """Change the network configuration; raises CalledProcessError."""
    subprocess.run(["ip", *arguments], check=True)  # noqa: S603, S607
