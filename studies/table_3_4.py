"""Table 3.4 and Fig. 3.26–3.29: seventy beams, and whether their errors are correlated."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from altd.records import FloatArray
from hw_sim.beam import BeamPose
from hw_sim.measure import random_poses
from hw_sim.unit import Unit, UnitConfig
from studies.bench import SIMULATORS, bench, pooled_std, rms, truth_of
from studies.plot import GREY, OURS, THESIS, draw_arrows, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Table 3.4: seventy beams"
QUESTION = (
    "How accurate and how repeatable are yaw and pitch of the whole unit, and are their errors independent?"
)

UNITS = ((71, 0.0, False), (72, 0.12, False), (73, 0.2, False), (72, 0.12, True))
"""Seeds, contrast of their speckle, and whether with a flat field; the last is the second again."""
SHOWN = 1
POSES, EXPOSURES = 70, 4
THESIS_ROWS = {"yaw": (0.00113, 0.0226), "pitch": (0.00084, 0.0183)}
CHANCE_CORRELATION_Z = 1.96 / math.sqrt(POSES - 3)
"""In Fisher's z: independent errors correlate by less than its tanh 95 times in 100."""


@dataclass(frozen=True, slots=True, eq=False)
class _UnitErrors:
    """One unit: truth, errors and stated sigmas (70, 4), repeats' σ (4,); x mm, y mm, yaw °, pitch °."""

    poses: list[BeamPose]
    truth: FloatArray
    errors: FloatArray
    sigmas: FloatArray
    repeats: FloatArray
    single: FloatArray
    """Single exposures less their mean, (70, exposures, 4)."""


