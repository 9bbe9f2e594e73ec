"""``python -m benchmarks.soak`` (``make soak``): a daemon for many hours on a stepped clock.

Two simulated cameras deliver a frame each second. History and all interfaces except OPC UA run, and are read
once a minute. Every ten minutes one camera loses a frame, once an hour both are silent for ten seconds, and
frames are kept. Memory, descriptors and threads are those of this process, including cameras and readers. The
frames are taken from a stock that is longer than the memory of the check for repeated pictures.
"""

import asyncio
import contextlib
import logging
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from altd.config import Measuring
from altd.measuring.freshness import MAX_COMPARED_FRAMES
from altd.process.endings import until_signal
from altd.records import Frame, PixelArray
from benchmarks.campaign.clips import SimulatedClip, SimulatedRig, rig_of
from benchmarks.campaign.way import CAMERAS, START_NS
from benchmarks.faults.live import LiveUnit, live_unit
from benchmarks.faults.wires import TelegramLine, Wires, wires_of
from benchmarks.harness import Parser, end, show
from benchmarks.interfaces import BROKER, broker, interfaces
from benchmarks.process_memory import ProcessSample, growth_faults, growth_mb_per_hour
from hw_sim.beam import BeamPose
from hw_sim.ports import free_port

UNIT = "plain"
MEASURING = Measuring(window=4, pair_by="time", silent_after_s=2.0, stale_after_s=5.0)
MINUTE, HOUR = 60, 3600
"""Exposures in a minute and in an hour."""
_SILENT = 10
_SAMPLE = 15 * MINUTE
"""Exposures between samples. They are taken in the middle of this interval: at a full hour the frames of the
silence are being written, and one to three of their files are open."""
_WARM_HOURS = 5.0
"""Time in which buffers, the ring of frames and the trends' minutes fill up."""
_HOURS = 1.0, 10_000.0
"""Limits of the duration."""
_TRANSFER_NS = 5_000_000


def stock_of(rig: SimulatedRig) -> dict[str, list[PixelArray]]:
    """Pictures of a beam at rest, each with independent noise."""
    rng = np.random.default_rng(1)
    count = MAX_COMPARED_FRAMES + 32
    clip = SimulatedClip(rig, BeamPose(4.0, -3.0, 0.02, -0.03), np.zeros(4), 0, count, rng)
    return {camera: [clip.snap(clip.scene(camera, k), k, rng) for k in range(count)] for camera in CAMERAS}


def lost_cameras(k: int) -> tuple[str, ...]:
    """Cameras that deliver nothing at an exposure."""
    if k % HOUR >= HOUR - _SILENT:
        return CAMERAS
    return (CAMERAS[k // (10 * MINUTE) % 2],) if k % (10 * MINUTE) == 5 * MINUTE else ()


@dataclass(frozen=True, slots=True)
class Soak:
    """Result: samples, exposures with a delivered frame, measured exposures, and losses."""

    samples: list[ProcessSample]
    delivered: int
    measured: int
    lost: int
    valid: int

    def faults(self) -> Iterator[str]:
        """Growth and losses, as text."""
        warm = [
            sample for sample in self.samples if sample.hour > min(_WARM_HOURS, self.samples[-1].hour / 2)
        ]
        print(f"memory after {warm[0].hour:g} h: {growth_mb_per_hour(warm):+.3f} MB an hour")
        yield from growth_faults(warm)
        if self.lost or self.measured != self.delivered:
            yield f"{self.lost} frames lost; {self.measured} of {self.delivered} exposures measured"


async def run(hours: float, rig: SimulatedRig, folder: Path, broker_port: int | None) -> Soak:
    """Run for this number of hours."""
    with interfaces(1) as places, contextlib.closing(TelegramLine(folder / "ttyUSB0")) as telegram:
        del places.tables["opcua"]
        places.tables["serial"][0]["interval_s"] = 1.0  # the default; a new value comes each second
        places.tables["history"] = {"file": folder / "history.db"}
        places.tables["kept_frames"] = {"folder": folder / "recordings", "disk_mb": 50}
        places.tables["mqtt"]["port"] = broker_port
        if broker_port is None:
            del places.tables["mqtt"]
        places = replace(places, mqtt_port=broker_port or 0)
        async with (
            live_unit(rig, places, telegram.device, START_NS, MEASURING) as unit,
            wires_of(places, telegram, unit.socket, has_broker=broker_port is not None) as wires,
        ):
            count, stock = round(hours * HOUR), stock_of(rig)
            samples = []
            async for sample in _samples(count, stock, unit, wires):
                samples.append(sample)
                if sample.hour % max(round(hours / 20), 1) < _SAMPLE / HOUR:  # in case the run is interrupted
                    print(f"{sample}; {unit.daemon.chain.frame_sets} exposures measured", flush=True)
            counters = unit.daemon.health.component("measuring").counters
            lost = sum(number for name, number in counters.items() if name.startswith(("dropped", "late")))
            delivered = sum(len(lost_cameras(k)) < len(CAMERAS) for k in range(count))
            return Soak(samples, delivered, unit.daemon.chain.frame_sets, lost, counters["valid"])


async def _samples(
    count: int, stock: dict[str, list[PixelArray]], unit: LiveUnit, wires: Wires
) -> AsyncIterator[ProcessSample]:
    """Expose this number of times; yield a sample each quarter of an hour."""
    for k in range(count):
        t_ns = START_NS + (k + 1) * 10**9
        await unit.clock.set(t_ns + _TRANSFER_NS)
        pixels = {camera: stock[camera][k % len(stock[camera])] for camera in CAMERAS}
        seen = [camera for camera in CAMERAS if camera not in lost_cameras(k)]
        await unit.deliver(*(Frame(camera, k, t_ns, pixels[camera], 8) for camera in seen))
        if k % MINUTE == MINUTE - 1:
            await wires.read()
        if k % _SAMPLE == _SAMPLE // 2:
            yield ProcessSample.taken((k + 1) / HOUR)
            show(f"{(k + 1) / HOUR:.2f} of {count / HOUR:g} hours")


def main() -> int:
    """Run and print; return 1 if memory, descriptors or threads grow, or a delivered exposure is lost."""
    parser = Parser("benchmarks.soak", __doc__)
    parser.number("--hours", 100.0, "of the set clock; the growth needs two samples", "HOURS", _HOURS)
    options = parser.parse_args()
    logging.getLogger("altd").setLevel(logging.CRITICAL)
    cv2.setNumThreads(1)
    rig, port, began_s = rig_of(UNIT), free_port(), time.monotonic()
    assert isinstance(rig, SimulatedRig)  # noqa: S101
    with tempfile.TemporaryDirectory() as folder, broker(port, bool(BROKER)):
        result = asyncio.run(until_signal(run(options.hours, rig, Path(folder), port if BROKER else None)))
        history_mb = Path(folder, "history.db").stat().st_size * 1e-6
    show("")
    print(
        f"{result.measured} of {result.delivered} exposures measured, {result.lost} frames lost, "
        f"{result.valid} measurements valid; history {history_mb:.1f} MB; {time.monotonic() - began_s:.0f} s"
    )
    faults = list(result.faults())
    print("\n".join(faults) or "no fault")
    return 1 if faults else 0


if __name__ == "__main__":
    end(main, "benchmarks.soak")
