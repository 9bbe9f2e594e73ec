"""A component, a measurement, consoles without a port, and what they answer to one line."""

from datetime import UTC, datetime

import pytest
from support.measurements import measured

from altd.instruments.beam.solver import Beam
from altd.publish.serial.console import PROMPT, Console
from altd.records import Measurement
from altd.status.health import MEASURING, Component, Health, State
from altd.status.unit import PublishedUnit
from tools.pages.serial_examples import MEASURED, unit_that_shows


@pytest.fixture
def component(health: Health) -> Component:
    return health.component("serial")


@pytest.fixture(name="measured")
def measured_fixture() -> Measurement:
    beam = Beam(10.012, -4.987, 1.1459, -1.7184, 0.004, 0.0041, 0.0011, 0.0012)
    points_mm = {"front": (10.012, -4.987), "rear": (15.613, -3.413)}
    return measured(beam, points_mm, time=datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC))


def console(measurement: Measurement | None = MEASURED) -> Console:
    return Console(unit_that_shows(measurement))


def well(measurement: Measurement | None = MEASURED, age_s: float | None = None) -> PublishedUnit:
    """A unit with the same parts of which none is ill."""
    unit = unit_that_shows(measurement, age_s=age_s)
    unit.health.component(MEASURING).set_state(
        State.OK, lambda _: {"front": "spot at u 1 v 2 px", "rear": "spot at u 3 v 4 px"}
    )
    return unit


def answer(line: str, measurement: Measurement | None = MEASURED) -> list[str]:
    """The text after the echo of one line, without the prompt."""
    shown = Console(well(measurement)).feed(line.encode() + b"\r").decode("ascii")
    echo, _, text = shown.partition("\r\n")
    assert echo == line
    assert text.endswith(PROMPT.decode())
    return text.removesuffix(PROMPT.decode()).split("\r\n")[:-1]
