"""Drawings of the choice of the map, its uncertainty and the causes of sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import Normalize, SymLogNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from altd.calibration.report.target_plots import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    QUIET,
    VERMILION,
    Draw,
    SizedFigure,
    colour_scale,
)
from altd.calibration.result import Candidate
from altd.records import FloatArray

CANDIDATES_IN = 3.2
COVARIANCE_IN = 3.1
BUDGET_IN = 1.95


def name_of(candidate: Candidate) -> str:
    """Name of the model with its degree along x and y."""
    if candidate.degree is None:
        return candidate.model
    return f"{candidate.model.removesuffix('tensor')} {candidate.degree[0]} × {candidate.degree[1]}".strip()


def candidates(
    title: str,
    tried: Sequence[Candidate],
    noise_px: FloatArray,
    chosen: int | None,
    limits_px: tuple[float, float],
) -> Draw:
    """Error against degree: the misfit falls, the noise left in the map, ``noise_px``, grows (Sec. 3.5.6)."""
    tensors = sum(c.model == "tensor" for c in tried)
    names = [name_of(c).replace(" × ", "×").replace("+", " + ") for c in tried]

    def draw(canvas: SizedFigure) -> None:
        axes = canvas.axes(0.5, 0.92, 0.08, 0.42)
        places = np.array([n + (0.6 if n >= tensors else 0.0) for n in range(len(tried))])
        if chosen is not None:
            axes.axvspan(places[chosen] - 0.45, places[chosen] + 0.45, color=FAINT, alpha=0.6, linewidth=0)
            axes.text(
                places[chosen], 0.985, "chosen", ha="center", va="top", fontsize=6.5, color=QUIET,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip
        for label, colour, marker, line, values in (
            ("node left out", BLUE, "o", "-", np.array([c.leave_one_out_px for c in tried])),
            ("cross-validation", GREEN, "s", "--", np.array([c.gcv_px for c in tried])),
            ("noise left in the map", VERMILION, "^", ":", noise_px),
        ):
            axes.plot(places[:tensors], values[:tensors], line, color=colour, linewidth=0.9)
            axes.plot(
                places, values, marker, color=colour, markersize=4, markeredgecolor="white",
                markeredgewidth=0.4, label=label,
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set_ylim(*limits_px)
        axes.yaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.grid(visible=True)
        axes.set_xlim(places[0] - 0.6, places[-1] + 0.6)
        axes.set_xticks(places, names, rotation=60, ha="right", va="center", rotation_mode="anchor")
        axes.tick_params(axis="x", pad=4, labelsize=6.5)
        canvas.figure.text(
            0.55, 0.06 / canvas.height_in, "tensor polynomial of degree x × y, then other models",
            ha="center", fontsize=7.5,
        )  # fmt: skip
        axes.set_ylabel("px, rms over u and v", labelpad=1)
        axes.set_title(title, pad=15)
        axes.legend(
            loc="lower left", bbox_to_anchor=(-0.02, 0.985), ncols=3, fontsize=6.5, handlelength=1.0,
            handletextpad=0.3, columnspacing=1.0,
        )  # fmt: skip

    return draw


def covariance(title: str, matrix_px2: FloatArray, largest_px2: float, symlog: bool, axis: str) -> Draw:
    """A covariance matrix as an image, zero white (Fig. 3.19)."""

    def draw(canvas: SizedFigure) -> None:
        axes = canvas.axes(0.48, 0.42, 0.62, 0.28)
        norm: Normalize
        if symlog:
            norm = SymLogNorm(largest_px2 * 1e-4, vmin=-largest_px2, vmax=largest_px2)
        else:
            norm = Normalize(-largest_px2, largest_px2)
        image = axes.imshow(matrix_px2, cmap="PuOr", norm=norm, interpolation="nearest")
        axes.set_title(title)
        axes.set_xlabel(axis, labelpad=2)
        axes.set_ylabel(axis, labelpad=1)
        axes.tick_params(length=2)
        for side in (axes.xaxis, axes.yaxis):
            side.set_major_locator(MaxNLocator(8, integer=True))
        scale = colour_scale(canvas, axes, image, "px²" if symlog else "10⁻⁶ px²")
        if symlog:
            scale.locator = FixedLocator(_decades(largest_px2))
            scale.minorlocator = FixedLocator([])
            scale.formatter = FuncFormatter(lambda value, _: _power(value))
        else:
            scale.formatter = FuncFormatter(lambda value, _: f"{value * 1e6:g}".replace("-", "−"))
        scale.update_ticks()

    return draw


def _power(value: float) -> str:
    """A power of ten as printed."""
    if value == 0:
        return "0"
    raised = str(round(np.log10(abs(value)))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{'−' if value < 0 else ''}10{raised}"


def _decades(largest: float) -> list[float]:
    top = np.floor(np.log10(largest))
    powers = [10.0 ** (top - n) for n in range(4) if 10.0 ** (top - n) >= largest * 1e-4]
    return [-p for p in powers] + [0.0] + powers[::-1]


def budget(title: str, names: Sequence[str], shares: FloatArray, causes: Sequence[str]) -> Draw:
    """Shares (quantities, causes) of the causes in the variance of each quantity."""

    def draw(canvas: SizedFigure) -> None:
        axes = canvas.axes(0.62, 0.62, 0.12, 0.28)
        down = np.arange(len(names))[::-1]
        before = np.zeros(len(names))
        for cause, colour, ink, share in zip(
            causes, (BLUE, ORANGE, GREEN, VERMILION), ("white", INK, "white", "white"), shares.T, strict=True
        ):
            axes.barh(down, 100 * share, left=100 * before, height=0.66, color=colour, label=cause)
            for y, start, part in zip(down, before, share, strict=True):
                if part >= 0.05:
                    axes.text(
                        100 * (start + part / 2), y, f"{100 * part:.0f}", ha="center", va="center",
                        fontsize=7, color=ink,
                    )  # fmt: skip
            before = before + share
        axes.set_yticks(down, names)
        axes.tick_params(axis="y", length=0)
        axes.set_xlim(0, 100)
        axes.set_xlabel("% of the variance, mean over the area", labelpad=2)
        axes.set_title(title)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        canvas.figure.legend(
            *axes.get_legend_handles_labels(), loc="lower center", ncols=len(causes), handlelength=1.0,
            columnspacing=1.2, borderaxespad=0.1,
        )  # fmt: skip

    return draw


def averaging(
    title: str, exposures: FloatArray, sigmas: Sequence[tuple[str, FloatArray]], usual: int, label: str
) -> Draw:
    """Effect of averaging: sigma over the number of exposures."""

    def draw(canvas: SizedFigure) -> None:
        axes = canvas.axes(0.5, 0.62, 0.12, 0.28)
        for (name, values), colour, line in zip(sigmas, (BLUE, VERMILION), ("-", "--"), strict=True):
            axes.plot(exposures, values, line, color=colour, linewidth=1.2, label=name)
        axes.axvline(usual, color=QUIET, linewidth=0.6, linestyle=":")
        axes.annotate(
            f"{usual}: the default", (usual, 0.06), (3, 0), xycoords=("data", "axes fraction"),
            textcoords="offset points", fontsize=6.5, color=QUIET,
        )  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(exposures[0], exposures[-1])
        axes.set_ylim(0, 1.1 * max(float(values.max()) for _, values in sigmas))
        axes.grid(axis="y")
        axes.set_xlabel("exposures averaged", labelpad=2)
        axes.set_ylabel(label, labelpad=2)
        axes.set_title(title)
        canvas.figure.legend(
            *axes.get_legend_handles_labels(),
            loc="lower center",
            ncols=2,
            handlelength=2.2,
            borderaxespad=0.1,
        )

    return draw