def principal_components(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """σ along the principal axes of (n, 2) errors, largest first, and the axes as rows."""
    variances, axes = np.linalg.eigh(np.cov(errors, rowvar=False))
    return np.sqrt(variances[::-1]), axes.T[::-1]


def run(progress: Progress) -> Result:
    """Three units with more and more speckle, on each simulator; the plots show the second."""
    units = {ending: [_measure_unit(*unit, ending, progress) for unit in UNITS] for ending in SIMULATORS}
    rows = [
        Row(
            f"{angle}, {_label(contrast, flat)}{ending}",
            _row(units[ending][at], column),
            (*THESIS_ROWS[angle], None, None, None, None),
        )
        for at, (_, contrast, flat) in enumerate(UNITS)
        for angle, column in (("yaw", 2), ("pitch", 3))
        for ending in SIMULATORS
    ]
    shown = units[""][SHOWN]
    sigmas_deg, axes = principal_components(shown.errors[:, 2:])
    turn_deg = math.degrees(math.atan2(axes[0, 1], axes[0, 0])) % 180.0
    between = float(np.corrcoef(shown.errors[:, 2], shown.errors[:, 3])[0, 1])
    placed = "; ".join(
        f"{rms(unit.errors[:, 0]):.4f} and {rms(unit.errors[:, 1]):.4f} mm at "
        f"{_label(contrast, flat)}{ending}"
        for ending, measured in units.items()
        for (_, contrast, flat), unit in zip(UNITS, measured, strict=True)
    )
    figure = _figure(shown, sigmas_deg, turn_deg)
    worst = " and ".join(
        f"{max(unit.errors[:, 2:].std(axis=0, ddof=1).max() for unit in measured[:-1]):.4f}°"
        for measured in units.values()
    )
    return Result(
        of="angle",
        thesis_source=(
            "Sec. 3.6, Table 3.4, Fig. 3.26–3.29 (70 beams, each with its own yaw and pitch, over the "
            "whole window)"
        ),
        differs="the true angles are those of the simulator; rows with a flat field are added",
        columns=(
            Column("reproducibility σ, °", 5),
            Column("accuracy σ, °", 5),
            Column("mean error, °", 5, judged=False),
            Column("rms of error/sigma", 2, judged=False),
            Column("correlation with yaw", 2, judged=False),
            Column("with pitch", 2, judged=False),
        ),
        rows=tuple(rows),
        headline=(
            f"Seventy beams: yaw and pitch to {worst} or better on three units without a flat field, of the "
            "ordinary and the harder simulator (thesis 0.0226° and 0.0183°)."
        ),
        text=f"""
Three simulated units differ in their seed and in the contrast of their speckle. Each is scanned (6 × 5
nodes, two exposures) and calibrated. Then {POSES} beams enter anywhere on the window, {EXPOSURES} exposures
each. Yaw and pitch take any value that keeps both spots on the scanned area. *Accuracy* is the standard
deviation of the errors of means of {EXPOSURES}, *reproducibility* that of single exposures of the same
beam. The thesis does not state how many frames it averaged. *rms of error/sigma* is 1 if the stated
uncertainty is right.

The *flat* rows are the second unit with a flat field; the thesis had none. On the ordinary simulator they
are optimistic: even light shows all of the simulated surface texture. A lamp cannot show the laser's own
speckle, which the *hard* rows have in addition, with a contrast of 0.12.

Displacement of the same beams, rms of x and y: {placed}.

The thesis tests by principal components whether the errors depend on each other and on the angles, and
finds a minor correlation. For the ordinary unit with speckle {UNITS[SHOWN][1]:g} (plots) the principal axes
have σ {sigmas_deg[0]:.5f}° and {sigmas_deg[1]:.5f}°, the first at {turn_deg:.0f}° from yaw. Yaw and pitch
errors correlate with {between:+.2f}. Of independent errors, 70 show less than
{math.tanh(CHANCE_CORRELATION_Z):.2f} by chance in 95 of 100 cases.
""",
        figure=figure,
        caption=(
            "Fig. 3.26–3.29 again: errors over the window, their distribution, against yaw and "
            "pitch, and their principal axes"
        ),
    )


def _row(unit: _UnitErrors, column: int) -> tuple[float, ...]:
    error = unit.errors[:, column]
    return (
        float(unit.repeats[column]),
        float(error.std(ddof=1)),
        float(error.mean()),
        rms(error / unit.sigmas[:, column]),
        float(np.corrcoef(error, unit.truth[:, 2])[0, 1]),
        float(np.corrcoef(error, unit.truth[:, 3])[0, 1]),
    )


def _label(contrast: float, flat: bool) -> str:
    return f"speckle {contrast:g}{', flat' if flat else ''}"


def _measure_unit(seed: int, contrast: float, flat: bool, ending: str, progress: Progress) -> _UnitErrors:
    unit = Unit(UnitConfig(seed=seed, speckle_contrast=contrast, hard=SIMULATORS[ending]))
    poses = random_poses(POSES, unit.config.target_distance_mm, np.random.default_rng([seed, 34]))
    with bench(progress, f"table-3.4, {_label(contrast, flat)}{ending}") as on:
        on.calibrate(unit, flat=flat)
        recording = on.record(unit, poses, EXPOSURES)
        means = on.replay(recording, EXPOSURES, EXPOSURES)
        single = on.replay(recording, 1, 1).values.reshape(POSES, EXPOSURES, 4)
    return _UnitErrors(
        poses,
        truth_of(poses),
        means.values - truth_of(poses),
        means.sigmas,
        pooled_std(single),
        single - single.mean(axis=1, keepdims=True),
    )


def _figure(unit: _UnitErrors, sigmas_deg: FloatArray, turn_deg: float) -> Figure:
    """In thousandths of a degree, for short labels."""
    figure, axes = panels(2, 3, width=12.6, height=7.2)
    errors, single = 1000.0 * unit.errors, 1000.0 * unit.single.reshape(-1, 4)
    limit = 1.3 * float(np.abs(errors[:, 2:]).max())
    at_mm = np.array([(pose.x_mm, pose.y_mm) for pose in unit.poses])
    draw_arrows(axes[0], at_mm, errors[:, 2:], "°", divisor=1000.0)
    axes[0].set(xlabel="x on the window, mm", ylabel="y, mm", xlim=(-72, 72), ylim=(-58, 58), aspect="equal")
    axes[0].set_title("Errors (yaw, pitch), Fig. 3.26", loc="left")
    edges = np.linspace(-limit, limit, 31).tolist()
    for axis, values, of, title in (
        (axes[1], errors, "error", "Accuracy"),
        (axes[2], single, "single exposure less mean", "Reproducibility"),
    ):
        for column, angle, colour in ((2, "yaw", OURS), (3, "pitch", THESIS)):
            label = f"{angle}, σ {values[:, column].std(ddof=1) / 1000:.5f}°"
            axis.hist(values[:, column], bins=edges, histtype="step", lw=1.5, color=colour, label=label)
        axis.set(xlabel=f"{of}, 0.001°", ylabel="readings", title=f"{title}, Fig. 3.27")
        axis.set_ylim(top=1.3 * axis.get_ylim()[1])
        axis.legend(loc="upper left")
    for axis, column, title in (
        (axes[3], 2, "Error of yaw, Fig. 3.28"),
        (axes[4], 3, "Error of pitch, Fig. 3.29"),
    ):
        _against_angles(axis, unit.truth, errors[:, column])
        axis.set(ylim=(-limit, limit), title=title)
    _principal(axes[5], errors[:, 2:], 1000.0 * sigmas_deg, turn_deg)
    axes[5].set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    return figure


def _against_angles(axis: Axes, truth: FloatArray, error: FloatArray) -> None:
    for of, angle, colour, mark in ((2, "yaw", OURS, "o"), (3, "pitch", THESIS, "^")):
        at = truth[:, of]
        axis.plot(at, error, mark, ms=3.2, color=colour, label=f"over {angle}, with its line")
        slope, offset = np.polyfit(at, error, 1)
        ends = np.array([at.min(), at.max()])
        axis.plot(ends, offset + slope * ends, color=colour, lw=1.3)
    axis.axhline(0.0, color=GREY, lw=0.8)
    axis.set(xlabel="angle of the beam, °", ylabel="error, 0.001°")
    axis.legend(loc="upper left", ncols=2)


def _principal(axis: Axes, errors: FloatArray, sigmas_deg: FloatArray, turn_deg: float) -> None:
    middle = errors.mean(axis=0)
    axis.plot(*errors.T, "o", ms=3.2, color=OURS)
    for times in (1.0, 2.0):
        size = 2.0 * times * sigmas_deg
        axis.add_patch(
            Ellipse(tuple(middle), *size, angle=turn_deg, fill=False, color=THESIS, lw=1.2),
        )
    axis.set(xlabel="error of yaw, 0.001°", ylabel="error of pitch, 0.001°")
    axis.set_title("Principal axes, 1 and 2 σ", loc="left")
