"""One unit, calibrated once and measured under a row of conditions: for ``ambient`` and ``laser``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from hw_sim.measure import random_poses
from hw_sim.study.bench import bench, pooled_std, rms, truth_of
from hw_sim.study.plot import GREY, OURS, THESIS, panels
from hw_sim.study.result import Column, Progress, Row
from hw_sim.unit import Unit, UnitConfig

POSES, EXPOSURES = 16, 4

COLUMNS = (
    Column("x, y error rms, mm", 4),
    Column("yaw, pitch error rms, °", 5),
    Column("single x, y σ, mm", 4),
    Column("single yaw, pitch σ, °", 5),
    Column("rms of error/sigma", 2, judged=False),
    Column("invalid", 0, judged=False),
)

SPECIFIED = (1.0, 0.0573, None, None, None, None)
"""App. A.1: ±1 mm, and ±1 mm/m in yaw and pitch."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """One condition: its value on the axis, and the row of ``COLUMNS``."""

    value: float
    ours: tuple[float, ...]


def sweep(
    base: UnitConfig, conditions: Sequence[tuple[float, UnitConfig]], progress: Progress, what: str
) -> list[Point]:
    """Calibrate ``base`` and measure the same beams under every condition."""
    poses = random_poses(POSES, base.target_distance_mm, np.random.default_rng([base.seed, 41]))
    truth = truth_of(poses)
    points = []
    with bench(progress, what) as on:
        on.calibrate(Unit(base))
        for value, config in conditions:
            recording = on.record(Unit(config), poses, EXPOSURES)
            means = on.replay(recording, EXPOSURES, EXPOSURES)
            single = pooled_std(on.replay(recording, 1, 1).values.reshape(POSES, EXPOSURES, 4))
            errors = means.values - truth
            points.append(
                Point(
                    value,
                    (
                        rms(errors[:, :2]),
                        rms(errors[:, 2:]),
                        rms(single[:2]),
                        rms(single[2:]),
                        rms(errors / means.sigmas),
                        float(np.count_nonzero(~means.valid)),
                    ),
                )
            )
    return points


def rows(points: Sequence[Point], unit: str, specified: Sequence[float]) -> tuple[Row, ...]:
    """The table: the specification stands beside the conditions that it names."""
    return tuple(
        Row(f"{point.value:g} {unit}", point.ours, SPECIFIED if point.value in specified else None)
        for point in points
    )


def plot(points: Sequence[Point], label: str) -> Figure:
    """Error and scatter of displacement and angles against the condition."""
    figure, axes = panels(1, 2)
    at = [point.value for point in points]
    for axis, first, unit, what in ((axes[0], 0, "mm", "Displacement"), (axes[1], 1, "°", "Yaw and pitch")):
        axis.plot(
            at,
            [point.ours[first] for point in points],
            "o-",
            color=OURS,
            ms=4,
            lw=1.3,
            label=f"error, mean of {EXPOSURES}",
        )
        axis.plot(
            at,
            [point.ours[first + 2] for point in points],
            "s--",
            color=THESIS,
            ms=4,
            lw=1.1,
            label="scatter of single exposures",
        )
        axis.set(xlabel=label, ylabel=f"rms, {unit}", title=what)
        axis.set_ylim(bottom=0.0)
        axis.legend()
    axes[0].text(
        0.98, 0.03, "specified: ±1 mm", transform=axes[0].transAxes, ha="right", color=GREY, fontsize=8
    )
    axes[1].text(
        0.98, 0.03, "specified: ±0.0573°", transform=axes[1].transAxes, ha="right", color=GREY, fontsize=8
    )
    return figure
