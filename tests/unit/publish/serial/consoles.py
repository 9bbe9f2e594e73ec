"""Consoles without a port, and what they answer to one line."""

from __future__ import annotations

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.serial.console import PROMPT, Console
from altd.records import Measurement
from altd.status.health import MEASURING, Health, State
from tools.pages.serial_examples import MEASURED, health


def console(measurement: Measurement | None = MEASURED) -> Console:
    return Console(lambda: measurement, health(), QUANTITIES)


def well() -> Health:
    """A unit with the same parts of which none is ill."""
    unit = health()
    unit.component(MEASURING).set_state(State.OK, "front: spot at u 1 v 2 px; rear: spot at u 3 v 4 px")
    return unit


def answer(line: str, measurement: Measurement | None = MEASURED) -> list[str]:
    """The text after the echo of one line, without the prompt."""
    shown = Console(lambda: measurement, well(), QUANTITIES).feed(line.encode() + b"\r").decode("ascii")
    echo, _, text = shown.partition("\r\n")
    assert echo == line
    assert text.endswith(PROMPT.decode())
    return text.removesuffix(PROMPT.decode()).split("\r\n")[:-1]
