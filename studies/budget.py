"""The uncertainty budget of a calibration, and its check by a Monte Carlo simulation (JCGM 101:2008)."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from altd.calibration.calibrating import calibrate
from altd.calibration.report.budget import Budget, beams_of, budget_of
from altd.calibration.result import CalibrationResult
from altd.instruments.beam.solver import fit_beam
from altd.mapping.tensor_map import tensor_basis
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.reader import open_recording
from altd.records import FloatArray, Limits, TargetPoint
from altd.records.limits import ALUMINIUM_PER_K
from hw_sim.scan import record_scan
from hw_sim.stage import Stage
from hw_sim.unit import Unit, UnitConfig
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Uncertainty budget: linear and Monte Carlo"
QUESTION = "What makes a measurement uncertain, and does the linear budget agree with a simulation?"

SEED = 301
DRAWS = 10_000
EXPOSURES = 20
STATED = Limits(0.005, 50.0, 0.05, 0.3, 0.05, 10.0)
"""Limits of an ordinary stage, mounting and place: the example of the recording's format, and 10 K."""
UNIT_A = Path(__file__).resolve().parents[2] / "shared" / "data" / "unit-a" / "scan"
"""A unit drawn by another renderer; beside the checkout, not in it."""
_AXES = ("x", "y", "yaw", "pitch")


def run(progress: Progress) -> Result:
    """Two units, each with the limits that are stated for an ordinary stage.

    Raises BadInputError without the scan of the second one.
    """
    rows: list[Row] = []
    ratios, budgets = [], {}
    for name, result in _calibrated(progress):
        progress(f"budget of {name}")
        calibration = replace(result.calibration, limits=STATED)
        budget = budget_of(calibration, result.evidence, EXPOSURES)
        errors = monte_carlo(calibration, DRAWS, np.random.default_rng([SEED, len(rows)]))
        scatter = np.sqrt(np.mean(np.square(errors), axis=0))
        rows += [Row(f"{name}: {term.name}", term.contributions) for term in budget.terms]
        rows.append(Row(f"{name}: **combined, linear**", budget.combined))
        rows.append(Row(f"{name}: **Monte Carlo**", tuple(scatter.tolist())))
        rows.append(Row(f"{name}: expanded, 95 %", budget.expanded))
        within = np.mean(np.abs(errors) <= np.array(budget.expanded), axis=0)
        rows.append(Row(f"{name}: share of draws within", tuple(within.tolist())))
        ratios.append(scatter / np.array(budget.combined))
        budgets[name] = budget
    worst = float(np.abs(np.array(ratios) - 1).max())
    return Result(
        of="contribution",
        thesis_source="none: the thesis states no budget",
        columns=tuple(
            Column(f"{axis} {unit}", judged=False)
            for axis, unit in zip(_AXES, ("mm", "mm", "°", "°"), strict=True)
        ),
        rows=tuple(rows),
        headline=f"Linear budget and Monte Carlo agree within {100 * worst:.1f} %.",
        text=f"""
Each row is the root mean square over beams that are even over the first target and the stated range of
yaw and pitch. Stage and mounting are stated with {STATED.stage_scale_ppm:g} ppm,
{STATED.stage_square_mrad:g} mrad, {STATED.beam_normal_mm_per_m:g} mm/m,
{STATED.target_distance_mm:g} mm and {STATED.temperature_k:g} K. A measurement has {EXPOSURES} exposures.

The simulation draws {DRAWS} times all inputs at once: scale and angle of the stage, the calibrating beam's
direction, the distance of the rear target, the effects of heat on it and on the pictures, the error of the
maps, print and speckle, and single exposures. It sends the drawn beam through the drawn unit, and measures it
by the maps as they are in the calibration. The maps themselves, and what they state of their error, come from
the calibration; so the simulation checks how the terms are added, not their size.
""",
        figure=_figure(budgets),
        caption="Contributions to yaw",
    )


def _calibrated(progress: Progress) -> list[tuple[str, CalibrationResult]]:
    rendered = open_recording(UNIT_A)  # first, since it may not be there
    progress("scan of a simulated unit")
    with tempfile.TemporaryDirectory() as folder:
        unit, scan = Unit(UnitConfig(seed=SEED)), Path(folder) / "scan"
        record_scan(scan, unit, Stage(np.random.default_rng(SEED)), 2, lambda done, planned: None)
        made = [("simulated", calibrate([open_recording(scan)]))]
    progress("scan of the rendered unit")
    return [*made, ("rendered", calibrate([rendered]))]


