from __future__ import annotations

import pytest

from altd.runtime.clock import SystemClock
from altd.status.health import Component, Health


@pytest.fixture
def component() -> Component:
    return Health(SystemClock()).component("camera front")
