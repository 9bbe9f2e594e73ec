"""Drawing of a replay over time: values with their sigma, and the reasons below them."""

from __future__ import annotations

import io
import math

from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from altd.answers.history import PlotHistory
from altd.calibration.report.target_plots import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    QUIET,
    VERMILION,
    report_style,
)
from altd.reasons import Reason

_WIDTH_IN, _PANEL_IN, _LANE_IN, _MARGIN_IN = 9.0, 1.45, 0.17, 1.1
_MAX_MARKED_BINS = 120
"""Maximum number of bins that can be distinguished: up to it, each is marked."""


def svg(history: PlotHistory, title: str, simulated: bool, joined: bool) -> bytes:
    """Return the drawing. Gaps are where nothing is valid; lanes below show which reasons hold, and when.

    ``joined`` draws consecutive points as one line; otherwise each is drawn alone, as the nodes of a scan.
    """
    codes = sorted(history.codes(), key=_is_warning)
    lanes = 1 + len(codes)
    heights = [*[_PANEL_IN] * len(history.quantities), _LANE_IN * lanes]
    with report_style():
        figure = Figure(figsize=(_WIDTH_IN, sum(heights) + _MARGIN_IN), layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        for panel, quantity in zip(axes, history.quantities, strict=False):
            _panel(panel, history, quantity, joined)
        _lane(axes[-1], history, codes)
        axes[-1].set_xlabel("last exposure of each mean, s since the recording's start")
        axes[0].set_title(title, color=INK)
        if simulated:
            axes[0].set_title("SIMULATED", loc="right", color=VERMILION)
        if not history.bins:
            axes[0].text(0.5, 0.5, "no measurement", ha="center", transform=axes[0].transAxes)
        figure.align_ylabels(axes[:-1])
        content = io.BytesIO()
        figure.savefig(content, format="svg", metadata={"Date": None, "Title": title})
    return content.getvalue()


def _panel(axes: Axes, history: PlotHistory, quantity: str, joined: bool) -> None:
    axes.set_ylabel(history.quantities[quantity].label)
    axes.grid(visible=True)
    for run in history.runs():
        t_s = [of.middle_s for of in run]
        means = [of.mean(quantity) for of in run]
        low, high = [of.low[quantity] for of in run], [of.high[quantity] for of in run]
        marker = "." if len(run) == 1 or len(history.bins) <= _MAX_MARKED_BINS or not joined else ""
        gid = f"sigma of {quantity}"
        if joined and len(run) > 1:
            axes.fill_between(t_s, low, high, color=BLUE, alpha=0.25, linewidth=0, gid=gid)
        else:  # a band without width is invisible
            axes.vlines(t_s, low, high, color=BLUE, alpha=0.35, linewidth=1.5, gid=gid)
        width = 0.8 if joined else 0.0
        gid = f"values of {quantity}"
        axes.plot(t_s, means, color=BLUE, linewidth=width, marker=marker, markersize=3, gid=gid)


def _lane(axes: Axes, history: PlotHistory, codes: list[str]) -> None:
    """Draw a row for ``valid`` and for each code, with a bar where it holds."""
    rows: list[tuple[str, str | None, str]] = [("valid", None, GREEN)]
    rows += [(code, code, ORANGE if _is_warning(code) else VERMILION) for code in codes]
    for number, (name, code, colour) in enumerate(rows):
        spans = [(start_s, end_s - start_s) for start_s, end_s in history.spans_s(code)]
        if spans:
            # with an edge: a reason of one exposure in an hour is still visible
            bars = axes.broken_barh(spans, (number - 0.35, 0.7), facecolors=colour, edgecolors=colour)
            bars.set(linewidth=0.7, gid=f"status {name}")
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=True, axis="x")
    for edge in ("top", "right"):
        axes.spines[edge].set_color(FAINT)
    axes.yaxis.label.set_color(QUIET)
    if history.bins:
        half_s = history.period_s / 2
        start_s, end_s = history.bins[0].first_s - half_s, history.bins[-1].last_s + half_s
        margin_s = 0.01 * max(end_s - start_s, math.ulp(end_s))
        axes.set_xlim(start_s - margin_s, end_s + margin_s)


def _is_warning(code: str) -> bool:
    return code in {reason for reason in Reason if reason.is_warning}
