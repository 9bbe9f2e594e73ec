"""The whole daemon on two GigE Vision cameras, each a process of its own; the tunnel's faults are done to them.

``make bench-live`` measures the same on a quiet machine; the limits here are those of a busy one.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.own_network import inside

from benchmarks.live.faults import Recovery, measure_fault
from benchmarks.live.parts import calibrate
from benchmarks.live.unit import (
    FRONT,
    LINKED,
    REAR,
    SEED,
    Camera,
    camera_behind_link,
    measuring_daemon,
    set_link,
)

pytestmark = pytest.mark.own_network


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calibrate(SEED, tmp_path_factory.mktemp("calibration")) if inside() else Path()


def assert_it_was_said_and_is_over(recovery: Recovery, reason: str = "front_camera_silent") -> None:
    assert reason in recovery.reasons
    assert recovery.invalid_after_s < 1.5
    assert recovery.health.startswith(("degraded: no frame for", "failed: not found:", "failed: lost:"))
    assert recovery.valid_after_s < 4.0
    assert recovery.modbus_said_invalid
    assert recovery.modbus_slowest_ms < 250.0


def test_cameras_that_die_are_measured_with_again_once_they_are_back(
    calibration: Path, tmp_path: Path
) -> None:
    with (
        Camera(tmp_path, "front", FRONT) as front,
        Camera(tmp_path, "rear", REAR) as rear,
        measuring_daemon(tmp_path, calibration, (FRONT, REAR)) as (_, watch),
    ):

        def kill_both() -> None:
            front.kill()
            rear.kill()

        def rear_first() -> float:
            rear.start()
            return front.start()

        assert_it_was_said_and_is_over(measure_fault(watch, "killed", "front", front.kill, front.start, 1.0))
        assert_it_was_said_and_is_over(measure_fault(watch, "stopped", "front", front.stop, front.go_on, 5.0))
        assert_it_was_said_and_is_over(measure_fault(watch, "both", "front", kill_both, rear_first, 2.0))
        assert "simulated" in watch.seen[-1].said["status"]


def test_a_pulled_link_is_said_and_survived(calibration: Path, tmp_path: Path) -> None:
    with (
        camera_behind_link(tmp_path),
        Camera(tmp_path, "rear", REAR),
        measuring_daemon(tmp_path, calibration, (LINKED, REAR)) as (_, watch),
    ):
        pulled = measure_fault(
            watch, "pulled", "front", lambda: set_link("down"), lambda: set_link("up"), 4.0
        )
        assert_it_was_said_and_is_over(pulled)
