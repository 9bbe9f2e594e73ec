"""A unit that measures undisturbed: losses, intervals between values, cost, and errors.

``python -m benchmarks.live.steady`` runs the same unit without a wire, at the same time.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of
from altd.config import load_config
from altd.status.measurement_json import as_object
from benchmarks.live.parts import Running
from benchmarks.live.watch import Watch
from benchmarks.process_memory import ProcessSample
from hw_sim.camera import make_cameras
from hw_sim.gige.command import make_unit
from hw_sim.unit import CAMERAS, Unit

QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


@dataclass(frozen=True, slots=True)
class Truthfulness:
    """RMS of the errors against the scene's truth, and relative to the published sigma, by quantity."""

    rms: dict[str, float]
    rms_in_sigmas: dict[str, float]


def truthfulness(unit: Unit, measurements: Iterable[dict[str, Any]]) -> Truthfulness:
    """Errors of measurements against the machine's position, without its vibration, at their times."""
    errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    ratios: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    for one in measurements:
        truth = unit.truth(round(one["t_s"] * 1e9), vibration=False)
        for name in QUANTITIES:
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


def measure_steady(watch: Watch, daemon: Running, unit: Unit, seconds: float) -> Steady:
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


def _samples(daemon: Running, seconds: float) -> Iterator[ProcessSample]:
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


def main() -> int:
    """Measure without a wire and print the errors as JSON: arguments CONFIG SEED SECONDS.

    The drive and the vibration of a simulated unit are functions of the machine's clock. This daemon, which
    gets its cameras directly, therefore measures the same scene as the daemon on the wire.
    """
    config, seed, seconds = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
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


if __name__ == "__main__":
    sys.exit(main())
