"""Laser power: the reference laser from 1 to 5 mW at one setting of the cameras."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hw_sim.beam import Laser
from hw_sim.unit import CAMERAS, EXPOSURES_MS, FRONT, Unit, UnitConfig
from studies.result import Progress, Result
from studies.sweep import (
    COLUMNS,
    EXPOSURES,
    POSES,
    Condition,
    plot,
    refused_text,
    rows,
    sweep,
)

TITLE = "Laser power from 1 to 5 mW"
QUESTION = "Do lasers of the specified 1 to 5 mW measure alike, with exposure and calibration made for 3 mW?"

SEED = 71
POWERS_MW = (1.0, 2.0, 3.0, 4.0, 5.0)


def run(progress: Progress) -> Result:
    """Calibrated at 3 mW; measured at every power, at that exposure and at one that suits the power."""
    base = UnitConfig(seed=SEED)
    usual_mw = base.laser.power_mw
    fixed = [Condition(f"{mw:g} mW", mw, partial(_unit, base, mw, 1.0)) for mw in POWERS_MW]
    fitting = [
        Condition(f"{mw:g} mW, exposed for it", mw, partial(_unit, base, mw, usual_mw / mw))
        for mw in POWERS_MW
        if mw != usual_mw
    ]
    points = sweep(base, fixed + fitting, progress, "laser")
    kept, suited = points[: len(fixed)], points[len(fixed) :]
    suited = sorted([*suited, kept[POWERS_MW.index(usual_mw)]], key=lambda point: point.value)
    errors = [f"{which[i].ours[0]:.4f}" for which in (kept, suited) for i in (0, -1)]
    return Result(
        of="laser",
        thesis_source="App. A.1, a specification without a test: 1 to 5 mW, ±1 mm, ±1 mm/m (0.0573°)",
        columns=COLUMNS,
        rows=rows(points, lambda _point: True),
        headline=(
            f"At 1 and 5 mW the error is {errors[0]} and {errors[1]} mm at the exposure for 3 mW, "
            f"{errors[2]} and {errors[3]} mm exposed for the laser; {refused_text(points)}."
        ),
        text=f"""
One unit, calibrated at {usual_mw:g} mW, measures the same {POSES} beams with each laser, {EXPOSURES}
exposures each, at {base.lux:g} lx. First the exposure stays at {EXPOSURES_MS[FRONT]:g} ms, where 3 mW
reaches about three quarters of full scale: at 1 mW the spot is dim and noisy, from about 4 mW its middle
is clipped. Then the exposure is inverse to the power, which brings more stray light for a weak laser.
Errors are of measured beams; *invalid* counts the others.
""",
        figure=plot({", 3 mW's exposure": kept, ", exposed for it": suited}, "laser power, mW"),
        caption="Errors and scatter against laser power",
        beside="specified",
    )


def _unit(base: UnitConfig, power_mw: float, exposure: float) -> Unit:
    """The unit with that laser, at a multiple of the usual exposure."""
    unit = Unit(replace(base, laser=Laser(power_mw=power_mw)))
    for camera in CAMERAS:
        unit.set_camera(camera, exposure_ms=exposure * EXPOSURES_MS[camera])
    return unit
