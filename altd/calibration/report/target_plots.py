"""Drawings over the target, in mm, seen along the beam: x to the right, y up; style of all drawings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from warnings import catch_warnings, filterwarnings

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.contour import ContourSet
from matplotlib.figure import FigureBase
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator

from altd.calibration.report.document import WIDTH_IN
from altd.calibration.result import TargetEvidence
from altd.measuring.calibration import TargetCalibration
from altd.records import FloatArray

INK, QUIET, FAINT = "#1a1a1a", "#5f6670", "#d5d9de"
BLUE, VERMILION, GREEN, ORANGE = "#0072b2", "#d55e00", "#009e73", "#e69f00"
"""Okabe and Ito's colours, which colour-blind readers can distinguish."""

_STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # shipped with matplotlib: the same on every computer
    "font.size": 7.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 5.0,
    "axes.labelsize": 7.5,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "text.color": INK,
    "text.parse_math": False,  # a recording's note may have a $ in it
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 7.0,
    "svg.fonttype": "path",
    "svg.hashsalt": "altd",
    "pdf.fonttype": 42,
}


@contextmanager
def report_style() -> Iterator[None]:
    """Apply the report's own style, independent of matplotlib's settings on this computer."""
    with matplotlib.style.context(["default", _STYLE]), catch_warnings():
        filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # a note may be in any language
        yield


@dataclass(frozen=True, slots=True)
class SizedFigure:
    """A figure, or a part of one, with its size."""

    figure: FigureBase
    width_in: float
    height_in: float

    def axes(self, left_in: float, bottom_in: float, right_in: float, top_in: float) -> Axes:
        """Add axes with these margins."""
        axes: Axes = self.figure.add_axes(
            (
                left_in / self.width_in,
                bottom_in / self.height_in,
                (self.width_in - left_in - right_in) / self.width_in,
                (self.height_in - bottom_in - top_in) / self.height_in,
            )
        )
        return axes


_LEFT_IN, _BOTTOM_IN, _RIGHT_IN, _TOP_IN = 0.48, 0.42, 0.1, 0.28
_BAR_IN = 0.52
_AROUND_MM = 12.0
_MIN_SPAN_SHARE = 0.05
"""Minimum span of a colour scale, as a share of its largest value."""

Draw = Callable[[SizedFigure], None]


@dataclass(frozen=True, slots=True, eq=False)
class ValueGrid:
    """Values (rows, columns, …) over a target's plane: one row per y, one column per x."""

    x_mm: FloatArray
    y_mm: FloatArray
    values: FloatArray


class ShownArea:
    """The part of a target's plane that all its drawings show; it determines their height."""

    def __init__(self, hulls_mm: Sequence[FloatArray], around_mm: float = _AROUND_MM) -> None:
        corners = np.vstack(hulls_mm)
        self.low, self.high = corners.min(axis=0) - around_mm, corners.max(axis=0) + around_mm

    def height_in(self, bar: bool = False) -> float:
        """Height of a drawing ``WIDTH_IN`` wide with the same scale along x and y."""
        width_in = WIDTH_IN - _LEFT_IN - _RIGHT_IN - (_BAR_IN if bar else 0)
        across, up = self.high - self.low
        return float(width_in * up / across) + _BOTTOM_IN + _TOP_IN

    def axes(self, canvas: SizedFigure, title: str, bar: bool = False) -> Axes:
        """Add axes in mm of the unit frame."""
        axes = canvas.axes(_LEFT_IN, _BOTTOM_IN, _RIGHT_IN + (_BAR_IN if bar else 0), _TOP_IN)
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(self.low[1], self.high[1])
        axes.set_aspect("equal")
        axes.set_title(title)
        axes.set_xlabel("x in mm", labelpad=2)
        axes.set_ylabel("y in mm", labelpad=1)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MultipleLocator(25))
        return axes


