"""The whole daemon on two GigE Vision cameras, each a process of its own, and what happens to them there.

``make bench-live`` measures the same on a quiet machine; the limits here are those of a busy one.
"""

import contextlib
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz.hostile.spray import spray
from support.cli import altd_here
from support.gige import register
from support.held import OF_LATE_FRAMES, hold
from support.own_network import inside

from altd.config import load_config
from benchmarks.harness import child
from benchmarks.live.parts import (
    FRONT,
    LINKED,
    REAR,
    SEED,
    Camera,
    both_cameras,
    camera_behind_link,
    daemon_command,
    measuring_daemon,
    set_link,
    write_config,
)
from benchmarks.live.watch import Ports, Recovery, Watch, measure_fault

pytestmark = [pytest.mark.own_network, pytest.mark.real_time]

LAMPS = '[lamps]\ndriver = "camera"\ncameras = ["front", "rear"]\nline = "Line1"\n'
USER_OUTPUT_0 = 0x4020  # hw_sim/gige/genicam.xml


@pytest.fixture(scope="module")
def calibration(simulated_unit: Callable[[int], Path]) -> Path:
    return simulated_unit(SEED) / "cal.json" if inside() else Path()


@pytest.fixture(scope="class")
def front_and_rear(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Camera]]:
    """Two cameras that serve all tests of a class: each leaves them running, with their LEDs dark."""
    with contextlib.ExitStack() as serving:
        folder = tmp_path_factory.mktemp("cameras")
        cameras = (("front", FRONT), ("rear", REAR)) if inside() else ()
        yield [serving.enter_context(Camera(folder, name, address)) for name, address in cameras]


def assert_it_was_said_and_is_over(recovery: Recovery, reason: str = "front_camera_silent") -> None:
    assert reason in recovery.reasons
    assert recovery.invalid_after_s < 1.5
    assert recovery.health.startswith(("degraded: no frame for", "failed: not found:", "failed: lost:"))
    assert recovery.valid_after_s < 4.0
    assert recovery.modbus_said_invalid
    assert recovery.modbus_slowest_ms < 250.0


def outputs() -> list[int | None]:
    """The switch of the LEDs, asked of the cameras themselves, which may be late to answer."""
    asked = ((register(address, USER_OUTPUT_0) for _ in range(10)) for address in (FRONT, REAR))
    return [next((value for value in answers if value is not None), None) for answers in asked]


def self_checked(config: Path) -> tuple[int, dict[str, Any]]:
    """``altd selfcheck`` of the running daemon: its status and its object."""
    outcome = altd_here("selfcheck", "--config", config, "--json")
    return outcome.status, json.loads(outcome.out)


