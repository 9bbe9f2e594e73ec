"""An inclinometer's settings, and a line at whose far end answers are made by hand."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from altd.config import InclinometerSettings
from support.wire import Wire


def settings(device: object, driver: str = "balluff_bsi_r11a0", **more: object) -> InclinometerSettings:
    return InclinometerSettings.model_validate({"driver": driver, "device": device, **more})


FINE: dict[str, Any] = {
    "name": "fine",
    "limit_deg": 0.01,
    "from_c": -20,
    "to_c": 60,
    "limit_elsewhere_deg": 0.05,
    "deg_per_k": 0.0005,
    "range_deg": 30,
    "roll_is": "inclination",
    "registers": [
        {"use": "roll", "address": 0, "type": "f32_swapped"},
        {"use": "pitch", "address": 2, "type": "f32_swapped"},
        {"use": "temperature", "address": 4, "type": "s16", "scale": 0.01},
        {"use": "identity", "address": 100, "function": 3, "type": "u16", "must_be": 0x4711},
    ],
}
"""Data sheet of ``hw_sim.inclinometer.Inclinometer.fine``."""


@contextmanager
def answering(answer: Callable[[bytes], bytes]) -> Iterator[Wire]:
    """A line at whose far end requests are answered with bytes made by hand."""
    wire, ending = Wire.laid(), threading.Event()

    def serve() -> None:
        while not ending.wait(0.001):
            try:
                wire.send(answer(os.read(wire.far, 64)))
            except BlockingIOError:
                continue

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield wire
    finally:
        ending.set()
        thread.join()
        wire.hang_up()
