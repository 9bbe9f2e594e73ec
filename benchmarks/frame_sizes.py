"""``python -m benchmarks.frame_sizes`` (``make bench-sizes``): the real daemon on frames of several sizes.

It measures the response time, and the delays of its event loop.

Large frames are enlarged frames of hw_sim, with independent noise. Their spots are therefore also larger, and
the unit is calibrated with frames of that size.
"""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import struct
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from altd.calibration.calibrating import calibrate
from altd.recording.reader import open_recording
from altd.records import PixelArray
from benchmarks.daemon import SETTLE_S, Latency, latency_of, lost, running, watched
from benchmarks.harness import Columns, Parser, end, quiet, reporter
from benchmarks.interfaces import HOST
from benchmarks.material import CAMERAS, FPS, SEED, Material, Source, make_config, make_pairs
from hw_sim import unit as simulated
from hw_sim.flat import record_flat
from hw_sim.ports import free_port
from hw_sim.scan import Grid, record_scan
from hw_sim.stage import Stage

_CLOCK_MONOTONIC = 1
_TFD_NONBLOCK, _TFD_TIMER_ABSTIME = 0o4000, 1
_TIMES = struct.Struct("qqqq")
"""``struct itimerspec`` of time.h: interval and first expiration, each in s and ns."""
_PERIOD_NS = 1_000_000

_libc = ctypes.CDLL(None, use_errno=True)


class Ticker:
    """Records each tick's delay within ``with``, ns, in ``late_ns``; asyncio's timers resolve only 1 ms."""

    def __init__(self) -> None:
        self.late_ns: list[int] = []

    def __enter__(self) -> Ticker:
        """Start the ticks; raises OSError if the kernel provides no timer."""
        self._timer = _libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK)
        if self._timer < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._due_ns = time.monotonic_ns() + _PERIOD_NS
        times = ctypes.create_string_buffer(_TIMES.pack(0, _PERIOD_NS, *divmod(self._due_ns, 1_000_000_000)))
        if _libc.timerfd_settime(self._timer, _TFD_TIMER_ABSTIME, times, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        asyncio.get_running_loop().add_reader(self._timer, self._tick)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.get_running_loop().remove_reader(self._timer)
        os.close(self._timer)

    def _tick(self) -> None:
        (ticks,) = struct.unpack("Q", os.read(self._timer, 8))
        self.late_ns.append(time.monotonic_ns() - self._due_ns)  # delay of the first tick that was due
        self._due_ns += ticks * _PERIOD_NS


SIZES = (752, 480), (2448, 2048), (4096, 3000)

_GRID = Grid(pitch_mm=14.0, columns=4, rows=4)
"""Grid around the beam's positions; a scan of the whole area would take minutes."""
_FLAT_EXPOSURES = 4
_PAIRS = 8
_START_TIMEOUT_S = 30.0
_NOISE_COUNTS = 1.0


@dataclass(frozen=True, slots=True)
class SizeFigures:
    """A daemon that measures frames of a size, ``FPS`` pairs/s, with a Modbus TCP client that polls it.

    ``modbus`` is the time from request to answer, in the client's process; ``stalls`` is the delay of the
    event loop for a task that is due every millisecond.
    """

    width: int
    height: int
    seconds: float
    pairs: int
    lost: int
    cpu_share: float
    value: Latency
    modbus: Latency
    stalls: Latency


def measure_size(material: Material, seconds: float) -> SizeFigures:
    """Run and measure the daemon."""
    return asyncio.run(_measured(material, seconds))


async def _measured(material: Material, seconds: float) -> SizeFigures:
    source, port = Source(material, FPS), free_port()
    config = make_config(modbus_tcp={"host": HOST, "port": port})
    async with running(source, config) as daemon, watched(daemon, source) as waits_ns:
        await asyncio.sleep(SETTLE_S)
        async with asyncio.timeout(_START_TIMEOUT_S):
            while not waits_ns:  # noqa: ASYNC110  preparing the calibration takes a second
                await asyncio.sleep(0.05)
        await asyncio.sleep(SETTLE_S)
        seen, lost_before, begun_s, cpu_s = len(waits_ns), lost(daemon), time.monotonic(), time.process_time()
        with reporter("benchmarks.poller", port) as poller, Ticker() as ticker:
            await asyncio.sleep(seconds)
            printed = await asyncio.to_thread(poller.result)
        waits_ms = [1e3 * took_s for _, took_s, *_ in json.loads(printed)["polls"]]
        wall_s, cpu_s = time.monotonic() - begun_s, time.process_time() - cpu_s
        rows, columns = material.pairs[0][0].pixels.shape
        return SizeFigures(
            columns,
            rows,
            wall_s,
            len(waits_ns) - seen,
            lost(daemon) - lost_before,
            cpu_s / wall_s,
            latency_of(np.array(waits_ns[seen:]) * 1e-6),
            latency_of(np.array(waits_ms)),
            latency_of(np.array(ticker.late_ns) * 1e-6),
        )


def make_large_material(width: int, height: int, pairs: int) -> Material:
    """Material of an ordinary unit whose cameras have larger sensors behind the same lenses."""
    rng = np.random.default_rng(SEED)

    def enlarged(pixels: PixelArray) -> PixelArray:
        return _enlarged(pixels, width, height, rng)

    large = [
        (replace(front, pixels=enlarged(front.pixels)), replace(rear, pixels=enlarged(rear.pixels)))
        for front, rear in make_pairs(pairs)
    ]
    still = simulated.Unit(simulated.UnitConfig(seed=SEED))
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as folder:
        scan, flat = Path(folder, "scan"), Path(folder, "flat")
        record_scan(scan, still, Stage(np.random.default_rng(SEED)), 1, quiet, _GRID)
        record_flat(flat, still, _FLAT_EXPOSURES, quiet)
        for recorded in (scan, flat):
            _enlarge_recording(recorded, enlarged, width, height)
        calibration = calibrate([open_recording(scan)], open_recording(flat)).calibration
    return Material(tuple(large), calibration, calibration)


def _enlarged(pixels: PixelArray, width: int, height: int, rng: np.random.Generator) -> PixelArray:
    """Enlarge the picture as far as it fits, and fill the rest of the sensor from its border; 8 bits."""
    rows, columns = pixels.shape
    scale = min(width / columns, height / rows)
    size = round(columns * scale), round(rows * scale)
    picture = cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC)
    whole = cv2.copyMakeBorder(picture, 0, height - size[1], 0, width - size[0], cv2.BORDER_REPLICATE)
    noise = _NOISE_COUNTS * rng.standard_normal(whole.shape, dtype=np.float32)
    large: PixelArray = np.clip(np.rint(whole + noise), 0, 255).astype(np.uint8)
    large.flags.writeable = False
    return large


