"""What a measurement will be worth: predicted sigma over the area and what makes it."""

from __future__ import annotations

import numpy as np

from altd.calibration.report import map_plots, target_plots
from altd.calibration.report.document import Block, Heading, Picture, Row
from altd.calibration.report.prediction import QUANTITIES, Prediction
from altd.calibration.report.source import Source
from altd.calibration.report.target_plots import Plane


def beam_section(prediction: Prediction, source: Source) -> list[Block]:
    """Sigma of x, y, yaw and pitch over the area, its causes and what averaging brings."""
    hulls = [target.map.hull_mm for target in source.calibration.targets]
    plane = Plane(hulls, around_mm=3.0)
    pictures = []
    for words, quantity, partner, unit, factor in (
        ("yaw", "yaw_deg", "pitch_deg", "10⁻³ °", 1000),
        ("pitch", "pitch_deg", "yaw_deg", "10⁻³ °", 1000),
        ("x", "x_mm", "y_mm", "µm", 1000),
        ("y", "y_mm", "x_mm", "µm", 1000),
    ):
        both = np.stack([prediction.sigma[QUANTITIES.index(name)] for name in (quantity, partner)])
        limits = factor * float(np.nanmin(both)), factor * float(np.nanmax(both))
        value = factor * prediction.sigma[QUANTITIES.index(quantity)]
        draw = target_plots.contours(
            plane, f"sigma of {words}", prediction.x_mm, prediction.y_mm, value, limits, unit
        )
        pictures.append(Picture(f"predicted sigma of {words} over the area", plane.height_in(bar=True), draw))
    caption = (
        "Predicted sigma (1 standard deviation) of one measurement over the area, from both targets "
        f"together: a beam normal to the targets at (x, y), {prediction.exposures} exposures averaged. Seen "
        "along the beam; yaw and pitch share one scale, x and y another."
    )
    names = ("x", "y", "yaw", "pitch")
    causes = ("pattern", "map", "scatter")
    budget = map_plots.budget("what makes sigma", names, prediction.shares, causes)
    window = np.geomspace(1, 100, 60)
    angles = [(name, 1000 * prediction.rms_after(f"{name}_deg", window)) for name in ("yaw", "pitch")]
    averaging = map_plots.averaging(
        "what averaging brings", window, angles, prediction.exposures, "sigma in 10⁻³ °, rms"
    )
    made_of = (
        "Pattern: print and speckle shift each spot by a fixed amount that differs from place to place. "
        "Map: what the nodes' noise leaves uncertain of it. Scatter: single exposures about their mean, "
        f"{prediction.exposures} averaged; it alone falls when more are averaged."
    )
    return [
        Heading("What a measurement will be worth"),
        Row((pictures[2], pictures[3]), ""),
        Row((pictures[0], pictures[1]), caption),
        Row(
            (
                Picture("what makes sigma", map_plots.BUDGET_IN, budget),
                Picture("sigma over the number of exposures averaged", map_plots.BUDGET_IN, averaging),
            ),
            made_of,
        ),
    ]
