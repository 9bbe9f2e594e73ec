"""``python -m benchmarks.live.measure`` (``make bench-live``): the whole unit on GigE Vision, with faults.

It must run in its own network namespace, where it may add addresses and links: ``unshare -rn``.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from altd.process.endings import run_to_end
from benchmarks.live.parts import (
    FRONT,
    LINKED,
    REAR,
    SEED,
    Camera,
    both_cameras,
    calibrate,
    camera_behind_link,
    ip,
    measuring_daemon,
    off_the_daemons_core,
    running,
    set_link,
)
from benchmarks.live.steady import QUANTITIES, Steady, Truthfulness, measure_steady
from benchmarks.live.watch import Recovery, Watch, measure_fault
from benchmarks.process_memory import growth_mb_per_hour
from hw_sim.gige.command import make_unit

_VALID_TIMEOUT_S = 30.0
_WARM_SHARE = 1 / 6
"""Share of the time in which buffers fill up."""
_MIN_GROWTH_S = 600.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the same figures to ``--json``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live.measure", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the undisturbed run (60)")
    parser.add_argument("--no-faults", action="store_true", help="the undisturbed run alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    options = parser.parse_args(arguments)
    ip("link", "set", "lo", "up")
    ip("address", "add", f"{REAR}/32", "dev", "lo")
    with off_the_daemons_core(), tempfile.TemporaryDirectory(prefix="altd-live-") as name:
        folder = Path(name)
        calibration = calibrate(SEED, folder)
        steady, in_process = _undisturbed(folder, calibration, options.seconds)
        print("\n".join(_steady_lines(steady, in_process)), flush=True)
        recoveries = [] if options.no_faults else list(_faults(folder, calibration))
    if options.json:
        figures = {
            "steady": dataclasses.asdict(steady),
            "in_process": dataclasses.asdict(in_process),
            "faults": [dataclasses.asdict(recovery) for recovery in recoveries],
        }
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


def _undisturbed(folder: Path, calibration: Path, seconds: float) -> tuple[Steady, Truthfulness]:
    with (
        both_cameras(folder, "--drive"),
        measuring_daemon(folder, calibration, (FRONT, REAR)) as (daemon, watch),
    ):
        watch.first(lambda seen: seen.valid, 0.0, _VALID_TIMEOUT_S)
        beside = [sys.executable, "-m", "benchmarks.live.steady", str(folder / "altd.toml")]
        with running([*beside, str(SEED), str(seconds)], folder / "in_process.log") as in_process:
            steady = measure_steady(watch, daemon, make_unit(SEED, drive=True), seconds)
            in_process.process.wait(_VALID_TIMEOUT_S)
            return steady, Truthfulness(**json.loads(in_process.output))


def _faults(folder: Path, calibration: Path) -> Iterator[Recovery]:
    """Measure each fault on the same daemon, one after another."""
    print(_FAULT_HEAD, flush=True)
    with (
        Camera(folder, "front", FRONT) as front,
        Camera(folder, "rear", REAR) as rear,
        measuring_daemon(folder, calibration, (FRONT, REAR)) as (_, watch),
    ):

        def kill_both() -> None:
            front.kill()
            rear.kill()

        def rear_first() -> float:
            rear.start()
            time.sleep(1.0)
            return front.start()

        yield _told(watch, "killed, started again at once", front.kill, front.start, 0.0)
        yield _told(watch, "killed, started again after 3 s", front.kill, front.start, 3.0)
        yield _told(watch, "killed, started again after 12 s", front.kill, front.start, 12.0)
        yield _told(watch, "stopped for 2 s", front.stop, front.go_on, 2.0)
        yield _told(watch, "stopped for 10 s", front.stop, front.go_on, 10.0)
        yield _told(watch, "both killed, the rear one first again", kill_both, rear_first, 2.0)
    with contextlib.ExitStack() as parts:
        parts.enter_context(camera_behind_link(folder))
        parts.enter_context(Camera(folder, "rear", REAR))
        _, watch = parts.enter_context(measuring_daemon(folder, calibration, (LINKED, REAR)))
        for lasts_s in (2.0, 10.0):
            fault = f"link pulled for {lasts_s:g} s"
            yield _told(watch, fault, lambda: set_link("down"), lambda: set_link("up"), lasts_s)


def _told(
    watch: Watch, fault: str, inject: Callable[[], object], restore: Callable[[], float], lasts_s: float
) -> Recovery:
    recovery = measure_fault(watch, fault, "front", inject, restore, lasts_s)
    print(_fault_line(recovery), flush=True)
    return recovery


def _steady_lines(steady: Steady, in_process: Truthfulness) -> Iterator[str]:
    invalid = ", ".join(f"{count} {reasons}" for reasons, count in steady.invalid.items())
    lost = ", ".join(f"{what} {count}" for what, count in steady.lost.items())
    yield (
        f"undisturbed, {steady.seconds:.0f} s: {steady.measurements} measurements; "
        f"rear camera {steady.lag_ms:g} ms behind the front one"
    )
    yield f"lost: {lost}, unpaired {steady.unpaired}; invalid: {invalid or 'none'}"
    yield (
        f"interval p50 {steady.interval_p50_ms:.2f} ms, p99 {steady.interval_p99_ms:.2f} ms, largest "
        f"{steady.interval_max_ms:.2f} ms; Modbus p99 {steady.modbus_p99_ms:.2f} ms; daemon "
        f"{steady.cpu_ms_a_pair:.2f} ms CPU a pair, {steady.cpu_share:.1%} of a core"
    )
    warm = [sample for sample in steady.process if sample.hour >= _WARM_SHARE * steady.process[-1].hour]
    yield from (f"daemon after {sample}" for sample in (*warm[: -1 : max(len(warm) // 6, 1)], warm[-1]))
    growth = (
        f"{growth_mb_per_hour(warm):+.2f} MB an hour"
        if steady.seconds >= _MIN_GROWTH_S
        else "too short to tell"
    )
    yield f"memory grows between: {growth}"
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
    sys.exit(run_to_end(main, lambda: "benchmarks.live.measure"))