def nice_length(longest: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not longer."""
    if not longest > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(step * power for step in (1, 2, 5) if step * power <= longest * (1 + 1e-9)))


def arrows(
    plane: ShownArea, target: TargetCalibration, seen: TargetEvidence, offsets_mm: FloatArray, scale: float
) -> Draw:
    """Residual vectors as in Fig. 3.13, ``scale`` times as long as the offsets (n, 2), with a scale arrow."""

    def draw(canvas: SizedFigure) -> None:
        axes = plane.axes(canvas, target.name)
        axes.add_patch(
            Polygon(target.map.hull_mm, fill=False, edgecolor=QUIET, linewidth=0.7, linestyle=(0, (4, 3)))
        )
        key_mm = nice_length(18.0 / scale)
        _vectors(axes, plane, seen.nodes_mm, scale * offsets_mm, (scale * key_mm, f"{1000 * key_mm:g} µm"))
        for place, _ in seen.excluded:
            axes.plot(*place, "x", color=VERMILION, markersize=6, markeredgewidth=1.6)

    return draw


def vectors(
    plane: ShownArea, title: str, places_mm: FloatArray, arrows_mm: FloatArray, key: tuple[float, str]
) -> Draw:
    """Arrows (n, 2) at places (n, 2), in drawn length; ``key`` is the scale arrow's length and its words."""
    return lambda canvas: _vectors(plane.axes(canvas, title), plane, places_mm, arrows_mm, key)


def _vectors(
    axes: Axes, plane: ShownArea, places_mm: FloatArray, arrows_mm: FloatArray, key: tuple[float, str]
) -> None:
    axes.grid()
    axes.plot(places_mm[:, 0], places_mm[:, 1], "o", color=QUIET, markersize=1.8)
    _quiver(axes, places_mm, arrows_mm, BLUE)
    _key(axes, plane, *key)


def differences(plane: ShownArea, title: str, over: ValueGrid, largest_mm: float, scale: float) -> Draw:
    """Offsets (rows, columns, 2) in mm of another map: colour for length, and some arrows."""

    def draw(canvas: SizedFigure) -> None:
        axes = plane.axes(canvas, title, bar=True)
        x_mm, y_mm, offsets_mm = over.x_mm, over.y_mm, over.values
        length_um = 1000 * np.linalg.norm(offsets_mm, axis=2)
        levels = MaxNLocator(7).tick_values(0, 1000 * largest_mm)
        filled = axes.contourf(x_mm, y_mm, length_um, levels=levels, cmap="YlGnBu", extend="max")
        colour_scale(canvas, axes, filled, "µm")
        rows, columns = slice(2, None, 7), slice(2, None, 6)
        grid = np.stack(np.meshgrid(x_mm[columns], y_mm[rows]), axis=-1).reshape(-1, 2)
        _quiver(axes, grid, scale * offsets_mm[rows, columns].reshape(-1, 2), INK)
        key_mm = nice_length(18.0 / scale)
        _key(axes, plane, scale * key_mm, f"{1000 * key_mm:g} µm")

    return draw


def contours(plane: ShownArea, title: str, over: ValueGrid, limits: tuple[float, float], unit: str) -> Draw:
    """A value (rows, columns) over the area, NaN where there is none, on the given scale."""

    def draw(canvas: SizedFigure) -> None:
        axes = plane.axes(canvas, title, bar=True)
        low, high = limits
        # a very small difference must not look large
        slack = max(_MIN_SPAN_SHARE * high - (high - low), 0.0) / 2
        levels = MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]).tick_values(low - slack, high + slack)
        filled = axes.contourf(over.x_mm, over.y_mm, over.values, levels=levels, cmap="YlGnBu")
        lines = axes.contour(over.x_mm, over.y_mm, over.values, levels=levels, colors=INK, linewidths=0.5)
        axes.clabel(lines, fontsize=6, fmt="%g", inline_spacing=2)
        colour_scale(canvas, axes, filled, unit)

    return draw


def _quiver(axes: Axes, places_mm: FloatArray, arrows_mm: FloatArray, colour: str) -> None:
    axes.quiver(
        *places_mm.T, *arrows_mm.T, color=colour, angles="xy", scale_units="xy", scale=1, units="inches",
        width=0.014, headwidth=4.5, headlength=5.5, headaxislength=5, minlength=0.1, zorder=3, clip_on=False,
    )  # fmt: skip


def _key(axes: Axes, plane: ShownArea, length_mm: float, words: str) -> None:
    """Draw a scale arrow in the title's line, where there are no other arrows."""
    right = plane.high[0]
    top = plane.high[1] + 0.045 * (plane.high[1] - plane.low[1])
    axes.annotate(
        words, (right - length_mm, top), (-3, 0), textcoords="offset points", ha="right", va="center",
        fontsize=7, annotation_clip=False,
    )  # fmt: skip
    _quiver(axes, np.array([[right - length_mm, top]]), np.array([[length_mm, 0.0]]), INK)


def colour_scale(canvas: SizedFigure, axes: Axes, coloured: ContourSet | AxesImage, unit: str) -> Colorbar:
    """Add a colour scale at the right edge, as high as the axes."""
    box = axes.get_position()
    inch = 1 / canvas.width_in
    bar = canvas.figure.add_axes((box.x1 + 0.07 * inch, box.y0, 0.1 * inch, box.height))
    scale = canvas.figure.colorbar(coloured, cax=bar)
    scale.outline.set_edgecolor(FAINT)
    bar.set_title(unit, fontsize=7, fontweight="normal", loc="left", pad=4)
    bar.tick_params(labelsize=6.5, length=2)
    return scale
