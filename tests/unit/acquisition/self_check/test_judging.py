"""From the frames of both cameras to a verdict, on frames whose LEDs are numbers in the test."""

from dataclasses import replace

import numpy as np
import pytest
from support.led_frames import LEDS, Motion, Scene, unit

from altd.acquisition.self_check.exposing import CheckFrames
from altd.acquisition.self_check.judging import CheckJudge
from altd.config import Installation
from altd.measuring.chain import View
from altd.records import Frame
from altd.selfcheck.records import DriftLimits, SelfCheck, Verdict

PER_LIGHT = 2
NEAR_LED = ((float(LEDS[0, 0]) + 14.0, float(LEDS[0, 1])),)


def exposed(scene: Scene, of_last: Scene | None = None) -> tuple[tuple[Frame, ...], ...]:
    """Frames of one camera off, on and off again; the last under the LEDs may show something else."""
    rng = np.random.default_rng(2)
    view, other = scene.view(rng, 2 * PER_LIGHT), (of_last or scene).view(rng, PER_LIGHT)
    lit = (*view.lit[: PER_LIGHT - 1], other.lit[-1])
    frames = (*view.dark[:PER_LIGHT], *lit, *view.dark[PER_LIGHT:])
    timed = [replace(frame, sequence=n, t_ns=n * 50_000_000) for n, frame in enumerate(frames)]
    return tuple(timed[:PER_LIGHT]), tuple(timed[PER_LIGHT : 2 * PER_LIGHT]), tuple(timed[2 * PER_LIGHT :])


def judged(
    front: tuple[tuple[Frame, ...], ...],
    rear: tuple[tuple[Frame, ...], ...],
    previous: Verdict | None = None,
    **installed: object,
) -> SelfCheck:
    views = [View(name, name) for name in ("front", "rear")]
    by_light = (dict(zip(("front", "rear"), of, strict=True)) for of in zip(front, rear, strict=True))
    judge = CheckJudge(views, unit(), DriftLimits(), Installation.model_validate(installed))
    return judge.judge(CheckFrames(*by_light), {}, previous)


BLINKING = exposed(Scene(), Scene(reflections=NEAR_LED))


def test_undisturbed_frames_are_judged_as_they_are() -> None:
    assert judged(exposed(Scene()), exposed(Scene())).verdict is Verdict.GOOD


def test_a_light_that_blinks_near_an_led_leaves_no_verdict_where_nothing_else_is_wrong() -> None:
    found = judged(BLINKING, exposed(Scene()))
    assert found.verdict is Verdict.UNKNOWN
    assert [reason.partition(":")[0] for reason in found.reasons] == ["front"]
    assert "near an LED, appeared or vanished without the LEDs" in found.sentence


def test_a_light_that_blinks_before_one_target_does_not_hide_the_drift_of_the_other() -> None:
    found = judged(BLINKING, exposed(Scene(Motion(2.0))))
    assert (found.verdict, found.is_whole) == (Verdict.BAD, False)
    assert [reason.partition(":")[0] for reason in found.reasons] == ["rear", "front"]
    assert "near an LED, appeared or vanished without the LEDs" in found.sentence
    assert judged(BLINKING, exposed(Scene(Motion(0.25))), Verdict.BAD).verdict is Verdict.UNKNOWN


def test_what_a_drift_makes_of_a_measurement_has_the_signs_of_its_installation() -> None:
    """4 px/mm; the front camera sees x mirrored, v runs down: 1 px right and down are -0.25 and -0.25 mm."""
    of_unit = {"x_mm": -0.25, "y_mm": -0.25, "yaw_deg": 0.0512, "pitch_deg": 0.0512}
    signs = {"sign_x": -1, "sign_y": 1, "sign_yaw": 1, "sign_pitch": -1}
    frames = exposed(Scene(Motion(1.0, 1.0))), exposed(Scene())
    for installed in ({}, signs):
        effects = judged(*frames, **installed, offset_x_mm=5.0).effects
        for key, value in of_unit.items():
            sign = installed.get(f"sign_{key.partition('_')[0]}", 1)
            assert effects[key].value == pytest.approx(sign * value, abs=0.01 * abs(value) + 0.001)
            assert effects[key].sigma is not None
            assert effects[key].sigma > 0
