"""Ambient light: the unit in the dark and in daylight."""

from dataclasses import replace
from functools import partial

from hw_sim.unit import Unit, UnitConfig
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

TITLE = "Ambient light to 1000 lx"
QUESTION = "Does stray light up to the specified 1000 lx disturb the measurement?"

SEED = 71
LUX = (0.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
SPECIFIED_LUX = 1000.0


def run(progress: Progress) -> Result:
    """Calibrated at 200 lx, measured from darkness to 1000 lx."""
    base = UnitConfig(seed=SEED)
    conditions = [Condition(f"{lux:g} lx", lux, partial(_unit, lux)) for lux in LUX]
    ordinary, harder = sweep(base, conditions, progress, "ambient")
    (dark, bright), (hard_dark, hard_bright) = (
        (points[0].ours, points[-1].ours) for points in (ordinary, harder)
    )
    return Result(
        of="light",
        thesis_source=(
            "App. A.1, a specification without a test: stray light to 1000 lx, ±1 mm, ±1 mm/m (0.0573°)"
        ),
        differs="the light is that behind the filter, without reflections",
        columns=COLUMNS,
        rows=rows(ordinary, harder, lambda point: point.value == SPECIFIED_LUX),
        headline=(
            f"From darkness to 1000 lx the error goes from {dark[0]:.4f} to {bright[0]:.4f} mm and from "
            f"{dark[1]:.5f}° to {bright[1]:.5f}°, on the harder simulator from {hard_dark[0]:.4f} to "
            f"{hard_bright[0]:.4f} mm and from {hard_dark[1]:.5f}° to {hard_bright[1]:.5f}°; "
            f"{refused_text([*ordinary, *harder])}."
        ),
        text=f"""
One unit, calibrated at {base.lux:g} lx, measures the same {POSES} beams at every level, {EXPOSURES}
exposures each: errors of means (`altd replay --window {EXPOSURES}`) and scatter of single exposures. The
light is that behind the interference filter; it slopes across the picture, falls off with the lens and
has photon noise. The laser has {base.laser.power_mw:g} mW in a spot of 12 × 11 mm. Reflections and moving
shadows are not simulated.
""",
        figure=plot({"": (ordinary, harder)}, "ambient light, lx"),
        caption="Errors and scatter against ambient light",
        beside="specified",
    )


def _unit(lux: float, base: UnitConfig) -> Unit:
    return Unit(replace(base, lux=lux))
