"""A camera of the real daemon goes silent for seconds: what health says of it is of the moment."""

import asyncio
import json
import re
import time
import urllib.request
from typing import Any

import pytest
from support.clock import stop
from support.ports import free_port
from support.unit_toml import TARGETS

from altd.app.daemon import Daemon
from altd.config import Config
from altd.measuring.calibration import Calibration
from hw_sim.camera import make_cameras
from hw_sim.faults import Fault
from hw_sim.unit import FRONT, REAR, Unit, UnitConfig

pytestmark = pytest.mark.real_time


def config(port: int) -> Config:
    camera = {"driver": "aravis", "device": "stands for the simulated one"}
    return Config.model_validate(
        {
            "unit": {"serial": "SIM-3", "calibration": "unused.json"},
            "targets": TARGETS,
            "cameras": {FRONT: camera, REAR: camera},
            "measuring": {"pair_by": "time"},
            "http": {"host": "127.0.0.1", "port": port},
        }
    )


def ask(port: int) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/status", timeout=5) as answer:
        return json.load(answer)["components"]


def seconds_without(component: Any) -> float:
    told = re.fullmatch(r"no frame for (\d\.\d) s", component["message"])
    assert told, component["message"]
    return float(told[1])


async def test_what_is_said_of_a_silent_camera_counts_and_its_figures_go(
    calibration_of_unit_3: Calibration,
) -> None:
    port, unit = free_port(), Unit(UnitConfig(seed=3))
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    daemon = Daemon(config(port), calibration_of_unit_3, cameras, rehearsal=True)
    running = asyncio.create_task(daemon.run())
    board = daemon.board.cursor()
    async with asyncio.timeout(30):
        while not (await board.next()).valid:
            pass
    well = await asyncio.to_thread(ask, port)
    assert well["camera rear"]["level"] > 0
    well["measuring"].pop("sampling")  # known after 100 frame sets
    assert None not in well["measuring"].values()
    unit.inject(Fault.REAR_SILENT)
    began_s = time.monotonic()
    await asyncio.sleep(1.0)
    early = await asyncio.to_thread(ask, port)
    early_s = time.monotonic() - began_s
    await asyncio.sleep(2.5)
    late = await asyncio.to_thread(ask, port)
    late_s = time.monotonic() - began_s
    unit.clear()
    async with asyncio.timeout(30):
        mended = late
        while mended["camera rear"]["state"] != "ok":
            await board.next()
            mended = await asyncio.to_thread(ask, port)
    await stop(running)

    # 0.2 s for the last frame before it, 0.5 s for a computer that is busy between question and answer
    for told, since_s in ((early, early_s), (late, late_s)):
        assert since_s - 0.5 < seconds_without(told["camera rear"]) < since_s + 0.2
        assert told["measuring"]["message"].endswith("rear: camera_silent, no frame comes")
        assert (told["measuring"]["skew_ms"], told["measuring"]["lag_rear_ms"]) == (None, None)
        assert told["measuring"]["view_shift_rear_px"] is None
        assert None not in (told["camera front"]["level"], told["measuring"]["view_shift_front_px"])
    assert (late["camera rear"]["level"], late["camera rear"]["exposure_ms"]) == (None, None)
    assert late["measuring"]["view_rear"] in ("verified 3 s ago", "verified 4 s ago")
    assert late["measuring"]["view_front"] == "verified 0 s ago"
    assert mended["camera rear"]["state"] == "ok"
    assert None not in (*mended["camera rear"].values(), *mended["measuring"].values())
