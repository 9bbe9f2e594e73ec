"""A unit that measures undisturbed: losses, how evenly values come, what they cost, how true they are."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from altd.app import Daemon, calibration_of
from altd.config import load_config
from altd.measurement_json import as_object
from benchmarks.live.parts import Running
from benchmarks.live.watch import Seen, Watch
from hw_sim.camera import make_cameras
from hw_sim.unit import Unit

QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
FPS = 20.0
_FULL_WINDOW_S = 1.5


@dataclass(frozen=True, slots=True)
class Truthfulness:
    """Rms of the errors against the scene's truth, and in units of the published sigma, by quantity."""

    rms: dict[str, float]
    rms_in_sigmas: dict[str, float]


@dataclass(frozen=True, slots=True)
class Steady:
    """One undisturbed run. An interval is from one measurement's arrival at a reader to the next one's."""

    seconds: float
    measurements: int
    invalid: int
    pairs_lost: int
    interval_p50_ms: float
    interval_p99_ms: float
    interval_max_ms: float
    cpu_ms_a_pair: float
    cpu_share: float
    errors: Truthfulness
    modbus_p99_ms: float
    lag_ms: float


def measure_steady(watch: Watch, daemon: Running, unit: Unit, seconds: float) -> Steady:
    """Watch a daemon that is measuring already for ``seconds``."""
    time.sleep(_FULL_WINDOW_S)
    first, cpu_s, began_s = len(watch.seen), daemon.cpu_s(), time.monotonic()
    time.sleep(seconds)
    cpu_s, seconds = daemon.cpu_s() - cpu_s, time.monotonic() - began_s
    seen = watch.seen[first:]
    if watch.failure is not None:
        raise watch.failure
    components = watch.status()["components"]
    intervals_ms = 1e3 * np.diff([one.arrived_s for one in seen])
    sequences = np.array([one.said["sequence"] for one in seen])
    missed = int((np.diff(sequences) - 1).clip(0).sum())
    flawed = sum("exposures_lost" in one.reasons for one in seen)
    p50_ms, p99_ms = (float(value) for value in np.percentile(intervals_ms, (50, 99)))
    return Steady(
        seconds=seconds,
        measurements=len(seen),
        invalid=sum(not one.valid for one in seen),
        pairs_lost=missed + flawed,
        interval_p50_ms=p50_ms,
        interval_p99_ms=p99_ms,
        interval_max_ms=float(intervals_ms.max()),
        cpu_ms_a_pair=1e3 * cpu_s / len(seen),
        cpu_share=cpu_s / seconds,
        errors=truthfulness(unit, (one.said for one in seen if one.valid)),
        modbus_p99_ms=1e3 * float(np.percentile(watch.polled.took_s, 99)),
        lag_ms=float(components["measuring"].get("lag_rear_ms", math.nan)),
    )


def truthfulness(unit: Unit, said: Iterable[dict[str, object]]) -> Truthfulness:
    """The errors of measurements against where the machine was, its shaking aside, at their times."""
    errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    ratios: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    for one in said:
        t_s, sigma = one["t_s"], one["sigma"]
        assert isinstance(t_s, float)  # noqa: S101  the stream's own type
        assert isinstance(sigma, dict)  # noqa: S101
        truth = unit.truth(round(t_s * 1e9), vibration=False)
        for name in QUANTITIES:
            value = one[name]
            assert isinstance(value, float)  # noqa: S101
            errors[name].append(value - float(getattr(truth, name)))
            ratios[name].append(errors[name][-1] / float(sigma[name]))
    return Truthfulness(
        {name: _rms(values) for name, values in errors.items()},
        {name: _rms(values) for name, values in ratios.items()},
    )


def measure_in_process(config: Path, unit: Unit, seconds: float) -> Truthfulness:
    """The same unit and settings, its cameras without a wire: what the wire may cost is told by the ratio."""
    return asyncio.run(_in_process(config, unit, seconds))


async def _in_process(config_file: Path, unit: Unit, seconds: float) -> Truthfulness:
    config = load_config(config_file).model_copy(update={"cameras": {}, "http": None, "modbus_tcp": None})
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    daemon = Daemon(config, calibration_of(config, cameras), cameras)
    task = asyncio.create_task(daemon.run())
    cursor = daemon.board.cursor()
    said: list[Seen] = []
    try:
        async with asyncio.timeout(seconds + _FULL_WINDOW_S):
            while True:
                measurement = await cursor.next()
                said.append(Seen(time.monotonic(), as_object(measurement)))
    except TimeoutError:
        pass
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    return truthfulness(unit, (one.said for one in said[round(_FULL_WINDOW_S * FPS) :] if one.valid))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else math.nan
