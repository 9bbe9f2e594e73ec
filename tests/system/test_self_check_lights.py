"""The whole daemon's self-check where LEDs fail and other lights come and go."""

from dataclasses import replace

import numpy as np
import pytest
from support.led_unit import LedUnit, codes, config, driven_led_unit

from altd.measuring.calibration import Calibration
from altd.records import Frame
from hw_sim.frame_leds import Shines, Stray
from hw_sim.unit import FRONT


@pytest.mark.parametrize("when_unknown", ["warning", "invalid"])
async def test_leds_that_all_stay_dark_are_named(
    calibration_of_unit_3: Calibration, when_unknown: str
) -> None:
    def prepare(running: LedUnit) -> None:
        running.leds.follow = lambda level, t_ns: False

    async with driven_led_unit(calibration_of_unit_3, config(when_unknown=when_unknown), prepare) as running:
        report = await running.report(1)
        assert report.check.verdict == "unknown"
        assert report.check.targets["front"].leds_found == 0
        assert "dark" in report.check.sentence
        if when_unknown == "warning":
            assert "geometry_unknown" in codes(await running.measured(valid=True))
        else:
            assert "geometry_unverified" in codes(await running.measured())
            assert not (await running.measured()).valid


async def test_a_lamp_line_that_was_taken_away_is_named(calibration_of_unit_3: Calibration) -> None:
    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        assert (await running.report(1)).check.verdict == "good"
        running.leds.refuses = "GPIO chip 'unit': 'LED_A' taken by 'torch'"
        report = await running.check()
        assert report.check.verdict == "unknown"
        assert "'LED_A' taken by 'torch'" in report.check.sentence
        assert "geometry_unknown" in codes(await running.measured(valid=True))
        running.leds.refuses = ""
        assert (await running.check()).check.verdict in ("unknown", "good")  # the keeper waits a while
        while (await running.check()).check.verdict != "good":
            pass


async def test_leds_that_stay_lit_make_nothing_valid_and_are_named(
    calibration_of_unit_3: Calibration,
) -> None:
    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.leds.follow = lambda level, t_ns: True
        report = await running.check()
        assert report.check.verdict == "unknown"
        assert "lit" in report.check.sentence
        stuck = await running.measured(valid=False)
        assert any("the frame LEDs are lit" in fault.detail for fault in stuck.status)


async def test_a_light_that_blinks_by_itself_is_named_and_spoils_nothing(
    calibration_of_unit_3: Calibration,
) -> None:
    blinker = Stray(-40.0, 30.0, level=1.0, shines=Shines.BY_ITSELF)

    def prepare(running: LedUnit) -> None:
        running.unit.set_lights(FRONT, strays=(blinker,))

    async with driven_led_unit(calibration_of_unit_3, config(exposures=8), prepare) as running:
        report = await running.report(1)
        assert any("appeared or vanished without the LEDs" in note for note in report.check.notes)
        assert report.check.verdict == "good"


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

    async with driven_led_unit(calibration_of_unit_3, config()) as running:
        await running.report(1)
        running.seen.alter = alter
        report = await running.check()
        assert flashed
        assert report.check.verdict in ("good", "unknown")
        assert (await running.check()).check.verdict == "good"
