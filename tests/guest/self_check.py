"""A unit checks itself by LEDs on its GPIO lines, and loses them: ``self_check.py CONFIG FRAMES FPS``."""

import sys
import time
from collections.abc import Callable
from typing import Any

from cameras import nodes, plug_in
from daemon import Stream, feeding, running, self_check, status
from feeding_leds import CHIP, CUT, WIRED
from support.gpio_sim import SimulatedChip
from support.guest import leave_results

WITHIN_S = 60.0
MEASUREMENTS = 10


def wait_for(what: Callable[[Any], bool]) -> Any:
    """``/api/status`` once it is so."""
    end_s = time.monotonic() + WITHIN_S
    while not what(now := status()):
        assert time.monotonic() < end_s, now
        time.sleep(0.05)
    return now


def lamps(state: str) -> Callable[[Any], bool]:
    return lambda now: bool(now["components"]["lamps"]["state"] == state)


def checked(stream: Stream) -> dict[str, Any]:
    """The report of a check, and the status of the measurements after it."""
    document = self_check()
    first = len(stream.events) + 1
    while len(stream.events) < first + MEASUREMENTS:
        time.sleep(0.02)
    after = [event["status"] for _, event in stream.events[first:]]
    return {"check": document, "measured": after, "status": status()}


def main(config: str, frames: str, fps: float) -> None:
    chip = SimulatedChip(CHIP, list(WIRED.values()))
    devices = [plug_in(*pair) for pair in zip(WIRED, nodes("Dummy video device"), strict=True)]
    results: dict[str, Any] = {}
    with feeding(frames, fps, devices, "feeding_leds.py"), running(config) as daemon:
        stream = Stream()
        results["start"] = wait_for(lambda now: now["components"]["self-check"].get("checks", 0) > 0)
        CUT.touch()
        results["cut"] = checked(stream)
        CUT.unlink()

        chip.unplug()
        results["unplugged"] = wait_for(lamps("failed"))
        chip.plug_with("torch", "LED_A")
        results["taken"] = checked(stream)
        chip.unplug_from("LED_A")

        chip.plug()
        results["plugged"] = wait_for(lamps("ok"))
        results["back"] = checked(stream)
        results["alive"] = daemon.poll() is None
        results["measured"] = [(event["valid"], event["status"]) for _, event in stream.events]
    leave_results(results)


main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
