"""The whole daemon corrects a drift that its self-check found, and says when it does not."""

import pytest
from support.led_unit import MOVED, POSE, LedUnit, codes, config, driven_led_unit

from altd.acquisition.self_check import geometry_state
from altd.measuring.calibration import Calibration
from hw_sim.displacement import Displacement
from hw_sim.unit import FRONT, REAR


@pytest.mark.parametrize("camera", [FRONT, REAR])
async def test_compensation_takes_a_drift_out_and_says_so(
    calibration_of_unit_3: Calibration, camera: str
) -> None:
    """Of the plain plate's camera, and of the printed target's, whose view is checked by its print."""

    def prepare(running: LedUnit) -> None:
        running.unit.place(POSE)
        running.unit.displace(camera, MOVED)

    async with driven_led_unit(calibration_of_unit_3, config(compensate=True), prepare) as running:
        report = await running.report(1)
        assert report.check.verdict == "bad"
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


async def test_a_correction_that_no_check_confirms_ends_and_the_drift_counts(
    calibration_of_unit_3: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(geometry_state, "MAX_UNCONFIRMED_INTERVALS", 0.3)  # 3 s, of the shortest interval

    def prepare(running: LedUnit) -> None:
        running.unit.place(POSE)
        running.unit.displace(REAR, MOVED)

    settings = config(compensate=True, when_bad="warning", interval_s=10)
    async with driven_led_unit(calibration_of_unit_3, settings, prepare) as running:
        await running.report(1)
        corrected = last = await running.measured(valid=True)
        while "compensated" in codes(last):
            corrected, last = last, await running.measured(valid=True)
        health = running.daemon.health.component("self-check")
        assert (health.state, health.message.split(":")[0]) == ("degraded", "the correction has ended")
    assert "geometry_suspect" in codes(last)
    off_mm_per_m = [
        abs((one.number("yaw_mm_per_m") or 0.0) - 1000 * POSE.slope_x) for one in (corrected, last)
    ]
    assert off_mm_per_m[0] < 0.15 < 0.3 < off_mm_per_m[1]  # 0.6 px are 0.15 mm, over 280 mm 0.54 mm/m


async def test_a_drift_beyond_what_may_be_compensated_is_invalid(calibration_of_unit_3: Calibration) -> None:
    def prepare(running: LedUnit) -> None:
        running.unit.displace(REAR, Displacement((4.0, 0.0)))

    settings = config(compensate=True, compensate_mm=0.5)
    async with driven_led_unit(calibration_of_unit_3, settings, prepare) as running:
        await running.report(1)
        after = await running.measured()
        assert not after.valid
        drift = next(fault for fault in after.status if str(fault) == "geometry_drift")
        assert "not corrected: rear" in drift.detail
