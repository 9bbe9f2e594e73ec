"""A unit with two vivid cameras, one of which fails in several ways: ``failing.py CONFIG FRAMES FPS``.

vivid shows what is fed to its own output: its input is HDMI of 1280 × 720 at 25 frames a second, its output
the same at 50, and the same 752 × 480 pixels are read and written. The output runs twice as fast because
vivid runs each in a thread of its own: at equal rates the two can change places in each tick, and the input
then shows each picture twice, which no camera does.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cameras import nodes, plug_in, v4l2_ctl
from daemon import Asking, Controller, Stream, feeding, running, status
from support.guest import leave_results

FRONT = nodes("vid-cap")[0]
HDMI_720P25, HDMI_720P50 = "index=4", "index=6"
SETTLE_S = 2.0
WATCH_S = 3.0
PATIENCE_S = 60.0
AWAY_S = 1.5


class Watch(Asking):
    """``/api/status`` on the front camera, each time with the instant, ``time.monotonic()``."""

    def __init__(self) -> None:
        super().__init__(every_s=0.1)
        self.said: list[tuple[float, Any]] = []

    def ask(self) -> None:
        camera = status()["components"]["camera front"]
        self.said.append((time.monotonic(), camera))


def loop(capture: Path, output: Path) -> None:
    """Let a vivid camera show what is fed to its output, pixel by pixel."""
    area = "left=0,top=0,width=752,height=480"
    size = "width=752,height=480,pixelformat=GREY"
    v4l2_ctl(capture, "-i", "3", "--set-dv-bt-timings", HDMI_720P25)
    v4l2_ctl(output, "-o", "1", "--set-dv-bt-timings", HDMI_720P50)
    v4l2_ctl(capture, "-v", size, "--set-selection", f"target=crop,{area}")
    v4l2_ctl(output, "-x", size, "--set-selection-output", f"target=compose,{area}")
    v4l2_ctl(capture, "-c", "loop_video=1,osd_text_mode=2")


def dropping() -> None:
    v4l2_ctl(FRONT, "-c", "percentage_of_dropped_buffers=20")
    time.sleep(2.0)
    v4l2_ctl(FRONT, "-c", "percentage_of_dropped_buffers=0")


def breaking() -> None:
    v4l2_ctl(FRONT, "-c", "inject_fatal_streaming_error=1")


def pulled_out() -> None:
    """vivid comes back when the last program has released it, and this one holds it for a while."""
    held = os.open(FRONT, os.O_RDWR)
    v4l2_ctl(FRONT, "-c", "disconnect=1")
    time.sleep(AWAY_S)
    os.close(held)


def watched(fault: Callable[[], None], watch: Watch, stream: Stream) -> dict[str, object]:
    """Status and stream until the unit measures again, with the time since the fault began.

    While the feeder opens an output again, or has too little CPU, vivid shows pictures twice, which the unit
    refuses: this takes seconds on a busy machine.
    """
    began_s = time.monotonic()
    before = watch.said[-1][1]
    fault()
    ended_s = time.monotonic()
    time.sleep(WATCH_S)
    while time.monotonic() < ended_s + PATIENCE_S:
        if any(event["valid"] for at_s, event in list(stream.events) if at_s > ended_s + 1.0):
            break
        time.sleep(0.1)
    return {
        "ended_s": ended_s - began_s,
        "before": before,
        "camera": [(at_s - began_s, said) for at_s, said in list(watch.said) if at_s > began_s],
        "measured": [
            (at_s - began_s, event["valid"], event["status"])
            for at_s, event in list(stream.events)
            if at_s > began_s
        ],
    }


def main(config: str, frames: str, fps: float) -> None:
    captures, outputs = nodes("vid-cap"), nodes("vid-out")
    for place, capture, output in zip(("front", "rear"), captures, outputs, strict=True):
        plug_in(place, capture)
        loop(capture, output)
    with (
        feeding(frames, 3 * fps, outputs),
        running(config) as daemon,
        Controller() as controller,
        Watch() as watch,
    ):
        stream = Stream()
        time.sleep(SETTLE_S)
        faults = (dropping, breaking, pulled_out)
        found: dict[str, object] = {fault.__name__: watched(fault, watch, stream) for fault in faults}
        found["alive"] = daemon.poll() is None
        found["modbus_s"] = controller.took_s
        found["modbus_failures"] = controller.failures
        leave_results(found)


main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
