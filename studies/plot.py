"""Style of the studies' figures, and files of them that do not change from run to run."""

import io
import math
import re
from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from altd.records import FloatArray

OURS, THESIS, THIRD, FOURTH, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#777777"
"""Of the palette by Okabe and Ito, which colour-blind eyes tell apart too."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


def style() -> AbstractContextManager[None]:
    """Within it figures are drawn and saved in the studies' style."""
    return mpl.rc_context(STYLE)


def panels(
    rows: int = 1, columns: int = 1, *, width: float = 0.0, height: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """A figure and its axes, row by row; sizes in inches, by default 4.2 × 3.3 a panel."""
    figure = Figure(figsize=(width or 4.2 * columns, height or 3.3 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.flat)


def draw_arrows(
    axis: Axes, at_mm: FloatArray, vectors: FloatArray, unit: str, *, divisor: float = 1.0
) -> None:
    """Vectors (n, 2) at places (n, 2) in mm; the longest is as long as 16 mm, and a key says what that is.

    ``divisor`` takes the vectors' numbers to ``unit``.
    """
    longest = float(np.nanmax(np.linalg.norm(vectors, axis=1)))
    arrows = axis.quiver(
        *at_mm.T, *vectors.T, color=OURS, angles="xy", scale_units="xy", scale=longest / 16.0, width=0.005
    )
    key = round_below(longest)
    axis.quiverkey(arrows, 0.74, 1.05, key, f"{key / divisor:g}{unit}", labelpos="E")


def round_below(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    decade = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= value * (1.0 + 1e-9))


def plain_decades(axis: Axis) -> None:
    """A logarithmic axis with plain numbers at 1, 2 and 5 of each decade."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def as_svg(figure: Figure, salt: str) -> str:
    """The figure as SVG without date and with ids that depend on ``salt`` and their order alone.

    matplotlib's own ids of clips and markers depend on the last bit of their coordinates.
    """
    stream = io.StringIO()
    with style(), mpl.rc_context({"svg.hashsalt": salt, "svg.fonttype": "path"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    slim = re.sub(r'(?<= [dxy]=")[^"]*|translate[^)]*', _in_hundredths, stream.getvalue())
    ids = {old: f"{old[0]}{number}" for number, old in enumerate(dict.fromkeys(_ID.findall(slim)))}
    slim = _ID.sub(lambda old: ids[old[0]], slim)
    return re.sub(r"^[ \t]+|[ \t]+$", "", slim, flags=re.MULTILINE)


_ID = re.compile(r"(?<=[\"#])[a-z][0-9a-f]{10}\b")


def _in_hundredths(path: re.Match[str]) -> str:
    """A path's coordinates to a hundredth of a point: half the file, and nothing that an eye can see."""
    return re.sub(r"\d+\.\d{3,}", lambda number: f"{float(number[0]):.2f}", path[0])
