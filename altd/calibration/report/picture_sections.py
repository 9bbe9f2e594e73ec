"""How repeatable the spots are, and what the cameras saw."""

from __future__ import annotations

import numpy as np

from altd.calibration.report import picture_plots
from altd.calibration.report.document import Block, Heading, Picture, Row, Table, Words
from altd.calibration.report.source import Source
from altd.calibration.report.target_plots import nice_length
from altd.records import FloatArray

_MAX_ELLIPSE_SHARE = 0.05
"""Of the picture's width."""


def pictures(source: Source) -> list[Block]:
    """Scatter at the nodes, spots and LEDs in the picture."""
    seen_by, scatters = [], []
    widths = [target.width for target in source.calibration.targets]
    largest = max(_largest(seen.scatter_px) for _, seen in source.targets())
    scale = nice_length(_MAX_ELLIPSE_SHARE * min(widths) / largest) if largest > 0 else 1.0
    for target, seen in source.targets():
        size = target.width, target.height
        height_in = picture_plots.height_in(size)
        draw = picture_plots.picture(
            target.name, size, source.negatives.get(target.name), seen.nodes_px, target.leds_px
        )
        seen_by.append(Picture(f"spots and LEDs in the picture of {target.name}", height_in, draw))
        draw = picture_plots.scatter(target.name, size, seen.nodes_px, seen.scatter_px, seen.exposures, scale)
        scatters.append(Picture(f"repeatability at the nodes of {target.name}", height_in, draw))
    targets = source.calibration.targets
    most = max(len(target.leds_px) for target in targets)
    leds = tuple(
        (f"LED {n + 1}", *(_led(target.leds_px[n]) if n < len(target.leds_px) else "–" for target in targets))
        for n in range(most)
    )
    blocks: list[Block] = [
        Heading("How repeatable a spot is"),
        Row(
            tuple(scatters),
            "Scatter of single exposures at each node in the camera's picture: ellipses of 1 sigma, "
            f"{scale:g} times enlarged, the same scale for all (Fig. 3.22). With two exposures a node one "
            "ellipse says little; all of them together say how steady spots are, and where they are not. "
            "Crosses: nodes with one exposure.",
        ),
        Heading("What the cameras saw"),
        Row(
            tuple(seen_by),
            "The whole scan in one picture, as a negative: dark where light fell. Crosses: the nodes as "
            "localised. Circles: the frame LEDs at their reference positions, numbered as in the table. A "
            "camera behind its target sees it mirrored. A spot without a cross is the beam while the LEDs "
            "were recorded, or a node left out.",
        ),
    ]
    if leds:
        columns = ("", *(f"{target.name}, u and v in px" for target in targets))
        blocks.append(Table(columns, leds, (0.16, *[0.84 / len(targets)] * len(targets))))
    dropped = [f"{target.name} {led}" for target, seen in source.targets() for led in seen.leds_dropped]
    if dropped:
        blocks.append(Words(f"Shines, but could not be located: {'; '.join(dropped)}."))
    return blocks


def _led(place_px: FloatArray) -> str:
    return f"{place_px[0]:.2f}, {place_px[1]:.2f}"


def _largest(scatter_px: FloatArray) -> float:
    known = scatter_px[np.isfinite(scatter_px)]
    return float(known.max()) if len(known) else 0.0
