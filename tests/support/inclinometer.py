"""An inclinometer's settings, and a line at whose far end answers are made by hand."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from altd.config import InclinometerSettings
from support.wire import Wire


def settings(device: object, driver: str = "balluff_bsi_r11a0", **more: object) -> InclinometerSettings:
    return InclinometerSettings.model_validate({"driver": driver, "device": device, **more})


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
