"""One unit, calibrated once and measured under a row of conditions: for ``ambient`` and ``laser``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from hw_sim.measure import random_poses
from hw_sim.unit import Unit, UnitConfig
from studies.bench import SIMULATORS, bench, pooled_std, rms, truth_of
from studies.plot import OURS, THIRD, panels
from studies.result import HARDER, Column, Progress, Row

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
    """A condition: its name in the table, its value on the axis, and the unit in it."""

    name: str
    value: float
    unit: Callable[[UnitConfig], Unit]


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


def sweep(
    base: UnitConfig, conditions: Sequence[Condition], progress: Progress, what: str
) -> tuple[list[Point], list[Point]]:
    """Calibrate the unit ``base`` and measure the same beams under every condition, on each simulator."""
    poses = random_poses(POSES, base.target_distance_mm, np.random.default_rng([base.seed, 41]))
    truth = truth_of(poses)
    points: dict[str, list[Point]] = {ending: [] for ending in SIMULATORS}
    for ending, hard in SIMULATORS.items():
        simulated = replace(base, hard=hard)
        with bench(progress, what + ending) as on:
            on.calibrate(Unit(simulated))
            for condition in conditions:
                recording = on.record(condition.unit(simulated), poses, EXPOSURES)
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
                points[ending].append(Point(condition.name + ending, condition.value, ours))
    return points[""], points[HARDER]


def rows(
    ordinary: Sequence[Point], harder: Sequence[Point], specified: Callable[[Point], bool]
) -> tuple[Row, ...]:
    """The table: the specification is beside the conditions that it names."""
    return tuple(
        Row(point.name, point.ours, SPECIFIED if specified(point) else None)
        for both in zip(ordinary, harder, strict=True)
        for point in both
    )


def refused_text(points: Sequence[Point]) -> str:
    """The beams that were not measured: their number and places."""
    bad = [f"{point.refused} of {POSES} beams at {point.name}" for point in points if point.refused]
    return f"refused: {'; '.join(bad)}" if bad else "no beam is refused"


def plot(series: Mapping[str, tuple[Sequence[Point], Sequence[Point]]], label: str) -> Figure:
    """Error and scatter of displacement and angles against the condition, a line for each series.

    The upper panels are of the ordinary simulator, the lower ones of the harder.
    """
    figure, axes = panels(2, 2)
    for axis, (at, ending, first, unit, what, limit) in zip(
        axes,
        (
            (at, ending, *of)
            for at, ending in enumerate(SIMULATORS)
            for of in ((0, "mm", "Displacement", "±1 mm"), (1, "°", "Yaw and pitch", "±0.0573°"))
        ),
        strict=True,
    ):
        for (name, points), colour in zip(series.items(), (OURS, THIRD), strict=False):
            for column, style, of in (
                (first, "o-", f"error, mean of {EXPOSURES}"),
                (first + 2, "s--", "scatter of single exposures"),
            ):
                values = [point.ours[column] for point in points[at]]
                places = [point.value for point in points[at]]
                axis.plot(places, values, style, color=colour, ms=4, lw=1.2, label=f"{of}{name}")
        axis.set(xlabel=label, ylabel=f"rms, {unit}", title=f"{what}{ending} (specified {limit})")
        axis.legend(loc="upper center", fontsize=7)
    for upper, lower in zip(axes[:2], axes[2:], strict=True):
        top = 1.35 * max(upper.get_ylim()[1], lower.get_ylim()[1])
        upper.set_ylim(0.0, top)
        lower.set_ylim(0.0, top)
    return figure
