"""``python -m hw_sim planar``: the 3-PRP machine moves its plate before a camera, and the daemon measures."""

import argparse
import asyncio
import itertools
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of_instrument
from altd.config import Config, HttpSettings, Unit
from altd.ports import CameraError, CameraTimeoutError
from altd.reasons import Reason
from altd.records import CameraIdentity, Frame, Measurement, Origin, counted
from hw_sim.arguments import add_demo_arguments
from hw_sim.demo import command, run_until_stopped, together
from hw_sim.double_triangle import Array, JammedError, random_motion, source_machine
from hw_sim.image import Image
from hw_sim.planar import HALF_RANGE, MACHINE_FLAWS, PlanarScene, Pose
from hw_sim.ports import free_port

PERIOD_NS = 100_000_000
"""Frame period, ten frames a second: a frame of 0.8 Mpx with its noise takes half of that to compute."""
STEP_MM = 2.0
"""Maximum travel of the joints from frame to frame."""
REST_FRAMES = 30
DARK_CYCLE = (7, 7, 5, 3, 2, 1)
"""Numbers of lit LEDs at successive rests."""
LOCALHOST = "127.0.0.1"
_OF_DEMO = {Reason.SIMULATED, Reason.REHEARSAL}
"""Warnings of every measurement in this demo."""


