"""Real GigE Vision cameras on loopback: Aravis' own simulated one, a process each."""

from collections.abc import Iterator

import pytest
from support.gige import Cameras


@pytest.fixture
def cameras() -> Iterator[Cameras]:
    """Starts cameras; those that still run are killed at the end."""
    with Cameras() as started:
        yield started
