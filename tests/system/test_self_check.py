"""The whole daemon checks itself on simulated cameras: what it costs, and what it names.

The cameras' LEDs follow the times at which the daemon switched their line, not what it says of its frames.
"""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.clock import START
from support.led_unit import MOVED, POSE, LedUnit, Poll, codes, config, driven_led_unit

from altd.measuring.calibration import Calibration
from altd.records import Frame
from altd.status.models import self_check_of
from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import FRONT, REAR


def invalid(polls: list[Poll]) -> list[Poll]:
    return [poll for poll in polls if poll.measurement is None or not poll.measurement.valid]


def longest_gap_s(polls: list[Poll]) -> float:
    """The longest time without a new measurement."""
    news = [next(group).at_s for _, group in itertools.groupby(polls, lambda poll: poll.published)]
    return max(after - before for before, after in itertools.pairwise(news))


@pytest.mark.parametrize("window", [4, 20])
async def test_a_check_costs_a_few_exposures_and_no_beat(
    calibration_of_unit_3: Calibration, window: int
) -> None:
    async with driven_led_unit(calibration_of_unit_3, config(measuring={"window": window})) as running:
        first = await running.report(1)
        assert (first.check.verdict, first.cause) == ("good", "start")
        await running.measured(valid=True)
        before_s = running.now_s
        report = await running.check()
        await running.measured()
        polls = [poll for poll in running.polls if poll.at_s > before_s]
        assert report.check.verdict == "good"
        assert 4 <= report.exposures_lost <= 7
        assert len(running.leds.lit_s) == 2
        assert max(running.leds.lit_s) < 0.5
        assert invalid(polls) == []
        assert longest_gap_s(polls) < 0.6
        assert max(poll.age_s or 0.0 for poll in polls) < 1.2
        starting = itertools.takewhile(lambda poll: poll in invalid([poll]), running.polls)
        assert all("self_checking" in codes(poll.measurement) for poll in starting if poll.measurement)
        counters = running.daemon.health.component("self-check").counters
        assert (counters["checks"], counters["checks_good"]) == (2, 2)
    assert running.leds.line[-1][1] is False


async def test_a_camera_that_moved_is_found_and_nothing_is_valid_until_it_is_back(
    calibration_of_unit_3: Calibration,
) -> None:
    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        assert (await running.report(1)).check.verdict == "good"
        running.unit.displace(REAR, MOVED)
        report = await running.check()
        rear = self_check_of(report.check).targets["rear"]
        assert report.check.verdict == "bad"
        assert rear.turn_deg == pytest.approx(0.1, abs=0.01)
        after = await running.measured(valid=False)
        assert "geometry_drift" in codes(after)
        assert running.daemon.health.component("self-check").state == "failed"
        running.unit.displace(REAR, Displacement())
        assert (await running.check()).check.verdict == "good"
        assert codes(await running.measured(valid=True)) == {"simulated", "rehearsal"}


def kept_in(folder: Path, name: str) -> Any:
    (file,) = folder.glob(f"{name}-????????.json")
    return json.loads(file.read_bytes())


async def test_the_history_of_checks_and_the_operating_time_outlive_a_restart(
    calibration_of_unit_3: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("altd.acquisition.self_check.memory.SAVE_INTERVAL_S", 0.0)
    monkeypatch.setattr("altd.acquisition.self_check.memory._DISK_TIMEOUT_S", 200.0)  # of a busy machine

    def prepare(running: LedUnit) -> None:
        running.daemon.keep_state_in(tmp_path)

    calibrated = replace(calibration_of_unit_3, created=START)
    counted, seconds = [], [0.0]
    for _ in range(2):
        async with driven_led_unit(calibrated, config(), prepare) as running:
            assert (await running.report(1)).check.verdict == "good"
            assert (await running.check()).check.verdict == "good"
        rear = kept_in(tmp_path, "self-checks")["targets"]["rear"]
        counted.append(sum(day["checks"] for day in (*rear["days"], rear["today"])))
        assert running.daemon.health.component("self-check history").state == "ok"
        seconds.append(kept_in(tmp_path, "operating-time")["seconds"])
        hours = running.daemon.unit.operating_hours()
        assert hours is not None
        assert seconds[-1] == pytest.approx(3600 * hours, abs=5.0)
    assert counted == [2, 4]
    assert seconds == sorted(set(seconds))


async def test_a_camera_that_stands_still_during_a_check_is_named(calibration_of_unit_3: Calibration) -> None:
    frozen: dict[str, Frame] = {}

    def alter(frame: Frame) -> Frame:
        still = frozen.setdefault(frame.camera, frame) if frame.camera == REAR else frame
        return replace(frame, pixels=still.pixels)

    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.seen.alter = alter
        report = await running.check()
        assert report.check.verdict == "unknown"
        assert "rear: the camera repeats a picture" in report.check.sentence
        assert not (await running.measured(valid=False)).valid


async def test_a_beam_that_jumps_during_a_check_makes_no_drift_and_is_checked_after(
    calibration_of_unit_3: Calibration,
) -> None:
    """With the first lit exposure, by 20 mm on both targets: the spot is in the lit frames elsewhere."""
    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)

        def jump(level: bool, t_ns: int) -> bool:
            if level:
                running.unit.place(POSE)
            return level

        running.leds.follow = jump
        report = await running.check()
        assert report.check.verdict in ("good", "unknown")
        assert (await running.check()).check.verdict == "good"


