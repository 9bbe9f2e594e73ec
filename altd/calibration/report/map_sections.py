"""Sections on the fit of the maps to the nodes, the models tried, and the uncertainty of the maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from altd.calibration.report import map_plots, target_plots
from altd.calibration.report.document import Block, Heading, Picture, Row, Table
from altd.calibration.report.prediction import (
    MAX_STACKED,
    common_area,
    difference_mm,
    node_covariance_px2,
    noise_in_map_px,
    offsets_mm,
    own_noise_px,
    spectrum_covariance_px2,
)
from altd.calibration.report.target_plots import ShownArea, ValueGrid, nice_length
from altd.calibration.report.write import Source, target_names_text
from altd.calibration.result import Candidate, TargetEvidence
from altd.mapping.grid import contains
from altd.measuring.calibration import TargetCalibration

_MAX_ARROW_MM = 20.0
_MAX_DIFFERENCE_ARROW_MM = 15.0
_MIN_MM, _MIN_PX2 = 1e-4, 1e-12
"""Minimum scale; smaller values are drawn as if they had this size."""


def residuals(source: Source) -> list[Block]:
    """Section with residual vectors of all targets on one scale, and the numbers that summarise them."""
    plane = ShownArea([target.map.hull_mm for target in source.calibration.targets])
    offsets = [offsets_mm(target, seen.nodes_mm, seen.residuals_px) for target, seen in source.targets()]
    longest_mm = max(_MIN_MM, *(float(np.linalg.norm(of_one, axis=1).max()) for of_one in offsets))
    scale = nice_length(_MAX_ARROW_MM / longest_mm)
    pictures = []
    rows = []
    for (target, seen), of_one in zip(source.targets(), offsets, strict=True):
        draw = target_plots.arrows(plane, target, seen, of_one, scale)
        pictures.append(Picture(f"residual vectors of target {target.name}", plane.height_in(), draw))
        rows.append(
            (
                target.name,
                f"{len(seen.nodes_mm)}",
                f"{target.residual_mean_mm:.4f} / {target.residual_std_mm:.4f} / "
                f"{target.residual_max_mm:.4f}",
                f"{target.leave_one_out_px:.3f}",
                f"{target.repeatability_px[0]:.3f} / {target.repeatability_px[1]:.3f}",
            )
        )
    caption = (
        "Residual vectors, seen along the beam: from each node's known position to its mapped position, "
        f"{scale:g} times enlarged (arrow: scale). Arrows in random directions are pattern and noise; "
        "parallel arrows over several nodes are an error of stage or lens that the map cannot represent. "
        "Dashed: the area in which the map is valid. Crosses: nodes left out."
    )
    columns = (
        "target", "nodes", "residual mean / std / max, mm", "left out, px", "repeatability u / v, px"
    )  # fmt: skip
    return [
        Heading("Residuals of the map at the nodes"),
        Row(tuple(pictures), caption),
        Table(columns, tuple(rows), (0.12, 0.1, 0.36, 0.15, 0.27)),
    ]


def models(source: Source) -> list[Block]:
    """Section on the candidates: error against degree."""
    noises = [
        np.array([noise_in_map_px(c, len(seen.nodes_mm), _noise_px(target, seen)) for c in shown])
        for target, seen in source.targets()
        if (shown := _shown(seen.candidates))
    ]
    values = np.concatenate(
        [
            *noises,
            *(
                [c.leave_one_out_px, c.gcv_px]
                for _, seen in source.targets()
                for c in _shown(seen.candidates)
            ),
        ]
    )
    limits = float(np.nanmin(values)) / 1.4, float(np.nanmax(values)) * 1.8
    pictures = []
    for (target, seen), noise_px in zip(source.targets(), noises, strict=True):
        shown = _shown(seen.candidates)
        draw = map_plots.candidates(target.name, shown, noise_px, _chosen(target, shown), limits)
        pictures.append(Picture(f"error against degree, target {target.name}", map_plots.CANDIDATES_IN, draw))
    caption = (
        "The candidate models; of tensor polynomials with the same sum of degrees only the better one. With "
        "the degree the misfit decreases and the noise that the nodes leave in the map increases (computed "
        "with the noise of the chosen map). The chosen model has the smallest leave-one-out error. The table "
        "has all models: leave-one-out error / cross-validation / own noise left in the map, px."
    )
    return [Heading("Choice of the model"), Row(tuple(pictures), caption), _table_of_models(source)]


def _table_of_models(source: Source) -> Table:
    """All candidates, one line each, with the numbers of each target."""
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for target, seen in source.targets():
        tried = _in_order(seen.candidates)
        chosen = _chosen(target, tried)
        for number, c in enumerate(tried):
            numbers = f"{c.leave_one_out_px:.4f} / {c.gcv_px:.4f} / {c.map_sigma_px:.4f}"
            of_target = lines.setdefault((_full_name(c), str(c.parameters)), {})
            of_target[target.name] = f"{numbers}, chosen" if number == chosen else numbers
    names = source.calibration.target_names
    rows = tuple((*of, *(numbers.get(name, "–") for name in names)) for of, numbers in lines.items())
    return Table(("model", "parameters", *names), rows, (0.21, 0.13, *[0.66 / len(names)] * len(names)))


def _full_name(candidate: Candidate) -> str:
    name = map_plots.name_of(candidate)
    return f"tensor {name}" if candidate.model == "tensor" else name.replace("+", " + tensor")


def _in_order(tried: Sequence[Candidate]) -> list[Candidate]:
    """Sort tensor polynomials first, and each kind by the number of parameters."""
    return sorted(tried, key=lambda c: (c.model != "tensor", c.parameters, c.degree or (0, 0)))


def _shown(tried: Sequence[Candidate]) -> list[Candidate]:
    """Candidates to draw: the best tensor polynomial of each sum of degrees, and all other models."""
    best: dict[int, Candidate] = {}
    for candidate in tried:
        if candidate.model == "tensor" and candidate.degree is not None:
            total = sum(candidate.degree)
            rival = best.get(total)
            if rival is None or candidate.leave_one_out_px < rival.leave_one_out_px:
                best[total] = candidate
    others = [c for c in _in_order(tried) if c.model != "tensor"]
    return [best[total] for total in sorted(best)] + others


def _chosen(target: TargetCalibration, tried: Sequence[Candidate]) -> int | None:
    """Index of the candidate that became the map: of its model, the one with its leave-one-out rms."""
    same = [n for n, c in enumerate(tried) if c.model == target.map.model]
    return min(same, key=lambda n: abs(tried[n].leave_one_out_px - target.leave_one_out_px), default=None)


def _noise_px(target: TargetCalibration, seen: TargetEvidence) -> float:
    """Scatter of the nodes about the map, with stage and exposures, which the map's own noise excludes."""
    chosen = _chosen(target, seen.candidates)
    return (
        target.map.noise_px if chosen is None else own_noise_px(seen.candidates[chosen], len(seen.nodes_mm))
    )