class PlateCamera:
    """Camera of a plate that the machine drives from rest to rest; see ``altd.ports.Camera``.

    The number of lit LEDs changes from rest to rest. ``truth`` has the true pose of each exposure.
    """

    name = "plate"
    origin = Origin.SIMULATED
    playback = False
    waits = False
    exposure_range = None

    def __init__(self, scene: PlanarScene) -> None:
        self.identity = CameraIdentity(f"SIM-PLANAR-{scene.seed}", "simulated", "hw_sim")
        self.truth: dict[int, Pose] = {}
        self._scene = scene
        self._machine = source_machine(MACHINE_FLAWS, scene.seed)
        self._rests = self._rests_mm(scene.seed)
        self._goal_mm = self._machine.joints_mm
        self._dark = itertools.cycle(DARK_CYCLE)
        self._lit: tuple[int, ...] = tuple(range(len(scene.leds_mm)))
        self._rested = 0
        self._seen: tuple[tuple[Pose, tuple[int, ...]], Image] | None = None
        self._closed = threading.Event()
        self._start_ns, self._last = 0, -1

    @staticmethod
    def _rests_mm(seed: int) -> Iterator[Array]:
        """Joints of poses within the picture, from a machine with the same errors."""
        other = source_machine(MACHINE_FLAWS, seed)
        return itertools.cycle(
            [other.joints_mm.copy() for _ in itertools.islice(random_motion(other, HALF_RANGE), 12)]
        )

    def open(self) -> None:
        """Open the camera; the first frame is due now."""
        self._start_ns = self._start_ns or time.monotonic_ns()
        self._closed.clear()

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next frame when due, or the newest due one; the plate has moved until then."""
        due = (time.monotonic_ns() - self._start_ns) // PERIOD_NS
        sequence = max(due, self._last + 1)
        wait_s = (self._start_ns + sequence * PERIOD_NS - time.monotonic_ns()) * 1e-9
        if wait_s > timeout_s:
            raise CameraTimeoutError(f"{self.name}: no frame within {timeout_s:g} s")
        if self._closed.wait(max(wait_s, 0.0)):
            raise CameraError(f"{self.name}: the camera is not open")
        for _ in range(sequence - self._last):
            self._move()
        self._last = sequence
        a_mm, b_mm, phi = self._machine.pose.tolist()
        pose = (a_mm, b_mm, math.degrees(phi))
        self.truth = dict(itertools.islice(self.truth.items(), max(len(self.truth) - 100, 0), None))
        self.truth[sequence] = pose
        state = pose, self._lit
        if self._seen is None or self._seen[0] != state:
            self._seen = state, self._scene.mean_electrons(pose, self._lit)
        pixels = self._scene.expose(self._seen[1])
        pixels.flags.writeable = False
        return Frame(self.name, sequence, self._start_ns + sequence * PERIOD_NS, pixels)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Raise CameraError: the exposure is fixed."""
        raise CameraError(f"{self.name}: the exposure is fixed")

    def close(self) -> None:
        """Close the camera; a waiting ``next_frame`` ends."""
        self._closed.set()

    def _move(self) -> None:
        """Move towards the goal by one frame; at the goal, rest and then select another goal."""
        way = self._goal_mm - self._machine.joints_mm
        if np.abs(way).max() < STEP_MM / 100:
            self._rested += 1
            if self._rested >= REST_FRAMES:
                self._rested, self._goal_mm = 0, next(self._rests)
                order = self._scene.shuffled_leds()
                self._lit = tuple(sorted(order[: next(self._dark)]))
            return
        step = way * min(STEP_MM / float(np.abs(way).max()), 1.0)
        try:
            self._machine.move(self._machine.joints_mm + step)
        except JammedError:  # on the straight path of the joints; another goal is selected
            self._goal_mm = next(self._rests)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the demo."""
    add_demo_arguments(parser, "selects camera and plate (default: 1)")


def run(arguments: argparse.Namespace) -> int:
    """Run the demo until its duration is over or a signal arrives; raises BadInputError."""
    return run_until_stopped(partial(_demo, arguments))


async def _demo(arguments: argparse.Namespace, stop: Callable[[], None]) -> None:
    """Record known poses, calibrate, and measure with the daemon."""
    scene = PlanarScene(arguments.seed)
    with tempfile.TemporaryDirectory(prefix="altd-planar-") as name:
        path = Path(name) / "planar.json"
        print(f"Recording known poses of simulated plate {scene.seed}, and calibrating ...", flush=True)
        known = str(path.with_name("known"))
        await command("hw_sim", "planar-recording", "--seed", str(scene.seed), "-o", known)
        await command("altd.cli", "calibrate", known, "-o", str(path))
        http = HttpSettings(host=LOCALHOST, port=arguments.http_port or free_port())
        unit = Unit(serial=f"SIM-PLANAR-{scene.seed}", calibration=path, instrument="planar")
        camera = PlateCamera(scene)
        config, cameras = Config(unit=unit, http=http), {camera.name: camera}
        known_by = calibration_of_instrument(config, cameras)
        daemon = Daemon(config, known_by, cameras, rehearsal=True)
        print(f"Page: http://{LOCALHOST}:{http.port}   Ctrl-C ends the demo.\n\n{_HEADING}", flush=True)
        if arguments.seconds is not None:
            asyncio.get_running_loop().call_later(arguments.seconds, stop)
        await together(daemon.run(), _show(daemon, camera))


_HEADING = f"{'a mm':>22}{'b mm':>22}{'phi °':>22}   {'error a, b mm, phi °':25}  status"


async def _show(daemon: Daemon, camera: PlateCamera) -> None:
    """Print a line each second: values, their sigma, their errors."""
    cursor = daemon.board.cursor()
    while True:
        measurement = await cursor.next()
        # in a thread: a pipe without a reader must not block the unit
        await asyncio.to_thread(print, _line(measurement, camera.truth), flush=True)
        await asyncio.sleep(1.0)


def _line(measurement: Measurement, truth: dict[int, Pose]) -> str:
    status = ", ".join(str(fault) for fault in measurement.status if fault.reason not in _OF_DEMO)
    pose = truth.get(measurement.sequence)
    if not measurement.valid or pose is None:
        return f"{'—':>22}{'—':>22}{'—':>22}   {'':25}  {status}"
    cells, errors = [], []
    for quantity, true in zip(measurement.quantities.of_unit, pose, strict=True):
        value = measurement.values[quantity.key]
        cells.append(f"{value.value:13.4f} ±{value.sigma:7.4f}")
        errors.append(f"{value.value - true:+.4f}")
    return f"{''.join(cells)}   {' '.join(errors):25}  {status or counted(measurement.frames, 'exposure')}"