def await_component(watch: Watch, name: str, state: str, timeout_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while (component := watch.status()["components"][name])["state"] != state:
        assert time.monotonic() < deadline_s, component
        time.sleep(0.05)


def await_outputs(wanted: list[int | None], timeout_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while outputs() != wanted:
        assert time.monotonic() < deadline_s, outputs()
        time.sleep(0.05)


class TestCameras:
    def test_that_die_are_measured_with_again_once_they_are_back(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        front, rear = front_and_rear

        def kill_both() -> None:
            front.kill()
            rear.kill()

        def rear_first() -> float:
            rear.start()
            return front.start()

        with measuring_daemon(tmp_path, calibration, (FRONT, REAR)) as (_, watch):
            assert_it_was_said_and_is_over(
                measure_fault(watch, "killed", "front", front.kill, front.start, 1.0)
            )
            assert_it_was_said_and_is_over(
                measure_fault(watch, "stopped", "front", front.stop, front.go_on, 5.0)
            )
            assert_it_was_said_and_is_over(measure_fault(watch, "both", "front", kill_both, rear_first, 2.0))
            assert "simulated" in watch.seen[-1].measurement["status"]

    def test_behind_a_pulled_link_are_said_and_survived(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        with (
            camera_behind_link(tmp_path),
            measuring_daemon(tmp_path, calibration, (LINKED, REAR)) as (_, watch),
        ):
            pulled = measure_fault(
                watch, "pulled", "front", lambda: set_link("down"), lambda: set_link("up"), 4.0
            )
            assert_it_was_said_and_is_over(pulled)

    def test_that_send_to_a_held_daemon_give_no_old_value_that_is_valid(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        """For longer than the cameras' heartbeat; takes five seconds of holding."""
        ports = Ports.free()
        config = write_config(tmp_path / "altd.toml", f"SIM-{SEED}", calibration, (FRONT, REAR), ports)
        log = tmp_path / "altd.log"
        with child(daemon_command(config), log) as daemon:
            daemon.await_text("measuring")
            answers = hold(daemon.process.pid, ports.modbus, ports.http, hold_s=5.0, polls_s=6.0)
        settings = load_config(config).measuring
        oldest_s = settings.stale_after_s + settings.window / 2 / 20.0 + 0.1
        assert [each for each in answers if each.valid and each.age_s > oldest_s] == []
        assert any(not each.valid for each in answers)
        assert {each.face for each in answers} == {"modbus", "http"}
        assert answers[-1].valid


class TestFrameLedsOnTheirOutputs:
    def test_light_them(self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path) -> None:
        config = write_config(
            tmp_path / "lamps.toml",
            f"SIM-{SEED}",
            calibration,
            (FRONT, REAR),
            Ports.free(),
            LAMPS,
        )
        command = [sys.executable, "-m", "altd.cli", "lamps", "on", "--config", str(config)]
        with child(command, tmp_path / "lamps.log") as lamps:
            await_outputs([1, 1])
            lamps.send(signal.SIGINT)
            assert lamps.process.wait(60) == 130
        assert outputs() == [0, 0]

    def test_fail_with_their_camera_and_are_dark_once_it_is_back(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        front, _ = front_and_rear
        with measuring_daemon(tmp_path, calibration, (FRONT, REAR), LAMPS) as (_, watch):
            await_component(watch, "lamps", "ok")
            front.kill()
            await_component(watch, "lamps", "failed")
            watch.first(lambda seen: not seen.valid, 0.0, 60.0)
            front.start()
            await_component(watch, "lamps", "ok")
            watch.first(lambda seen: seen.valid, time.monotonic(), 60.0)
            await_outputs([0, 0])  # a check may be lighting them

    def test_show_the_daemon_that_it_is_as_calibrated(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        """Asked through its local socket, and over HTTP where the settings have none."""
        local = f'[local]\nsocket = "{tmp_path}/altd.sock"\n'
        with measuring_daemon(tmp_path, calibration, (FRONT, REAR), LAMPS + local) as (daemon, watch):
            watch.first(lambda seen: seen.valid, 0.0, 60.0)
            await_component(watch, "self-check", "ok")
            begun_s = time.monotonic()
            whole, over_http = tmp_path / "altd.toml", tmp_path / "http.toml"
            over_http.write_text(whole.read_text().replace(local, ""))
            for config in (whole, over_http):
                status, said = self_checked(config)
                assert (status, said["verdict"], said["cause"]) == (0, "good", "request")
                assert {name: of["leds_found"] for name, of in said["targets"].items()} == {
                    "front": 6,
                    "rear": 6,
                }
                assert 4 <= said["exposures_lost"] <= 9
                assert outputs() == [0, 0]
            watch.first(lambda seen: seen.valid, time.monotonic() + 1.0, 60.0)
            measured = [seen for seen in watch.seen if seen.arrived_s > begun_s]
            refused = [seen.reasons - {"rehearsal", "exposures_lost"} for seen in measured if not seen.valid]
            assert len(refused) < len(measured) / 2
            assert [reasons for reasons in refused if not reasons <= OF_LATE_FRAMES] == []
            daemon.send(signal.SIGTERM)
            assert daemon.process.wait(60) == 0
            assert outputs() == [0, 0]

    def test_that_a_killed_daemon_left_lit_are_dark_once_it_is_back(
        self, front_and_rear: list[Camera], calibration: Path, tmp_path: Path
    ) -> None:
        long_check = LAMPS + "[self_check]\nexposures = 20\n"
        with measuring_daemon(tmp_path, calibration, (FRONT, REAR), long_check) as (daemon, _):
            await_outputs([1, 1])
            daemon.process.kill()
            daemon.process.wait(10)
            assert outputs() == [1, 1]
        unchecked = LAMPS + "[self_check]\nenabled = false\n"
        with measuring_daemon(tmp_path, calibration, (FRONT, REAR), unchecked) as (_, watch):
            await_outputs([0, 0])
            watch.first(lambda seen: seen.valid, time.monotonic(), 60.0)


def test_a_vibration_at_the_frame_rate_scatters_where_software_triggers(
    calibration: Path, tmp_path: Path
) -> None:
    """Of 0.3 mm at 20 Hz: with even triggers it would look like rest, some 30 sigma away."""
    with (
        both_cameras(tmp_path, "--line", "20", "0.3"),
        measuring_daemon(tmp_path, calibration, (FRONT, REAR), trigger="software") as (_, watch),
    ):
        begun_s = watch.first(lambda seen: seen.valid, 0.0, 60.0).arrived_s
        last = watch.first(lambda seen: seen.valid, begun_s + 8.0, 60.0)
        assert watch.status()["components"]["measuring"]["sampling"] == "uneven"
    values = [
        seen.measurement for seen in watch.seen if seen.valid and begun_s <= seen.arrived_s <= last.arrived_s
    ]
    in_sigmas = np.array([[one[key] / one["sigma"][key] for key in ("x_mm", "y_mm")] for one in values])
    assert len(values) > 100
    assert np.sqrt(np.square(in_sigmas).mean()) < 1.6
    assert np.abs(in_sigmas).max() < 5.0
    assert min(one["sigma"]["x_mm"] for one in values) > 0.03


def test_datagrams_from_forged_sources_leave_it_alive_and_right_or_invalid(
    calibration: Path, tmp_path: Path
) -> None:
    """Each way of attacking for 2 s; ``make bench-spray`` takes ten minutes."""
    sprayed = spray(tmp_path, calibration, seconds=16.0, rate=3000.0, seed=2)
    assert sprayed.wrong == []
    assert sprayed.valid > 20
    assert sprayed.measurements > sprayed.valid
    assert max(sprayed.rss_mb) < sprayed.rss_mb[0] + 30.0
