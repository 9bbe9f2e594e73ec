"""``python -m benchmarks.live.in_process CONFIG SEED SECONDS``: the unit without a wire, at the same time.

The drive and the vibration of a simulated unit are functions of the machine's clock: this daemon, whose
cameras are handed to it, sees the very scene that the one on the wire sees. Prints how true it was, as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of
from altd.config import load_config
from altd.status.measurement_json import as_object
from benchmarks.live.steady import truthfulness
from hw_sim.camera import make_cameras
from hw_sim.gige.command import make_unit
from hw_sim.unit import Unit


def main() -> int:
    """Measure so long, and say how true it was."""
    config, seed, seconds = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    unit = make_unit(seed, drive=True)
    measurements = asyncio.run(_measured(config, unit, seconds))
    print(json.dumps(dataclasses.asdict(truthfulness(unit, measurements))))
    return 0


async def _measured(config_file: Path, unit: Unit, seconds: float) -> list[dict[str, Any]]:
    """The valid measurements of so many seconds."""
    with_faces = load_config(config_file)
    config = with_faces.model_copy(update={"cameras": {}, "http": None, "modbus_tcp": None})
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    daemon = Daemon(config, calibration_of(config, cameras), cameras)
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
