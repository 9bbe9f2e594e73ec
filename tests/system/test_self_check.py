"""The whole daemon checks itself on simulated cameras, in real time: what it costs, and what it names.

The cameras' LEDs follow the times at which the daemon switched their line, not what it says of its frames.
"""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.led_unit import LedUnit, Poll, config, led_unit

from altd.acquisition.self_check import standing
from altd.measuring.calibration import Calibration
from altd.records import Frame, Measurement
from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.frame_leds import Shines, Stray
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import FRONT, REAR

pytestmark = pytest.mark.real_time

POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
MOVED = Displacement((0.6, -0.2), turn_deg=0.1)


def codes(measurement: Measurement) -> set[str]:
    return {str(fault) for fault in measurement.status}


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
    async with led_unit(calibration_of_unit_3, config(measuring={"window": window})) as running:
        first = await running.report(1)
        assert (first.document["verdict"], first.document["cause"]) == ("good", "start")
        await running.measured(valid=True)
        before_s = time.monotonic()
        report = await running.check()
        await running.measured()
        polls = [poll for poll in running.polls if poll.at_s > before_s]
        assert report.document["verdict"] == "good"
        assert 4 <= report.document["exposures_lost"] <= 7
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
    async with led_unit(calibration_of_unit_3, config()) as running:
        assert (await running.report(1)).document["verdict"] == "good"
        running.unit.displace(REAR, MOVED)
        report = await running.check()
        rear = report.document["targets"]["rear"]  # type: ignore[index]
        assert report.document["verdict"] == "bad"
        assert rear["turn_deg"] == pytest.approx(0.1, abs=0.01)
        after = await running.measured(valid=False)
        assert "geometry_drift" in codes(after)
        assert running.daemon.health.component("self-check").state == "failed"
        running.unit.displace(REAR, Displacement())
        assert (await running.check()).document["verdict"] == "good"
        assert codes(await running.measured(valid=True)) == {"simulated"}


def only_file(folder: Path) -> bytes:
    (file,) = (path for path in folder.iterdir() if path.is_file())
    return file.read_bytes()


