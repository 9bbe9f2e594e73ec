"""Drawings over the camera's picture, in px: u to the right, v down, (0, 0) the middle of the first pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator

from altd.calibration.report.canvas import BLUE, INK, QUIET, VERMILION, Canvas
from altd.calibration.report.document import WIDTH_IN
from altd.calibration.report.target_plots import Draw, nice_length
from altd.records import FloatArray, PixelArray

_LEFT_IN, _BOTTOM_IN, _RIGHT_IN, _TOP_IN = 0.48, 0.42, 0.1, 0.28

_HALO = [withStroke(linewidth=2.2, foreground="white")]
"""Keeps marks legible where the picture is dark."""


def height_in(size_px: tuple[int, int]) -> float:
    """Height of a drawing ``WIDTH_IN`` wide that shows the picture with square pixels."""
    return (WIDTH_IN - _LEFT_IN - _RIGHT_IN) * size_px[1] / size_px[0] + _BOTTOM_IN + _TOP_IN


def _axes(canvas: Canvas, title: str, size_px: tuple[int, int]) -> Axes:
    axes = canvas.axes(_LEFT_IN, _BOTTOM_IN, _RIGHT_IN, _TOP_IN)
    width, height = size_px
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_title(title)
    axes.set_xlabel("u in px", labelpad=2)
    axes.set_ylabel("v in px", labelpad=2)
    step = nice_length(width / 4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))
    return axes


def picture(
    title: str,
    size_px: tuple[int, int],
    negative: PixelArray | None,
    nodes_px: FloatArray,
    leds_px: FloatArray,
) -> Draw:
    """The scan in one picture, dark where light fell, with the nodes' spots and the frame LEDs."""

    def draw(canvas: Canvas) -> None:
        axes = _axes(canvas, title, size_px)
        width, height = size_px
        if negative is not None:
            axes.imshow(
                negative, cmap="gray", vmin=0, vmax=255, extent=(-0.5, width - 0.5, height - 0.5, -0.5),
                interpolation="bilinear",
            )  # fmt: skip
        axes.plot(
            nodes_px[:, 0],
            nodes_px[:, 1],
            "+",
            color=BLUE,
            markersize=5,
            markeredgewidth=0.9,
            path_effects=_HALO,
        )
        for number, (u, v) in enumerate(leds_px.tolist(), start=1):
            axes.add_patch(
                Circle((u, v), 0.026 * width, fill=False, edgecolor=VERMILION, linewidth=1.1, clip_on=False)
            )
            outward = -1 if u < 0.45 * width else 1
            axes.annotate(
                str(number), (u, v), (9.5 * outward, 0), textcoords="offset points", ha="center",
                va="center", fontsize=7, fontweight="bold", color=VERMILION,
                path_effects=_HALO,
            )  # fmt: skip

    return draw


def scatter(
    title: str,
    size_px: tuple[int, int],
    nodes_px: FloatArray,
    scatter_px: FloatArray,
    exposures: Sequence[int],
    scale: float,
) -> Draw:
    """Repeatability at each node: an ellipse of 1 sigma, ``scale`` times as large as it is (Fig. 3.22)."""

    def draw(canvas: Canvas) -> None:
        axes = _axes(canvas, title, size_px)
        axes.grid()
        single = ~np.isfinite(scatter_px).all(axis=1)
        axes.plot(*nodes_px.T, ".", color=QUIET, markersize=2)
        for (u, v), (of_u, of_v) in zip(nodes_px[~single], scatter_px[~single], strict=True):
            across_px = 2 * scale * of_u, 2 * scale * of_v
            axes.add_patch(
                Ellipse((u, v), *across_px, facecolor=BLUE + "40", edgecolor=BLUE, linewidth=0.8, zorder=3)
            )
        axes.plot(*nodes_px[single].T, "x", color=VERMILION, markersize=4)
        width = size_px[0]
        key_px = nice_length(0.09 * width / scale)
        right, above = width - 4.0, -0.035 * width
        axes.plot(
            [right - scale * key_px, right], [above, above], "|-", color=INK, linewidth=1.2, clip_on=False
        )
        counts = sorted(set(exposures))
        number = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        axes.annotate(
            f"{number} exposures a node      1 sigma = {key_px:g} px",
            (right - scale * key_px, above), (-5, 0), textcoords="offset points", ha="right", va="center",
            fontsize=7, annotation_clip=False,
        )  # fmt: skip

    return draw