def cross_checks(source: Source) -> list[Block]:
    """Section on the distance between the map and the second, independent one over the area."""
    targets = source.calibration.targets
    plane = ShownArea([target.map.hull_mm for target in targets], around_mm=3.0)
    x_mm, y_mm = common_area(targets)
    places_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1)
    apart = []
    for target in targets:
        off_mm = difference_mm(target, target.cross_check.map, places_mm.reshape(-1, 2))
        off_mm[~contains(target.map.hull_mm, places_mm.reshape(-1, 2))] = np.nan
        apart.append(off_mm.reshape(places_mm.shape))
    longest_mm = max(_MIN_MM, *(float(np.nanmax(np.linalg.norm(off_mm, axis=2))) for off_mm in apart))
    scale = nice_length(_MAX_DIFFERENCE_ARROW_MM / longest_mm)
    pictures, said = [], []
    for target, off_mm in zip(targets, apart, strict=True):
        other = target.cross_check
        over = ValueGrid(x_mm, y_mm, off_mm)
        draw = target_plots.differences(plane, target.name, over, longest_mm, scale)
        pictures.append(
            Picture(f"cross-check difference over target {target.name}", plane.height_in(bar=True), draw)
        )
        said.append(
            f"{target.name.capitalize()}: {other.map.name} against {target.map.name}, at most "
            f"{other.max_difference_px:.2f} px apart, limit {other.limit_px:.2f} px; leave-one-out error "
            f"{other.leave_one_out_px:.3f} px."
        )
    one_scale = f", {target_names_text(targets)} on one scale" if len(targets) > 1 else ""
    caption = (
        "Difference between the map and a second one of another kind: colour for length, arrows "
        f"{scale:g} times enlarged{one_scale}, seen along the beam. {' '.join(said)} A "
        "measurement at which the two differ by more than the limit is implausible and has no numbers."
    )
    return [Heading("Cross-check by a second map"), Row(tuple(pictures), caption)]


def covariances(source: Source) -> list[Block]:
    """Section with the covariances of the nodes and of the spectrum, as images."""
    of_nodes = [node_covariance_px2(target.map, seen.nodes_mm) for target, seen in source.targets()]
    of_spectra = [spectrum_covariance_px2(target.map) for target, _ in source.targets()]
    blocks: list[Block] = [Heading("Uncertainty of the map")]
    for matrices, symlog, axis, what, caption in (
        (
            of_nodes,
            False,
            "node",
            "nodes",
            "Covariance of the mapped nodes' u (Eq. 3.53, Fig. 3.19); the nodes are stacked column by "
            "column, from the lowest x and y. The diagonal has the nodes' variances; the corners, with few "
            "neighbours, are the most uncertain. Of more than "
            f"{MAX_STACKED} nodes every second, third … one is shown.",
        ),
        (
            of_spectra,
            True,
            "coefficient",
            "spectrum",
            "Covariance of the spectrum of u (Eq. 3.51), stacked row by row: coefficients of degree 0, 1, "
            "… in x for degree 0 in y, then for degree 1, and so on. For a tensor polynomial on a "
            "complete grid it is diagonal (Eq. 3.52); in a lens model the coefficients are correlated. The "
            "scale is logarithmic on both sides of zero.",
        ),
    ):
        largest = max(_MIN_PX2, *(float(np.abs(matrix).max()) for matrix in matrices))
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
