"""``python -m benchmarks.live.measure`` (``make bench-live``): the whole unit on GigE Vision, with faults.

It must run in its own network namespace, where it may add addresses and links: ``unshare -rn``. Losses,
intervals between values, cost and errors of a unit that measures undisturbed are compared with a unit without
a wire: ``beside CONFIG SEED SECONDS``, at the same time.
"""

import asyncio
import contextlib
import dataclasses
import json
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of
from altd.config import load_config
from altd.status.measurement_json import as_object
from benchmarks.harness import KEYS, Child, Columns, Parser, end, reporter, write_json
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
    set_link,
)
from benchmarks.live.watch import Recovery, Watch, measure_fault
from benchmarks.process_memory import ProcessSample, growth_mb_per_hour
from hw_sim.camera import make_cameras
from hw_sim.gige.command import make_unit
from hw_sim.unit import CAMERAS, Unit


@dataclass(frozen=True, slots=True)
class Truthfulness:
    """RMS of the errors against the scene's truth, and relative to the published sigma, by quantity."""

    rms: dict[str, float]
    rms_in_sigmas: dict[str, float]


def truthfulness(unit: Unit, measurements: Iterable[dict[str, Any]]) -> Truthfulness:
    """Errors of measurements against the machine's position, without its vibration, at their times."""
    errors: dict[str, list[float]] = {name: [] for name in KEYS}
    ratios: dict[str, list[float]] = {name: [] for name in KEYS}
    for one in measurements:
        truth = unit.truth(round(one["t_s"] * 1e9), vibration=False)
        for name in KEYS:
            errors[name].append(one[name] - getattr(truth, name))
            ratios[name].append(errors[name][-1] / one["sigma"][name])
    return Truthfulness(
        {name: _rms(values) for name, values in errors.items()},
        {name: _rms(values) for name, values in ratios.items()},
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else math.nan


_FULL_WINDOW_S = 1.5


@dataclass(frozen=True, slots=True)
class Steady:
    """One undisturbed run. An interval is the time between arrivals of two successive measurements.

    ``lost`` are the unit's own counters: exposures that a camera did not deliver, frames that the daemon
    dropped or that were late. ``unpaired`` are exposures of one camera alone.
    """

    seconds: float
    measurements: int
    invalid: dict[str, int]
    """Numbers of invalid measurements by their reasons."""
    lost: dict[str, int]
    unpaired: int
    interval_p50_ms: float
    interval_p99_ms: float
    interval_max_ms: float
    cpu_ms_a_pair: float
    cpu_share: float
    errors: Truthfulness
    modbus_p99_ms: float
    lag_ms: float
    process: list[ProcessSample]
    """Samples of the daemon's process, at least twelve over the run."""


def measure_steady(watch: Watch, daemon: Child, unit: Unit, seconds: float) -> Steady:
    """Observe a daemon that is already measuring for ``seconds``."""
    time.sleep(_FULL_WINDOW_S)
    before = watch.status()["components"]
    first, cpu_s, began_s = len(watch.seen), daemon.cpu_s(), time.monotonic()
    samples = list(_samples(daemon, seconds))
    cpu_s, seconds = daemon.cpu_s() - cpu_s, time.monotonic() - began_s
    seen = watch.seen[first:]
    after = watch.status()["components"]
    if watch.failure is not None:
        raise watch.failure
    intervals_ms = 1e3 * np.diff([one.arrived_s for one in seen])
    p50_ms, p99_ms = (float(value) for value in np.percentile(intervals_ms, (50, 99)))
    frames = {name: _increase(before, after, f"camera {name}", "frames") for name in CAMERAS}
    return Steady(
        seconds=seconds,
        measurements=len(seen),
        invalid=dict(Counter(", ".join(sorted(one.reasons)) for one in seen if not one.valid)),
        lost=_lost(before, after),
        unpaired=_increase(before, after, "measuring", "measurements") - min(frames.values()),
        interval_p50_ms=p50_ms,
        interval_p99_ms=p99_ms,
        interval_max_ms=float(intervals_ms.max()),
        cpu_ms_a_pair=1e3 * cpu_s / len(seen),
        cpu_share=cpu_s / seconds,
        errors=truthfulness(unit, (one.measurement for one in seen if one.valid)),
        modbus_p99_ms=1e3 * float(np.percentile(watch.polled.took_s, 99)),
        lag_ms=float(after["measuring"].get("lag_rear_ms", math.nan)),
        process=samples,
    )


def _samples(daemon: Child, seconds: float) -> Iterator[ProcessSample]:
    """Wait for ``seconds``; yield a sample at the beginning, and after each twelfth or minute."""
    began_s, interval_s = time.monotonic(), min(60.0, seconds / 12)
    for due_s in np.arange(0.0, seconds + interval_s / 2, interval_s):
        time.sleep(max(began_s + due_s - time.monotonic(), 0.0))
        yield ProcessSample.taken(due_s / 3600, daemon.process.pid)


def _lost(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, int]:
    lost = {f"{name} camera": _increase(before, after, f"camera {name}", "lost") for name in CAMERAS}
    lost |= {f"{name} dropped": _increase(before, after, "measuring", f"dropped_{name}") for name in CAMERAS}
    return lost | {"late": _increase(before, after, "measuring", "late_frames")}


def _increase(before: Mapping[str, Any], after: Mapping[str, Any], component: str, counter: str) -> int:
    return int(after[component].get(counter, 0)) - int(before[component].get(counter, 0))


_VALID_TIMEOUT_S = 30.0
_WARM_SHARE = 1 / 6
"""Share of the time in which buffers fill up."""
_MIN_GROWTH_S = 600.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the same figures to ``--json``."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["beside"]:
        return _measure_beside(Path(arguments[1]), int(arguments[2]), float(arguments[3]))
    parser = Parser("benchmarks.live.measure", __doc__)
    parser.number("--seconds", 60.0, "of the undisturbed run")
    parser.add_argument("--no-faults", action="store_true", help="the undisturbed run alone")
    parser.json()
    options = parser.parse_args(arguments)
    ip("link", "set", "lo", "up")
    ip("address", "add", f"{REAR}/32", "dev", "lo")
    with off_the_daemons_core(), tempfile.TemporaryDirectory(prefix="altd-live-") as name:
        folder = Path(name)
        calibration = calibrate(SEED, folder)
        steady, in_process = _undisturbed(folder, calibration, options.seconds)
        print("\n".join(_steady_lines(steady, in_process)), flush=True)
        recoveries = [] if options.no_faults else list(_faults(folder, calibration))
    write_json(options.json, {"steady": steady, "in_process": in_process, "faults": recoveries})
    return 0


def _undisturbed(folder: Path, calibration: Path, seconds: float) -> tuple[Steady, Truthfulness]:
    with (
        both_cameras(folder, "--drive"),
        measuring_daemon(folder, calibration, (FRONT, REAR)) as (daemon, watch),
    ):
        watch.first(lambda seen: seen.valid, 0.0, _VALID_TIMEOUT_S)
        config = folder / "altd.toml"
        with reporter("benchmarks.live.measure", "beside", config, SEED, seconds) as in_process:
            steady = measure_steady(watch, daemon, make_unit(SEED, drive=True), seconds)
            return steady, Truthfulness(**json.loads(in_process.result()))


def _measure_beside(config: Path, seed: int, seconds: float) -> int:
    """Measure without a wire and print the errors as JSON.

    The drive and the vibration of a simulated unit are functions of the machine's clock. This daemon, which
    gets its cameras directly, therefore measures the same scene as the daemon on the wire.
    """
    unit = make_unit(seed, drive=True)
    measurements = asyncio.run(_measured(config, unit, seconds))
    print(json.dumps(dataclasses.asdict(truthfulness(unit, measurements))))
    return 0


async def _measured(config_file: Path, unit: Unit, seconds: float) -> list[dict[str, Any]]:
    """Valid measurements within the duration."""
    with_faces = load_config(config_file)
    config = with_faces.model_copy(update={"cameras": {}, "http": None, "modbus_tcp": None})
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    daemon = Daemon(config, calibration_of(config, cameras), cameras, rehearsal=True)
    task = asyncio.create_task(daemon.run())
    cursor = daemon.board.cursor()
    measurements: list[dict[str, Any]] = []
    try:
        async with asyncio.timeout(seconds):
            while True:
                measurement = await cursor.next()
                if measurement.valid:
                    measurements.append(as_object(measurement))
    except TimeoutError:
        return measurements
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def _faults(folder: Path, calibration: Path) -> Iterator[Recovery]:
    """Measure each fault on the same daemon, one after another."""
    print(_FAULTS.head, flush=True)
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

        for fault, inject, restore, lasts_s in (
            ("killed, started again at once", front.kill, front.start, 0.0),
            ("killed, started again after 3 s", front.kill, front.start, 3.0),
            ("killed, started again after 12 s", front.kill, front.start, 12.0),
            ("stopped for 2 s", front.stop, front.go_on, 2.0),
            ("stopped for 10 s", front.stop, front.go_on, 10.0),
            ("both killed, the rear one first again", kill_both, rear_first, 2.0),
        ):
            yield _told(watch, fault, inject, restore, lasts_s)
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
    words = f"  {', '.join(recovery.reasons)}; {recovery.health}"
    times = recovery.invalid_after_s, recovery.valid_after_s, recovery.modbus_slowest_ms
    print(_FAULTS.row(fault, *times, words), flush=True)
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
    yield _ERRORS.head
    for name in KEYS:
        wire, bare = steady.errors.rms[name], in_process.rms[name]
        yield _ERRORS.row(name, wire, bare, wire / bare, steady.errors.rms_in_sigmas[name])


_ERRORS = Columns(
    "rms error:<12", "GigE Vision:>14.5f", "in process:>14.5f", "ratio:>8.2f", "in sigmas:>11.2f"
)
_FAULTS = Columns("fault:<40", "invalid s:>10.2f", "valid s:>9.2f", "Modbus ms:>11.1f", "  said:")


if __name__ == "__main__":
    end(main, "benchmarks.live.measure")
