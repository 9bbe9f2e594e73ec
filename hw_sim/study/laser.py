"""Laser power: the reference laser from 1 to 5 mW at one setting of the cameras."""

from __future__ import annotations

from dataclasses import replace

from hw_sim.beam import Laser
from hw_sim.study.result import Progress, Result
from hw_sim.study.sweep import COLUMNS, EXPOSURES, POSES, plot, rows, sweep
from hw_sim.unit import EXPOSURES_MS, FRONT, UnitConfig

TITLE = "Laser power from 1 to 5 mW"
QUESTION = "Do lasers of the specified 1 to 5 mW measure alike, with exposure and calibration made for 3 mW?"

SEED = 71
POWERS_MW = (1.0, 2.0, 3.0, 4.0, 5.0)


def run(progress: Progress) -> Result:
    """Calibrated at 3 mW, measured at every power."""
    base = UnitConfig(seed=SEED)
    points = sweep(
        base, [(power, replace(base, laser=Laser(power_mw=power))) for power in POWERS_MW], progress, "laser"
    )
    weak, usual, strong = points[0].ours, points[2].ours, points[-1].ours
    return Result(
        of="power",
        thesis_source="App. A.1, a specification without a test: 1 to 5 mW, ±1 mm, ±1 mm/m (0.0573°)",
        columns=COLUMNS,
        rows=rows(points, "mW", POWERS_MW),
        headline=(
            f"At 1, 3 and 5 mW the error is {weak[0]:.4f}, {usual[0]:.4f} and {strong[0]:.4f} mm, "
            f"{weak[1]:.5f}°, {usual[1]:.5f}° and {strong[1]:.5f}°."
        ),
        text=f"""
One unit, calibrated once at {base.laser.power_mw:g} mW, measures the same {POSES} beams with each laser,
{EXPOSURES} exposures each, at {base.lux:g} lx. The exposure stays at {EXPOSURES_MS[FRONT]:g} ms, which
brings 3 mW to about three quarters of full scale: at 1 mW the spot is dim and noisy, from about 4 mW its
middle is clipped. An operator who sets the exposure for his laser does better than either end of this
table.
""",
        figure=plot(points, "laser power, mW"),
        caption="Errors and scatter against laser power",
    )
