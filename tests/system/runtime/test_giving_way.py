"""Time until a thread gets the interpreter from one that computes, and the daemons concerned."""

import asyncio
import contextlib
import gc
import threading
import time

import pytest
from support.unit_toml import TARGETS

from altd.app.daemon import Daemon
from altd.config import Config
from altd.measuring.calibration import Calibration
from altd.runtime.threads import real_time_interpreter
from hw_sim.camera import make_cameras
from hw_sim.unit import Unit, UnitConfig


def median_wait_s(tries: int) -> float:
    """For the interpreter, while another thread computes without ever giving way.

    On a busy machine that thread may have no processor when it could compute; such a try does not count.
    """
    ended = threading.Event()
    sums = 0

    def compute() -> None:
        nonlocal sums
        while not ended.is_set():
            sums += sum(range(100)) > 0

    thread = threading.Thread(target=compute)
    thread.start()
    waits_s: list[float] = []
    while len(waits_s) < tries:
        time.sleep(0.001)
        sums_before, before_s = sums, time.monotonic()
        time.sleep(0)  # gives the interpreter away, and wants it back
        if sums > sums_before:
            waits_s.append(time.monotonic() - before_s)
    ended.set()
    thread.join()
    return sorted(waits_s)[tries // 2]


@pytest.mark.alone
def test_a_thread_that_computes_gives_way_soon() -> None:
    """Half of the waits: the longer ones are the machine's."""
    with real_time_interpreter():
        soon_s = median_wait_s(40)
    assert soon_s < 0.003
    assert median_wait_s(40) > soon_s


async def test_a_daemon_without_lamps_runs_so_to_its_end(calibration_of_unit_3: Calibration) -> None:
    """It once went on as an ordinary program after its start: a garbage collection then took 85 ms."""
    cameras = {camera.name: camera for camera in make_cameras(Unit(UnitConfig(seed=3)))}
    settings = {
        "unit": {"serial": "SIM-3", "calibration": "unused.json"},
        "targets": TARGETS,
        "cameras": {name: {"driver": "aravis", "device": "simulated instead"} for name in cameras},
        "measuring": {"pair_by": "time"},
    }
    daemon = Daemon(Config.model_validate(settings), calibration_of_unit_3, cameras, rehearsal=True)
    running = asyncio.create_task(daemon.run())
    async with asyncio.timeout(60):
        await daemon.board.cursor().next()
    assert gc.get_freeze_count() > 10_000
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running
    assert gc.get_freeze_count() == 0