def _enlarge_recording(
    folder: Path, enlarged: Callable[[PixelArray], PixelArray], width: int, height: int
) -> None:
    for camera in CAMERAS:
        for file in sorted((folder / camera).glob("*.png")):
            picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            assert picture is not None  # noqa: S101  written by hw_sim
            cv2.imwrite(str(file), enlarged(picture.astype(np.uint8)))
    header = json.loads((folder / "recording.json").read_text())
    for camera in header["cameras"].values():
        camera |= {"width": width, "height": height}
    (folder / "recording.json").write_text(json.dumps(header) + "\n")


def main(arguments: list[str] | None = None) -> int:
    """Print a table."""
    parser = Parser("benchmarks.frame_sizes", __doc__)
    parser.number("--seconds", 20.0, "for each size")
    seconds = parser.parse_args(arguments).seconds
    print(f"{FPS:g} pairs/s, a Modbus TCP client beside; each p50, p99, max in ms; core: share of one core")
    print("      frames  pairs  lost  core      value in hands       Modbus answer       loop comes late")
    table = Columns(
        "frames:>12", "pairs:>7", "lost:>6", "core:>6.2f", *("p50:>8.2f", "p99:>6.2f", "max:>7.2f") * 3
    )
    for width, height in SIZES:
        figures = measure_size(make_large_material(width, height, _PAIRS), seconds)
        each_ms = figures.value, figures.modbus, figures.stalls
        times_ms = [time_ms for each in each_ms for time_ms in (each.p50_ms, each.p99_ms, each.max_ms)]
        row = f"{width} × {height}", figures.pairs, figures.lost, figures.cpu_share, *times_ms
        print(table.row(*row), flush=True)
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.frame_sizes")
