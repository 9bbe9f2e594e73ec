"""``python -m benchmarks.live.measure`` (``make bench-live``): the whole unit on GigE Vision, well and ill.

To be run in a network namespace of its own, where it may add addresses and links: ``unshare -rn``.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from benchmarks.live.faults import Recovery, measure_fault
from benchmarks.live.parts import (
    Running,
    calibrate,
    cameras_command,
    daemon_command,
    free_port,
    running,
    write_config,
)
from benchmarks.live.steady import Steady, measure_steady
from benchmarks.live.truth import QUANTITIES, Truthfulness
from benchmarks.live.watch import Watch
from hw_sim.gige.command import make_unit

SEED = 1
FRONT, REAR = "127.0.0.1", "127.0.0.2"
LINKED = "10.77.0.2"
"""The front camera's address where it stands behind a link of its own."""
_UNIT_END = "10.77.0.1"
_READY = "Ctrl-C ends it"
_WITHIN_S = 30.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the same figures to ``--json``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live.measure", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the undisturbed run (60)")
    parser.add_argument("--no-faults", action="store_true", help="the undisturbed run alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    options = parser.parse_args(arguments)
    _ip("link", "set", "lo", "up")
    _ip("address", "add", f"{REAR}/32", "dev", "lo")
    with tempfile.TemporaryDirectory(prefix="altd-live-") as name:
        folder = Path(name)
        calibration = calibrate(SEED, folder)
        steady, in_process = _undisturbed(folder, calibration, options.seconds)
        print("\n".join(_steady_lines(steady, in_process)), flush=True)
        recoveries = [] if options.no_faults else _faults(folder, calibration)
    if options.json:
        figures = {
            "steady": dataclasses.asdict(steady),
            "in_process": dataclasses.asdict(in_process),
            "faults": [dataclasses.asdict(recovery) for recovery in recoveries],
        }
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


def _undisturbed(folder: Path, calibration: Path, seconds: float) -> tuple[Steady, Truthfulness]:
    log = folder / "in_process.log"
    with (
        running(cameras_command(SEED, "--drive"), folder / "cameras.log") as cameras,
        _daemon(folder, calibration, (FRONT, REAR), cameras) as (daemon, watch),
    ):
        watch.first(lambda seen: seen.valid, 0.0, _WITHIN_S)
        command = [sys.executable, "-m", "benchmarks.live.in_process", str(folder / "altd.toml")]
        with running([*command, str(SEED), str(seconds)], log) as in_process:
            steady = measure_steady(watch, daemon, make_unit(SEED, drive=True), seconds)
            in_process.process.wait(_WITHIN_S)
            return steady, Truthfulness(**json.loads(in_process.said))


def _faults(folder: Path, calibration: Path) -> list[Recovery]:
    """Each fault on the same daemon, one after the other."""
    print(_FAULT_HEAD, flush=True)
    recoveries = []
    with contextlib.ExitStack() as parts:
        front, rear = (
            parts.enter_context(_Camera(folder, name, address))
            for name, address in (("front", FRONT), ("rear", REAR))
        )
        _, watch = parts.enter_context(_daemon(folder, calibration, (FRONT, REAR), front.running))

        def measured(
            fault: str, strike: Callable[[], None], mend: Callable[[], float], lasts_s: float
        ) -> None:
            recoveries.append(measure_fault(watch, fault, "front", strike, mend, lasts_s))
            print(_fault_line(recoveries[-1]), flush=True)

        def kill_both() -> None:
            front.kill()
            rear.kill()

        def rear_first() -> float:
            rear.start()
            time.sleep(1.0)
            return front.start()

        measured("killed, started again at once", front.kill, front.start, 0.0)
        measured("killed, started again after 3 s", front.kill, front.start, 3.0)
        measured("killed, started again after 12 s", front.kill, front.start, 12.0)
        measured("stopped for 2 s", front.stop, front.go_on, 2.0)
        measured("stopped for 10 s", front.stop, front.go_on, 10.0)
        measured("both killed, the rear one first again", kill_both, rear_first, 2.0)
    with _behind_link(folder) as camera, contextlib.ExitStack() as parts:
        parts.enter_context(_Camera(folder, "rear", REAR))
        _, watch = parts.enter_context(_daemon(folder, calibration, (LINKED, REAR), camera))
        for lasts_s in (2.0, 10.0):
            fault = f"link pulled for {lasts_s:g} s"
            recovery = measure_fault(
                watch, fault, "front", lambda: _link("down"), lambda: _link("up"), lasts_s
            )
            recoveries.append(recovery)
            print(_fault_line(recovery), flush=True)
    return recoveries


class _Camera(contextlib.AbstractContextManager["_Camera"]):
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
        self.running = self._life.enter_context(running(self._command, self._log))
        self.running.await_word(_READY)
        return time.monotonic()

    def kill(self) -> None:
        """Gone from one instant to the next."""
        self.running.process.kill()
        self.running.process.wait()

    def stop(self) -> None:
        """There, but dead: nothing is answered."""
        self.running.send(signal.SIGSTOP)

    def go_on(self) -> float:
        """Alive again; returns since when, monotonic s."""
        self.running.send(signal.SIGCONT)
        return time.monotonic()


@contextlib.contextmanager
def _daemon(
    folder: Path, calibration: Path, addresses: tuple[str, str], camera: Running
) -> Iterator[tuple[Running, Watch]]:
    """The daemon, and somebody who reads from it."""
    camera.await_word(_READY)
    config, http_port, modbus_port = _config(folder, calibration, addresses)
    log = folder / "altd.log"
    log.write_bytes(b"")
    with running(daemon_command(config), log) as daemon:
        daemon.await_word("measuring")
        with Watch(http_port, modbus_port) as watch:
            yield daemon, watch


def _config(folder: Path, calibration: Path, addresses: tuple[str, str]) -> tuple[Path, int, int]:
    http_port, modbus_port = free_port(), free_port()
    config = write_config(folder / "altd.toml", f"SIM-{SEED}", calibration, addresses, http_port, modbus_port)
    return config, http_port, modbus_port


@contextlib.contextmanager
def _behind_link(folder: Path) -> Iterator[Running]:
    """The front camera in a namespace of its own, at the far end of a pair of virtual Ethernet cards."""
    serve = cameras_command(SEED, "--only", "front", "--front", LINKED)
    setup = f"ip link set lo up; until ip address add {LINKED}/24 dev far 2>/dev/null; do sleep 0.05; done"
    shell = f'{setup}; ip link set far up; exec "$@"'
    with running(["unshare", "-n", "sh", "-c", shell, "sh", *serve], folder / "linked.log") as camera:
        time.sleep(0.3)  # until unshare has made the namespace
        peer = ("peer", "name", "far", "netns", str(camera.process.pid))
        _ip("link", "add", "near", "type", "veth", *peer)
        _ip("address", "add", f"{_UNIT_END}/24", "dev", "near")
        _link("up")
        camera.await_word(_READY)
        yield camera


def _link(state: str) -> float:
    """Pull the front camera's link, or put it back; returns when that was done, monotonic s."""
    _ip("link", "set", "near", state)
    return time.monotonic()


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)  # noqa: S603, S607