async def test_the_history_of_checks_outlives_a_restart(
    calibration_of_unit_3: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("altd.acquisition.self_check.memory.SAVE_INTERVAL_S", 0.0)

    def prepare(running: LedUnit) -> None:
        running.daemon.keep_state_in(tmp_path)

    counted = []
    for _ in range(2):
        async with led_unit(calibration_of_unit_3, config(), prepare) as running:
            assert (await running.report(1)).document["verdict"] == "good"
            assert (await running.check()).document["verdict"] == "good"
        rear = json.loads(only_file(tmp_path))["targets"]["rear"]
        counted.append(sum(day["checks"] for day in (*rear["days"], rear["today"])))
        assert running.daemon.health.component("self-check history").state == "ok"
    assert counted == [2, 4]


@pytest.mark.parametrize("camera", [FRONT, REAR])
async def test_compensation_takes_a_drift_out_and_says_so(
    calibration_of_unit_3: Calibration, camera: str
) -> None:
    """Of the plain plate's camera, and of the printed target's, whose view is checked by its print."""

    def prepare(running: LedUnit) -> None:
        running.unit.place(POSE)
        running.unit.displace(camera, MOVED)

    async with led_unit(calibration_of_unit_3, config(compensate=True), prepare) as running:
        report = await running.report(1)
        assert report.document["verdict"] == "bad"
        corrected = await running.measured(valid=True)
        running.unit.displace(camera, Displacement())
        await running.check()
        plain = await running.measured(valid=True)
        while "compensated" in codes(plain):
            plain = await running.measured(valid=True)
    assert "compensated" in codes(corrected)
    truth = {"yaw_mm_per_m": 1000 * POSE.slope_x, "pitch_mm_per_m": 1000 * POSE.slope_y}
    for key, value in truth.items():
        sigma = corrected.sigma(key.replace("_mm_per_m", "_deg"))
        assert sigma is not None
        assert abs((corrected.number(key) or 0.0) - value) < 4 * 17.5 * sigma
        plain_sigma = plain.sigma(key.replace("_mm_per_m", "_deg"))
        assert plain_sigma is not None
        assert sigma > plain_sigma


async def test_a_correction_that_no_check_confirms_ends_and_the_drift_counts(
    calibration_of_unit_3: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standing, "MAX_UNCONFIRMED_INTERVALS", 0.3)  # 3 s, of the shortest interval

    def prepare(running: LedUnit) -> None:
        running.unit.place(POSE)
        running.unit.displace(REAR, MOVED)

    settings = config(compensate=True, when_bad="warning", interval_s=10)
    async with led_unit(calibration_of_unit_3, settings, prepare) as running:
        await running.report(1)
        corrected = last = await running.measured(valid=True)
        while "compensated" in codes(last):
            corrected, last = last, await running.measured(valid=True)
        health = running.daemon.health.component("self-check")
        assert (health.state, health.message.split(":")[0]) == ("degraded", "nothing is corrected any more")
    assert "geometry_suspect" in codes(last)
    off_mm_per_m = [
        abs((one.number("yaw_mm_per_m") or 0.0) - 1000 * POSE.slope_x) for one in (corrected, last)
    ]
    assert off_mm_per_m[0] < 0.15 < 0.3 < off_mm_per_m[1]  # 0.6 px are 0.15 mm, over 280 mm 0.54 mm/m


async def test_a_camera_that_moves_on_after_it_was_corrected_is_wrong_until_the_next_check(
    calibration_of_unit_3: Calibration,
) -> None:
    def prepare(running: LedUnit) -> None:
        running.unit.displace(FRONT, MOVED)

    async with led_unit(calibration_of_unit_3, config(compensate=True), prepare) as running:
        await running.report(1)
        assert "compensated" in codes(await running.measured(valid=True))
        running.unit.displace(FRONT, replace(MOVED, shift_px=(0.6, 0.5)))
        while "front_wrong_camera" not in codes(await running.measured(valid=False)):
            pass  # the pause in which the unit was drawn anew
        await running.check()
        assert "compensated" in codes(await running.measured(valid=True))


async def test_a_drift_beyond_what_may_be_compensated_is_invalid(calibration_of_unit_3: Calibration) -> None:
    def prepare(running: LedUnit) -> None:
        running.unit.displace(REAR, Displacement((4.0, 0.0)))

    settings = config(compensate=True, compensate_mm=0.5)
    async with led_unit(calibration_of_unit_3, settings, prepare) as running:
        await running.report(1)
        after = await running.measured()
        assert not after.valid
        drift = next(fault for fault in after.status if str(fault) == "geometry_drift")
        assert "not corrected: rear" in drift.detail


@pytest.mark.parametrize("when_unknown", ["warning", "invalid"])
async def test_leds_that_all_stay_dark_are_named(
    calibration_of_unit_3: Calibration, when_unknown: str
) -> None:
    def prepare(running: LedUnit) -> None:
        running.leds.follow = lambda level, t_ns: False

    async with led_unit(calibration_of_unit_3, config(when_unknown=when_unknown), prepare) as running:
        report = await running.report(1)
        assert report.document["verdict"] == "unknown"
        assert report.document["targets"]["front"]["leds_found"] == 0  # type: ignore[index]
        assert "dark" in report.sentence
        if when_unknown == "warning":
            assert "geometry_unknown" in codes(await running.measured(valid=True))
        else:
            assert "geometry_unverified" in codes(await running.measured())
            assert not (await running.measured()).valid


async def test_a_lamp_line_that_was_taken_away_is_named(calibration_of_unit_3: Calibration) -> None:
    async with led_unit(calibration_of_unit_3, config()) as running:
        assert (await running.report(1)).document["verdict"] == "good"
        running.leds.refuses = "GPIO chip 'unit': 'LED_A' taken by 'torch'"
        report = await running.check()
        assert report.document["verdict"] == "unknown"
        assert "'LED_A' taken by 'torch'" in report.sentence
        assert "geometry_unknown" in codes(await running.measured(valid=True))
        running.leds.refuses = ""
        assert (await running.check()).document["verdict"] in ("unknown", "good")  # the keeper waits a while
        while (await running.check()).document["verdict"] != "good":
            pass


async def test_leds_that_stay_lit_make_nothing_valid_and_are_named(
    calibration_of_unit_3: Calibration,
) -> None:
    async with led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.leds.follow = lambda level, t_ns: True
        report = await running.check()
        assert report.document["verdict"] == "unknown"
        assert "lit" in report.sentence
        stuck = await running.measured(valid=False)
        assert any("the frame LEDs are lit" in fault.detail for fault in stuck.status)


async def test_a_light_that_blinks_by_itself_is_named_and_spoils_nothing(
    calibration_of_unit_3: Calibration,
) -> None:
    blinker = Stray(-40.0, 30.0, level=1.0, shines=Shines.BY_ITSELF)

    def prepare(running: LedUnit) -> None:
        running.unit.set_lights(FRONT, strays=(blinker,))

    async with led_unit(calibration_of_unit_3, config(exposures=8), prepare) as running:
        report = await running.report(1)
        assert any("came or went by itself" in note for note in report.document["notes"])  # type: ignore[union-attr]
        assert report.document["verdict"] == "good"


async def test_a_lamp_that_flashes_beside_an_led_moves_no_verdict(
    calibration_of_unit_3: Calibration,
) -> None:
    """A disc of light, as bright as an LED, over the edge of one, in one lit exposure."""
    u, v = calibration_of_unit_3.targets[0].leds_px[2]
    rows, columns = np.mgrid[0:480, 0:752]
    flash = np.where(np.hypot(columns - u - 6, rows - v) < 7, 120, 0)
    flashed: list[int] = []

    def alter(frame: Frame) -> Frame:
        if frame.camera == FRONT and frame.leds_on and not flashed:
            flashed.append(frame.sequence)
            pixels = np.minimum(frame.pixels.astype(int) + flash, 255).astype(np.uint8)
            pixels.flags.writeable = False
            return replace(frame, pixels=pixels)
        return frame

    async with led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.seen.alter = alter
        report = await running.check()
        assert flashed
        assert report.document["verdict"] in ("good", "unknown")
        assert (await running.check()).document["verdict"] == "good"


async def test_a_camera_that_stands_still_during_a_check_is_named(calibration_of_unit_3: Calibration) -> None:
    frozen: dict[str, Frame] = {}

    def alter(frame: Frame) -> Frame:
        still = frozen.setdefault(frame.camera, frame) if frame.camera == REAR else frame
        return replace(frame, pixels=still.pixels)

    async with led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.seen.alter = alter
        report = await running.check()
        assert report.document["verdict"] == "unknown"
        assert "rear: the camera stands still" in report.sentence
        assert not (await running.measured(valid=False)).valid


async def test_a_beam_that_jumps_during_a_check_makes_no_drift_and_is_checked_after(
    calibration_of_unit_3: Calibration,
) -> None:
    """With the first lit exposure, by 20 mm on both targets: the spot is in the lit frames elsewhere."""
    async with led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)

        def jump(level: bool, t_ns: int) -> bool:
            if level:
                running.unit.place(POSE)
            return level

        running.leds.follow = jump
        report = await running.check()
        assert report.document["verdict"] in ("good", "unknown")
        assert (await running.check()).document["verdict"] == "good"


