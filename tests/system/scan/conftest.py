"""A simulated unit under a simulated Grbl table."""

from collections.abc import Iterator

import pytest
from support.scanning import QUICK_TABLE

from altd.devices.grbl import controller
from hw_sim.grbl_table import GrblTable
from hw_sim.unit import Unit, UnitConfig


@pytest.fixture(scope="module")
def made() -> Unit:
    return Unit(UnitConfig(seed=11, fps=50.0))


@pytest.fixture
def quick_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Altd's side of Grbl pauses little; its timeouts stay, for a machine that is busy with other tests."""
    for name, seconds in {"POLL_INTERVAL_S": 0.01, "_SILENCE_TIMEOUT_S": 0.05}.items():
        monkeypatch.setattr(controller, name, seconds)


@pytest.fixture
def unit(made: Unit, quick_controller: None) -> Iterator[Unit]:
    yield made
    made.clear()
    made.leds_on = False


@pytest.fixture
def table(unit: Unit) -> Iterator[GrblTable]:
    with GrblTable(unit) as table:
        table.machine.settings |= QUICK_TABLE
        yield table