def monte_carlo(calibration: Calibration, draws: int, rng: np.random.Generator) -> FloatArray:
    """Errors (draws, 4) of x, y, yaw and pitch of measured beams, all inputs drawn (JCGM 101, 7).

    A stage that is wrong by the drawn errors put the beam elsewhere than the maps' labels state. The beam
    meets a target at its true place, whose label follows. The drawn map, pattern and exposures make the
    pixel, and the calibration's own inverse and line make the measurement.
    """
    beams, limits, targets = beams_of(calibration), calibration.limits, calibration.targets
    z_mm = [target.z_mm for target in targets]
    errors = np.empty((draws, 4))
    for draw in range(draws):
        beam = beams[rng.integers(len(beams))]
        start = np.array([beam[0].x_mm, beam[0].y_mm])
        slopes = (np.array([beam[-1].x_mm, beam[-1].y_mm]) - start) / (z_mm[-1] - z_mm[0])
        scale_x, scale_y = 1 + rng.normal(0, (limits.stage_scale_ppm or 0) * 1e-6, 2)
        square_x, square_y = rng.normal(0, (limits.stage_square_mrad or 0) * 1e-3, 2)
        stage = np.array([[scale_x, square_x], [square_y, scale_y]])
        tilt = rng.normal(0, (limits.beam_normal_mm_per_m or 0) * 1e-3, 2)
        # heat moves the cameras and the targets, each on its own (docs/budget.md, Temperature)
        farther, smaller = 1 + rng.normal(0, (limits.temperature_k or 0) * ALUMINIUM_PER_K, 2)
        points = []
        for number, target in enumerate(targets):
            true_z_mm = target.z_mm + (rng.normal(0, limits.target_distance_mm or 0) if number else 0.0)
            met_mm = start + slopes * (true_z_mm * farther - z_mm[0])
            label_mm = np.linalg.solve(stage, met_mm - tilt * true_z_mm) / smaller
            points.append(_measured(target, label_mm, rng))
        measured = fit_beam(z_mm, points, np.eye(2 * len(points)))
        truth = [start[0], start[1], *(math.degrees(math.atan(slope)) for slope in slopes)]
        errors[draw] = np.subtract(
            [measured.x_mm, measured.y_mm, measured.yaw_deg, measured.pitch_deg], truth
        )
    return errors[np.isfinite(errors).all(axis=1)]


def _measured(target: TargetCalibration, label_mm: FloatArray, rng: np.random.Generator) -> TargetPoint:
    """The point that the calibration makes of a spot at a label, with a drawn error of the map."""
    of_map = target.map
    drawn = of_map.covariance_factor_px @ rng.normal(size=of_map.covariance_factor_px.shape[2])
    basis = tensor_basis((of_map.x_axis, of_map.y_axis), of_map.degree, label_mm[None])[0]
    pattern_px = rng.multivariate_normal((0.0, 0.0), of_map.noise_covariance_px2)
    spot_px = of_map.to_px(label_mm[None])[0] + drawn @ basis + pattern_px
    spot_px += rng.normal(0, target.repeatability_px / math.sqrt(EXPOSURES))
    (point,), (jacobian,), (covariance,) = target.inverse.to_mm(spot_px[None])
    return TargetPoint(float(point[0]), float(point[1]), jacobian, covariance)


def _figure(budgets: dict[str, Budget]) -> Figure:
    figure, axes = panels(1, len(budgets), width=5.6 * len(budgets))
    for axis, (name, budget) in zip(axes, budgets.items(), strict=True):
        yaw = budget.quantities.index("yaw_deg")
        values = [*(term.contributions[yaw] for term in budget.terms), budget.combined[yaw]]
        names: Sequence[str] = [*(term.name for term in budget.terms), "combined"]
        colours = [OURS] * len(budget.terms) + [THESIS]
        axis.barh(range(len(values))[::-1], values, color=colours)
        axis.set_yticks(range(len(values))[::-1], names)
        axis.locator_params("x", nbins=4)
        axis.set_xlabel("yaw, °")
        axis.set_title(name)
    return figure
