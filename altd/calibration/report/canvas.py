"""What every drawing shares: its size in inches, its look, the colours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from warnings import catch_warnings, filterwarnings

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

INK, QUIET, FAINT = "#1a1a1a", "#5f6670", "#d5d9de"
BLUE, VERMILION, GREEN, ORANGE = "#0072b2", "#d55e00", "#009e73", "#e69f00"
"""Okabe and Ito's colours, which colour-blind people tell apart."""

_STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib: the same on every computer
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
    """The report's own look, whatever matplotlib's settings on this computer are."""
    with matplotlib.style.context(["default", _STYLE]), catch_warnings():
        filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # a note may be in any language
        yield


@dataclass(frozen=True, slots=True)
class Canvas:
    """A figure, or a part of one, with its size."""

    figure: FigureBase
    width_in: float
    height_in: float

    def axes(self, left_in: float, bottom_in: float, right_in: float, top_in: float) -> Axes:
        """Axes with these margins."""
        axes: Axes = self.figure.add_axes(
            (
                left_in / self.width_in,
                bottom_in / self.height_in,
                (self.width_in - left_in - right_in) / self.width_in,
                (self.height_in - bottom_in - top_in) / self.height_in,
            )
        )
        return axes
