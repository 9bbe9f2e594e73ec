"""A unit of processes in a network of its own: cameras to do faults to, the daemon, and who reads from it."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.live.parts import Ports, Running, cameras_command, daemon_command, running, write_config
from benchmarks.live.watch import Watch

SEED = 1
FRONT, REAR = "127.0.0.1", "127.0.0.2"
LINKED = "10.77.0.2"
"""The front camera's address where it stands behind a link of its own."""
_UNITS_END = "10.77.0.1"
_READY = "Ctrl-C ends it"


class Camera(contextlib.AbstractContextManager["Camera"]):
    """One camera in a process of its own, to be killed, stopped and started."""

    def __init__(self, folder: Path, name: str, address: str) -> None:
        self._command = cameras_command(SEED, "--only", name, f"--{name}", address)
        self._log = folder / f"{name}.log"
        self._life = contextlib.ExitStack()
        self.start()

    def __exit__(self, *_: object) -> None:
        self._life.close()

    def start(self) -> float:
        """Serve; returns when the camera was there, monotonic s."""
        self._log.write_bytes(b"")
        self._running = self._life.enter_context(running(self._command, self._log))
        self._running.await_text(_READY)
        return time.monotonic()

    def kill(self) -> None:
        """Gone from one instant to the next."""
        self._running.process.kill()
        self._running.process.wait()

    def stop(self) -> None:
        """There, but dead: nothing is answered."""
        self._running.send(signal.SIGSTOP)

    def go_on(self) -> float:
        """Alive again; returns since when, monotonic s."""
        self._running.send(signal.SIGCONT)
        return time.monotonic()


@contextlib.contextmanager
def both_cameras(folder: Path, *more: str) -> Iterator[Running]:
    """Both in one process, once they serve."""
    with running(cameras_command(SEED, *more), folder / "cameras.log") as cameras:
        cameras.await_text(_READY)
        yield cameras


@contextlib.contextmanager
def camera_behind_link(folder: Path) -> Iterator[Running]:
    """The front camera in a namespace of its own, at the far end of a pair of virtual Ethernet cards."""
    serve = cameras_command(SEED, "--only", "front", "--front", LINKED)
    setup = f"ip link set lo up; until ip address add {LINKED}/24 dev far 2>/dev/null; do sleep 0.05; done"
    shell = f'{setup}; ip link set far up; exec "$@"'
    with running(["unshare", "-n", "sh", "-c", shell, "sh", *serve], folder / "linked.log") as camera:
        time.sleep(0.3)  # until unshare has made the namespace
        ip("link", "add", "near", "type", "veth", "peer", "name", "far", "netns", str(camera.process.pid))
        ip("address", "add", f"{_UNITS_END}/24", "dev", "near")
        set_link("up")
        camera.await_text(_READY)
        yield camera


def set_link(state: str) -> float:
    """Pull the front camera's link (``down``) or put it back (``up``); returns when, monotonic s."""
    ip("link", "set", "near", state)
    return time.monotonic()


@contextlib.contextmanager
def measuring_daemon(
    folder: Path, calibration: Path, addresses: tuple[str, str], more: str = ""
) -> Iterator[tuple[Running, Watch]]:
    """The daemon on the cameras at these addresses, with ``more`` tables, and somebody who reads from it."""
    ports = Ports.free()
    config = write_config(folder / "altd.toml", f"SIM-{SEED}", calibration, addresses, ports, more)
    log = folder / "altd.log"
    log.write_bytes(b"")
    with running(daemon_command(config), log) as daemon:
        daemon.await_text("measuring")
        with Watch(ports) as watch:
            yield daemon, watch


def ip(*arguments: str) -> None:
    """Change the network; raises CalledProcessError."""
    subprocess.run(["ip", *arguments], check=True)  # noqa: S603, S607