async def test_a_blow_that_moves_all_spots_is_followed_by_a_check(calibration_of_unit_3: Calibration) -> None:
    """Until then its effect on cameras and targets is unknown, and each measurement reports it."""
    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        await running.measured(valid=True)
        running.unit.place(replace(POSE, x_mm=POSE.x_mm + 5.0))
        struck_s = running.now_s
        report = await running.report(2)
        since = [
            codes(poll.measurement) for poll in running.polls if poll.measurement and poll.at_s > struck_s
        ]
        assert (report.cause, report.check.verdict) == ("shock", "good")
        first = next(number for number, said in enumerate(since) if "geometry_unknown" in said)
        assert first < 0.3 * len(since)  # of the rest of five seconds between two checks
        assert all("geometry_unknown" in said for said in since[first:-5])  # the last: the check has ended
        assert "geometry_unknown" not in codes(await running.measured(valid=True))
        assert running.daemon.health.component("self-check").counters["shocks"] == 1


async def test_a_spot_over_an_led_does_not_move_it(calibration_of_unit_3: Calibration) -> None:
    """As near to an LED of the front target as the spot may come and be measured."""
    x_mm, y_mm = max(LED_POSITIONS_MM, key=lambda place: (place[1] < 0, place[0]))
    beside = BeamPose(x_mm=0.86 * x_mm, y_mm=0.86 * y_mm, slope_x=0.0, slope_y=0.0)

    def prepare(running: LedUnit) -> None:
        running.unit.place(beside)

    async with driven_led_unit(calibration_of_unit_3, config(), prepare) as running:
        report = await running.report(1)
        assert report.check.verdict == "good"
        running.unit.displace(FRONT, MOVED)
        report = await running.check()
        assert report.check.verdict == "bad"
        assert self_check_of(report.check).targets["front"].turn_deg == pytest.approx(0.1, abs=0.02)


async def test_a_daemon_that_is_stopped_during_a_check_leaves_the_leds_dark(
    calibration_of_unit_3: Calibration,
) -> None:
    async with driven_led_unit(calibration_of_unit_3, config(exposures=20)) as running:
        await running.lit()
    assert running.leds.line[-1][1] is False
    assert running.daemon.unit.self_check.latest is None


async def test_a_unit_without_references_measures_as_ever_and_says_why_it_is_not_checked(
    calibration_of_unit_3: Calibration,
) -> None:
    targets = [replace(target, leds_px=np.zeros((0, 2))) for target in calibration_of_unit_3.targets]
    without = replace(calibration_of_unit_3, targets=tuple(targets))
    async with driven_led_unit(without, config()) as running:
        assert codes(await running.measured(valid=True)) <= {"simulated", "rehearsal", "exposures_lost"}
        assert running.leds.lit_s == []
        assert running.daemon.unit.self_check.unavailable == (
            "the calibration has no LED references for front, rear"
        )
        assert "self-check" not in [component.name for component in running.daemon.health]


async def test_by_its_settings_it_checks_only_when_asked(calibration_of_unit_3: Calibration) -> None:
    async with driven_led_unit(calibration_of_unit_3, config(enabled=False)) as running:
        assert codes(await running.measured(valid=True)) <= {"simulated", "rehearsal", "exposures_lost"}
        assert running.leds.lit_s == []
        assert (await running.check()).check.verdict == "good"