async def test_a_blow_that_moves_all_spots_is_followed_by_a_check(calibration_of_unit_3: Calibration) -> None:
    async with led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        await running.measured(valid=True)
        running.unit.place(replace(POSE, x_mm=POSE.x_mm + 5.0))
        report = await running.report(2)
        assert (report.document["cause"], report.document["verdict"]) == ("shock", "good")
        assert running.daemon.health.component("self-check").counters["shocks"] == 1


async def test_a_spot_over_an_led_does_not_move_it(calibration_of_unit_3: Calibration) -> None:
    """As near to an LED of the front target as the spot may come and be measured."""
    x_mm, y_mm = max(LED_POSITIONS_MM, key=lambda place: (place[1] < 0, place[0]))
    beside = BeamPose(x_mm=0.86 * x_mm, y_mm=0.86 * y_mm, slope_x=0.0, slope_y=0.0)

    def prepare(running: LedUnit) -> None:
        running.unit.place(beside)

    async with led_unit(calibration_of_unit_3, config(), prepare) as running:
        report = await running.report(1)
        assert report.document["verdict"] == "good"
        running.unit.displace(FRONT, MOVED)
        report = await running.check()
        assert report.document["verdict"] == "bad"
        assert report.document["targets"]["front"]["turn_deg"] == pytest.approx(0.1, abs=0.02)  # type: ignore[index]


async def test_a_daemon_that_is_stopped_during_a_check_leaves_the_leds_dark(
    calibration_of_unit_3: Calibration,
) -> None:
    async with led_unit(calibration_of_unit_3, config(exposures=20)) as running:
        await running.lit()
    assert running.leds.line[-1][1] is False
    assert running.daemon.health.self_check.latest is None


async def test_a_unit_without_references_measures_as_ever_and_says_why_it_is_not_checked(
    calibration_of_unit_3: Calibration,
) -> None:
    targets = [replace(target, leds_px=np.zeros((0, 2))) for target in calibration_of_unit_3.targets]
    without = replace(calibration_of_unit_3, targets=tuple(targets))
    async with led_unit(without, config()) as running:
        assert codes(await running.measured(valid=True)) <= {"simulated", "exposures_lost"}
        assert running.leds.lit_s == []
        assert running.daemon.health.self_check.unavailable == (
            "the calibration has no LED references for front, rear"
        )
        assert "self-check" not in [component.name for component in running.daemon.health]


async def test_by_its_settings_it_checks_only_when_asked(calibration_of_unit_3: Calibration) -> None:
    async with led_unit(calibration_of_unit_3, config(enabled=False)) as running:
        assert codes(await running.measured(valid=True)) <= {"simulated", "exposures_lost"}
        assert running.leds.lit_s == []
        assert (await running.check()).document["verdict"] == "good"
