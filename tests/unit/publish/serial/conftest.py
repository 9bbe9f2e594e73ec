"""A component and a measurement."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from support.measurements import measured

from altd.instruments.beam.solver import Beam
from altd.records import Measurement
from altd.status.health import Component, Health


@pytest.fixture
def component(health: Health) -> Component:
    return health.component("serial")


@pytest.fixture(name="measured")
def measured_fixture() -> Measurement:
    return measured(
        sequence=160,
        t_ns=8_000_000_000,
        time=datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC),
        frames=20,
        beam=Beam(10.012, -4.987, 1.1459, -1.7184, 0.004, 0.0041, 0.0011, 0.0012),
        points_mm={"front": (10.012, -4.987), "rear": (15.613, -3.413)},
    )
