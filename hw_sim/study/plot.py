"""How the studies' figures look, and how they become files that do not change from run to run."""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

OURS, THESIS, THIRD, FOURTH, GREY = "#0b6e99", "#d1495b", "#2e8b57", "#b07d12", "#7a7a7a"
"""Colours that print and colour-blind eyes tell apart."""

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


def panels(
    rows: int = 1, columns: int = 1, *, width: float = 0.0, height: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """A figure and its axes, row by row; sizes in inches, by default 4.2 × 3.3 a panel."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width or 4.2 * columns, height or 3.3 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.flat)


def as_svg(figure: Figure, salt: str) -> str:
    """The figure as SVG without date and with ids that depend on ``salt`` alone."""
    stream = io.StringIO()
    with mpl.rc_context({**STYLE, "svg.hashsalt": salt, "svg.fonttype": "path"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r"[ \t]+$", "", stream.getvalue(), flags=re.MULTILINE)
