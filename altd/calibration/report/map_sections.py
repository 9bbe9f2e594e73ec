"""How well the maps meet the nodes, which models were tried, and what is uncertain of the maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from altd.calibration.evidence import Candidate
from altd.calibration.model import TargetCalibration
from altd.calibration.report import map_plots, target_plots
from altd.calibration.report.document import Block, Heading, Picture, Row, Table
from altd.calibration.report.prediction import node_covariance_px2, offsets_mm, spectrum_covariance_px2
from altd.calibration.report.source import Source
from altd.calibration.report.target_plots import Plane, nice_length

_LONGEST_ARROW_MM = 20.0


def residuals(source: Source) -> list[Block]:
    """Residual vectors of all targets on one scale, and the numbers that sum them up."""
    plane = Plane([target.map.hull_mm for target in source.calibration.targets])
    offsets = [offsets_mm(target, seen.nodes_mm, seen.residuals_px) for target, seen in source.targets()]
    longest = max(float(np.linalg.norm(of_one, axis=1).max()) for of_one in offsets)
    scale = nice_length(_LONGEST_ARROW_MM / max(longest, 1e-9))
    pictures = []
    rows = []
    for (target, seen), of_one in zip(source.targets(), offsets, strict=True):
        left_out = [place for place, _ in seen.left_out]
        draw = target_plots.arrows(
            plane, target.name, seen.nodes_mm, of_one, target.map.hull_mm, left_out, scale
        )
        pictures.append(Picture(f"residual vectors of target {target.name}", plane.height_in(), draw))
        rows.append(
            (
                target.name,
                f"{len(seen.nodes_mm)}",
                f"{target.residual_mean_mm:.4f} / {target.residual_std_mm:.4f} / "
                f"{target.residual_max_mm:.4f}",
                f"{target.left_out_px:.3f}",
                f"{target.repeatability_px[0]:.3f} / {target.repeatability_px[1]:.3f}",
            )
        )
    caption = (
        f"Residual vectors: from where the stage was to where the map puts the spot, {scale:g} times "
        "enlarged (arrow: scale). Arrows that point anywhere are pattern and noise; arrows that run along "
        "each other over several nodes are an error of stage or lens that the map could not follow. "
        "Dashed: the area in which the map is valid. Crosses: nodes left out."
    )
    columns = (
        "target", "nodes", "residual mean / std / max, mm", "left out, px", "repeatability u / v, px"
    )  # fmt: skip
    return [
        Heading("How well the map meets the nodes"),
        Row(tuple(pictures), caption),
        Table(columns, tuple(rows), (0.12, 0.1, 0.36, 0.15, 0.27)),
    ]


def models(source: Source) -> list[Block]:
    """The candidates: error against degree."""
    values = [
        value
        for _, seen in source.targets()
        for c in seen.candidates
        for value in (c.left_out_px, c.gcv_px, c.map_sigma_px)
        if np.isfinite(value) and value > 0
    ]
    if not values:
        return []
    limits = min(values) / 1.4, max(values) * 1.6
    pictures: list[Picture] = []
    table: dict[tuple[str, str], list[str]] = {}
    for column, (target, seen) in enumerate(source.targets()):
        tried = sorted(seen.candidates, key=lambda c: (c.model != "tensor", c.parameters, c.degree or (0, 0)))
        chosen = _chosen(target, tried)
        draw = map_plots.candidates(target.name, tried, chosen, limits)
        pictures.append(Picture(f"error against degree, target {target.name}", map_plots.CANDIDATES_IN, draw))
        for number, c in enumerate(tried):
            of_target = table.setdefault((map_plots.name_of(c), str(c.parameters)), [])
            of_target += ["–"] * (column - len(of_target))
            numbers = f"{c.left_out_px:.4f} / {c.gcv_px:.4f} / {c.map_sigma_px:.4f}"
            of_target.append(f"{numbers}, chosen" if number == chosen else numbers)
    caption = (
        "The models that were tried. With the degree the misfit falls and what the nodes' noise leaves in "
        "the map grows; the map is the model that misses a node least which it was not shown. In the "
        "table, for each target: node left out / cross-validation / noise in the map, px."
    )
    names = source.calibration.target_names
    columns = ("model", "parameters", *names)
    rows = tuple((*of, *numbers, *["–"] * (len(names) - len(numbers))) for of, numbers in table.items())
    shares = (0.18, 0.12, *[0.7 / len(names)] * len(names))
    return [
        Heading("Which model, and why"),
        Row(tuple(pictures), caption),
        Table(columns, rows, shares),
    ]


def _chosen(target: TargetCalibration, tried: Sequence[Candidate]) -> int | None:
    """Which candidate became the map: of its model the one with the map's left-out error."""
    same = [n for n, c in enumerate(tried) if c.model == target.map.model]
    return min(same, key=lambda n: abs(tried[n].left_out_px - target.left_out_px), default=None)


def covariances(source: Source) -> list[Block]:
    """Covariance of the nodes and of the spectrum, as images."""
    of_nodes = [node_covariance_px2(target.map, seen.nodes_mm) for target, seen in source.targets()]
    of_spectra = [spectrum_covariance_px2(target.map) for target, _ in source.targets()]
    blocks: list[Block] = [Heading("What is uncertain of the map")]
    for matrices, symlog, axis, what, caption in (
        (
            of_nodes,
            False,
            "node",
            "nodes",
            "Covariance of the mapped nodes' u (Eq. 3.53, Fig. 3.19); the nodes are stacked column by "
            "column, from the lowest x and y. The diagonal holds the nodes' variances; the corners, which "
            "only few neighbours hold, are the most uncertain.",
        ),
        (
            of_spectra,
            True,
            "coefficient",
            "spectrum",
            "Covariance of the spectrum of u (Eq. 3.51), stacked row by row: coefficients of degree 0, 1, "
            "… in x for degree 0 in y, then for degree 1, and so on. For a tensor polynomial on a "
            "complete grid it is diagonal (Eq. 3.52); a lens model ties the coefficients together. The "
            "scale is logarithmic on both sides of zero.",
        ),
    ):
        largest = max(float(np.abs(matrix).max()) for matrix in matrices)
        pictures = tuple(
            Picture(
                f"covariance of the {what}, target {target.name}",
                map_plots.COVARIANCE_IN,
                map_plots.covariance(f"{target.name}: {what}", matrix, largest, symlog, axis),
            )
            for target, matrix in zip(source.calibration.targets, matrices, strict=True)
        )
        blocks.append(Row(pictures, caption))
    return blocks
