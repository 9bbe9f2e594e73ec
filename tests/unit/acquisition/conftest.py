from collections.abc import AsyncIterator

import pytest
from support.clock import FakeClock

from altd.status.health import Component, Health


@pytest.fixture
async def clock() -> AsyncIterator[FakeClock]:
    """That of the loop and of the devices' threads."""
    clock = FakeClock.of_loop(8_000_000_000)
    yield clock
    clock.end()


@pytest.fixture
def component(clock: FakeClock) -> Component:
    return Health(clock).component("camera front")
