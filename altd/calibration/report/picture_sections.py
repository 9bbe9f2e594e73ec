"""Sections on the repeatability of the spots, and with the pictures of the cameras."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator

from altd.calibration.report.document import WIDTH_IN, Block, Heading, Picture, Row, Table, Words
from altd.calibration.report.target_plots import BLUE, INK, QUIET, VERMILION, Draw, SizedFigure, nice_length
from altd.calibration.report.write import Source
from altd.calibration.target_frames import FrameRow, TargetFrames
from altd.records import FloatArray, PixelArray

_MAX_WIDTH_PX = 480
"""Maximum width of a picture; more would make the page large without more detail for the reader."""


def scan_negatives(targets: Sequence[TargetFrames]) -> Mapping[str, PixelArray]:
    """Compute the maximum of a target's frames at each pixel, as a negative, (rows, columns) uint8.

    The result is by the targets' names. One exposure per node and the LED references with LEDs on count;
    large pictures are reduced. Raises BadInputError for a frame that cannot be decoded.
    """
    brightest = {frames.name: _brightest(frames) for frames in targets}
    return {name: _negative(pixels) for name, pixels in brightest.items() if pixels is not None}


def _brightest(frames: Iterable[FrameRow]) -> PixelArray | None:
    brightest: PixelArray | None = None
    taken: set[tuple[float, float]] = set()
    for frame_row in frames:
        position_mm = frame_row.row.position_mm
        if position_mm in taken or (position_mm is None and not frame_row.row.leds_on):
            continue
        if position_mm is not None:
            taken.add(position_mm)
        pixels = frame_row.frame().pixels
        brightest = pixels if brightest is None else np.maximum(brightest, pixels)
    return brightest


def _negative(pixels: PixelArray) -> PixelArray:
    """Turn light on dark into dark on light; the square root makes dim light visible."""
    width = min(_MAX_WIDTH_PX, pixels.shape[1])
    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    light = cv2.resize(pixels.astype(np.float64), (width, height), interpolation=cv2.INTER_AREA)
    dark, bright = float(np.median(light)), float(light.max())
    share = np.clip((light - dark) / max(bright - dark, 1.0), 0.0, 1.0)
    negative: PixelArray = np.rint(255 * (1 - np.sqrt(share))).astype(np.uint8)
    return negative


_LEFT_IN, _BOTTOM_IN, _RIGHT_IN, _TOP_IN = 0.48, 0.42, 0.1, 0.28

_HALO = [withStroke(linewidth=2.2, foreground="white")]
"""Outline that keeps marks legible where the picture is dark."""


def height_in(size_px: tuple[int, int]) -> float:
    """Height of a drawing ``WIDTH_IN`` wide that shows the picture with square pixels."""
    return (WIDTH_IN - _LEFT_IN - _RIGHT_IN) * size_px[1] / size_px[0] + _BOTTOM_IN + _TOP_IN


def _axes(canvas: SizedFigure, title: str, size_px: tuple[int, int]) -> Axes:
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
    """The scan in one picture, dark where there was light, with the nodes' spots and the frame LEDs."""

    def draw(canvas: SizedFigure) -> None:
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
    """Repeatability at each node: an ellipse of 1 sigma, enlarged ``scale`` times (Fig. 3.22)."""

    def draw(canvas: SizedFigure) -> None:
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


_MAX_ELLIPSE_SHARE = 0.05
"""Maximum semi-axis of an ellipse, as a share of the picture's width."""


def pictures(source: Source) -> list[Block]:
    """Sections on the scatter at the nodes, and on spots and LEDs in the picture."""
    seen_by, scatters = [], []
    widths = [target.width for target in source.calibration.targets]
    largest = max(_largest(seen.scatter_px) for _, seen in source.targets())
    scale = nice_length(_MAX_ELLIPSE_SHARE * min(widths) / largest) if largest > 0 else 1.0
    for target, seen in source.targets():
        size = target.width, target.height
        tall_in = height_in(size)
        draw = picture(target.name, size, source.negatives.get(target.name), seen.nodes_px, target.leds_px)
        seen_by.append(Picture(f"spots and LEDs in the picture of {target.name}", tall_in, draw))
        draw = scatter(target.name, size, seen.nodes_px, seen.scatter_px, seen.exposures, scale)
        scatters.append(Picture(f"repeatability at the nodes of {target.name}", tall_in, draw))
    targets = source.calibration.targets
    most = max(len(target.leds_px) for target in targets)
    leds = tuple(
        (f"LED {n + 1}", *(_led(target.leds_px[n]) if n < len(target.leds_px) else "–" for target in targets))
        for n in range(most)
    )
    blocks: list[Block] = [
        Heading("Repeatability of a spot"),
        Row(
            tuple(scatters),
            "Scatter of single exposures at each node in the camera's picture: ellipses of 1 sigma, "
            f"{scale:g} times enlarged, the same scale for all (Fig. 3.22). With two exposures per node "
            "a single ellipse is uncertain; all of them together show where spots are unsteady. "
            "Crosses: nodes with one exposure.",
        ),
        Heading("Pictures of the cameras"),
        Row(
            tuple(seen_by),
            "The whole scan in one picture, as a negative: dark where there was light. Crosses: the "
            "located nodes. Circles: the frame LEDs at their reference positions, numbered as in the table. "
            "A camera behind its target sees it mirrored. A spot without a cross is the beam while the LEDs "
            "were recorded, or a node left out.",
        ),
    ]
    if leds:
        columns = ("", *(f"{target.name}, u and v in px" for target in targets))
        blocks.append(Table(columns, leds, (0.16, *[0.84 / len(targets)] * len(targets))))
    dropped = [f"{target.name} {led}" for target, seen in source.targets() for led in seen.leds_dropped]
    if dropped:
        blocks.append(Words(f"Lit, but not located: {'; '.join(dropped)}."))
    return blocks


def _led(place_px: FloatArray) -> str:
    return f"{place_px[0]:.2f}, {place_px[1]:.2f}"


def _largest(scatter_px: FloatArray) -> float:
    known = scatter_px[np.isfinite(scatter_px)]
    return float(known.max()) if len(known) else 0.0