def _steady_lines(steady: Steady, in_process: Truthfulness) -> Iterator[str]:
    lost = ", ".join(f"{what} {count}" for what, count in steady.lost.items())
    yield (
        f"undisturbed, {steady.seconds:.0f} s: {steady.measurements} measurements, {steady.invalid} invalid; "
        f"rear camera {steady.lag_ms:g} ms behind the front one"
    )
    yield f"lost: {lost}, unpaired {steady.unpaired}"
    yield (
        f"interval p50 {steady.interval_p50_ms:.2f} ms, p99 {steady.interval_p99_ms:.2f} ms, largest "
        f"{steady.interval_max_ms:.2f} ms; Modbus p99 {steady.modbus_p99_ms:.2f} ms; daemon "
        f"{steady.cpu_ms_a_pair:.2f} ms CPU a pair, {steady.cpu_share:.1%} of a core"
    )
    yield f"{'rms error':<12}{'GigE Vision':>14}{'in process':>14}{'ratio':>8}{'in sigmas':>11}"
    for name in QUANTITIES:
        wire, bare = steady.errors.rms[name], in_process.rms[name]
        in_sigmas = steady.errors.rms_in_sigmas[name]
        yield f"{name:<12}{wire:>14.5f}{bare:>14.5f}{wire / bare:>8.2f}{in_sigmas:>11.2f}"


_FAULT_HEAD = f"{'fault':<40}{'invalid s':>10}{'valid s':>9}{'Modbus ms':>11}  said"


def _fault_line(recovery: Recovery) -> str:
    return (
        f"{recovery.fault:<40}{recovery.invalid_after_s:>10.2f}{recovery.valid_after_s:>9.2f}"
        f"{recovery.modbus_slowest_ms:>11.1f}  {', '.join(recovery.reasons)}; {recovery.health}"
    )


if __name__ == "__main__":
    sys.exit(main())
