"""Real GigE Vision cameras on loopback: Aravis' own simulated one, a process each."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support import own_network
from support.gige import Cameras


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"{own_network.MARKER}: runs in a network namespace of its own")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    if own_network.inside() or pyfuncitem.get_closest_marker(own_network.MARKER) is None:
        return None
    own_network.run_inside(pyfuncitem)
    return True


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if own_network.inside():
        own_network.note(report)


@pytest.fixture
def cameras() -> Iterator[Cameras]:
    """Starts cameras; those that still run are killed at the end."""
    with Cameras() as started:
        yield started
