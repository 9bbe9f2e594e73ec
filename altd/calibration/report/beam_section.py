"""What a measurement will be worth: predicted sigma over the area and what makes it."""

from __future__ import annotations

import numpy as np

from altd.calibration.report import map_plots, target_plots
from altd.calibration.report.document import Block, Heading, Picture, Row
from altd.calibration.report.prediction import CAUSES, OF_SPOT, Prediction, name_of
from altd.calibration.report.source import Source, target_names_text
from altd.calibration.report.target_plots import Plane, Raster

_PER_UNIT = 1000
"""Pictures are in thousandths of a degree or of a millimetre."""


def beam_section(prediction: Prediction, source: Source) -> list[Block]:
    """Sigma of what is measured over the area, its causes and what averaging brings."""
    targets, exposures = source.calibration.targets, prediction.exposures
    plane = Plane([target.map.hull_mm for target in targets], around_mm=3.0)
    if prediction.quantities == OF_SPOT:
        caption = (
            "Predicted sigma (1 standard deviation) of one measurement of a spot on the target, "
            f"{exposures} exposures averaged. Seen along the beam; x and y share one scale."
        )
        rows = [Row(_pair(prediction, plane, "x_mm", "y_mm"), caption)]
    else:
        caption = (
            "Predicted sigma (1 standard deviation) of one measurement over the area, from "
            f"{target_names_text(targets)} together: a beam normal to the targets at (x, y), "
            f"{exposures} exposures averaged. Seen along the beam; yaw and pitch share one scale, "
            "x and y another."
        )
        rows = [
            Row(_pair(prediction, plane, "x_mm", "y_mm"), ""),
            Row(_pair(prediction, plane, "yaw_deg", "pitch_deg"), caption),
        ]
    names = tuple(map(name_of, prediction.quantities))
    budget = map_plots.budget("what makes sigma", names, prediction.shares, CAUSES)
    window = np.geomspace(1, 100, 60)
    last_two = prediction.quantities[-2:]
    sigmas = [
        (name_of(quantity), _PER_UNIT * prediction.rms_after(quantity, window)) for quantity in last_two
    ]
    averaging = map_plots.averaging(
        "what averaging brings", window, sigmas, exposures, f"sigma in {_unit(last_two[0])}, rms"
    )
    made_of = (
        "Pattern: print and speckle shift each spot by a fixed amount that differs from place to place. "
        "Map: what the nodes' noise leaves uncertain of it. Scatter: single exposures about their mean, "
        f"{exposures} averaged; it alone falls when more are averaged."
    )
    return [
        Heading("What a measurement will be worth"),
        *rows,
        Row(
            (
                Picture("what makes sigma", map_plots.BUDGET_IN, budget),
                Picture("sigma over the number of exposures averaged", map_plots.BUDGET_IN, averaging),
            ),
            made_of,
        ),
    ]


def _pair(prediction: Prediction, plane: Plane, *quantities: str) -> tuple[Picture, ...]:
    """Sigma of quantities over the area, on one scale."""
    sigmas = [_PER_UNIT * prediction.sigma[prediction.quantities.index(name)] for name in quantities]
    limits = float(np.nanmin(sigmas)), float(np.nanmax(sigmas))
    pictures = []
    for quantity, sigma in zip(quantities, sigmas, strict=True):
        name = name_of(quantity)
        over = Raster(prediction.x_mm, prediction.y_mm, sigma)
        draw = target_plots.contours(plane, f"sigma of {name}", over, limits, _unit(quantity))
        pictures.append(Picture(f"predicted sigma of {name} over the area", plane.height_in(bar=True), draw))
    return tuple(pictures)


def _unit(quantity: str) -> str:
    return "µm" if quantity in OF_SPOT else "10⁻³ °"
