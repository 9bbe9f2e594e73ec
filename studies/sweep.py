"""One unit, calibrated once and measured under a row of conditions: for ``ambient`` and ``laser``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from hw_sim.measure import random_poses
from hw_sim.unit import Unit, UnitConfig
from studies.bench import bench, pooled_std, rms, truth_of
from studies.plot import GREY, OURS, THIRD, panels
from studies.result import Column, Progress, Row

POSES, EXPOSURES = 16, 4

COLUMNS = (
    Column("x, y error rms, mm", 4),
    Column("yaw, pitch error rms, °", 5),
    Column("single x, y σ, mm", 4),
    Column("single yaw, pitch σ, °", 5),
    Column("rms of error/sigma", 2, judged=False),
    Column("invalid", 0),
)

SPECIFIED = (1.0, 0.0573, None, None, None, 0)
"""App. A.1: ±1 mm, ±1 mm/m in yaw and pitch; and what is specified is to be measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """A condition: its name in the table, its value on the axis, and the unit."""

    name: str
    value: float
    unit: Callable[[], Unit]


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A condition's name and value, and its result, a value for each of ``COLUMNS``."""

    name: str
    value: float
    ours: tuple[float, ...]

    @property
    def refused(self) -> int:
        """Beams without a valid measurement."""
        return round(self.ours[-1])


def sweep(base: UnitConfig, conditions: Sequence[Condition], progress: Progress, what: str) -> list[Point]:
    """Calibrate the unit ``base`` and measure the same beams under every condition."""
    poses = random_poses(POSES, base.target_distance_mm, np.random.default_rng([base.seed, 41]))
    truth = truth_of(poses)
    points = []
    with bench(progress, what) as on:
        on.calibrate(Unit(base))
        for condition in conditions:
            recording = on.record(condition.unit(), poses, EXPOSURES)
            means = on.replay(recording, EXPOSURES, EXPOSURES)
            single = pooled_std(on.replay(recording, 1, 1).values.reshape(POSES, EXPOSURES, 4))
            errors = means.values - truth
            ours = (
                rms(errors[:, :2]),
                rms(errors[:, 2:]),
                rms(single[:2]),
                rms(single[2:]),
                rms(errors / means.sigmas),
                float(np.count_nonzero(~means.valid)),
            )
            points.append(Point(condition.name, condition.value, ours))
    return points


def rows(points: Sequence[Point], specified: Callable[[Point], bool]) -> tuple[Row, ...]:
    """The table: the specification is beside the conditions that it names."""
    return tuple(Row(point.name, point.ours, SPECIFIED if specified(point) else None) for point in points)


def refused_text(points: Sequence[Point]) -> str:
    """The beams that were not measured: their number and places."""
    bad = [f"{point.refused} of {POSES} beams at {point.name}" for point in points if point.refused]
    return f"refused: {'; '.join(bad)}" if bad else "no beam is refused"


def plot(series: Mapping[str, Sequence[Point]], label: str) -> Figure:
    """Error and scatter of displacement and angles against the condition, a line for each series."""
    figure, axes = panels(1, 2)
    for axis, first, unit, what in ((axes[0], 0, "mm", "Displacement"), (axes[1], 1, "°", "Yaw and pitch")):
        for (name, points), colour in zip(series.items(), (OURS, THIRD), strict=False):
            at = [point.value for point in points]
            for column, style, of in (
                (first, "o-", f"error, mean of {EXPOSURES}"),
                (first + 2, "s--", "scatter of single exposures"),
            ):
                values = [point.ours[column] for point in points]
                axis.plot(at, values, style, color=colour, ms=4, lw=1.2, label=f"{of}{name}")
        axis.set(xlabel=label, ylabel=f"rms, {unit}", title=what)
        axis.set_ylim(0.0, 1.35 * axis.get_ylim()[1])
        axis.legend(loc="upper center", fontsize=7)
    for axis, limit in ((axes[0], "±1 mm"), (axes[1], "±0.0573°")):
        axis.text(
            0.98, 0.03, f"specified: {limit}", transform=axis.transAxes, ha="right", color=GREY, fontsize=8
        )
    return figure
