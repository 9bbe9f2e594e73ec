"""A unit with two v4l2loopback cameras measures for a while: ``measuring.py CONFIG FRAMES FPS SECONDS``."""

import sys
import time

from cameras import nodes, plug_in
from daemon import Controller, Stream, feeding, processor_s, running, status
from support.guest import leave_results

SETTLE_S = 2.0


def main(config: str, frames: str, fps: float, seconds: float) -> None:
    devices = [plug_in(*pair) for pair in zip(("front", "rear"), nodes("Dummy video device"), strict=True)]
    with feeding(frames, fps, devices), running(config) as daemon, Controller() as controller:
        stream = Stream()
        time.sleep(SETTLE_S)
        before, began_s, used_s = status(), time.monotonic(), processor_s(daemon)
        time.sleep(seconds)
        after, ended_s, used_s = status(), time.monotonic(), processor_s(daemon) - used_s
        leave_results(
            {
                "before": before["components"],
                "after": after["components"],
                "seconds": ended_s - began_s,
                "processor": used_s / (ended_s - began_s),
                "events": [event for event in list(stream.events) if began_s <= event[0] <= ended_s],
                "modbus_s": controller.took_s,
                "modbus_failures": controller.failures,
            }
        )


main(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
