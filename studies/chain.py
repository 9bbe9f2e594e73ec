"""A row of glass targets over 100 m: sigma by number of targets, and a drifting beam by stable targets."""

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from altd.app.row_replay import RowReplay
from altd.calibration.calibrating import calibrate
from altd.config import RowSettings
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from hw_sim.beam import BeamPose
from hw_sim.row.record import SETTLE_S, record_rounds, record_scans
from hw_sim.row.row import FPS, Row, RowConfig
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result
from studies.result import Row as Line

TITLE = "A row of glass targets over 100 m"
QUESTION = "How well does a row of switched targets measure displacements, and what does a drifting beam do?"

SEED = 81
LENGTH_MM = 100_000.0
EXPOSURES = 4
ROUNDS = 14
BASELINE = 4
STABLE = {0: (), 1: ("t1",), 2: ("t1", "t5"), 3: ("t1", "t3", "t5")}
COLUMNS = (
    Column("error, rms mm", judged=False),
    Column("sigma, rms mm", judged=False),
    Column("error/sigma", 2, judged=False),
    Column("round, s", 1, judged=False),
)


@dataclass(frozen=True, slots=True)
class _Case:
    name: str
    targets: int
    stable: tuple[str, ...]
    drifts: bool


def _cases() -> list[_Case]:
    counted = [
        _Case("2 targets, 1 stable, beam at rest", 2, ("t1",), False),
        _Case("5 targets, 2 stable, beam at rest", 5, ("t1", "t5"), False),
        _Case("10 targets, 2 stable, beam at rest", 10, ("t1", "t10"), False),
    ]
    drifting = [_Case(f"5 targets, {n} stable, beam drifts", 5, names, True) for n, names in STABLE.items()]
    return counted + drifting


def run(progress: Progress) -> Result:
    """Scans, rounds and replays of all cases."""
    calibrations: dict[int, Calibration] = {}
    lines, points = [], []
    for case in _cases():
        progress(case.name)
        if case.targets not in calibrations:
            calibrations[case.targets] = _calibration(_config(case))
        error_mm, sigma_mm = _measured(case, calibrations[case.targets])
        round_s = case.targets * (SETTLE_S + EXPOSURES / FPS)
        lines.append(Line(case.name, (error_mm, sigma_mm, error_mm / sigma_mm, round_s)))
        points.append((error_mm, sigma_mm))
    figure, (axis,) = panels(1, 1)
    places = np.arange(len(points))
    axis.bar(places - 0.2, [error for error, _ in points], 0.4, color=OURS, label="error, rms")
    axis.bar(places + 0.2, [sigma for _, sigma in points], 0.4, color=THESIS, label="stated sigma, rms")
    names = [line.name.replace(", beam", "\nbeam").replace(" targets, ", " t., ") for line in lines]
    axis.set_xticks(places, names, rotation=30, ha="right", fontsize=7)
    axis.set(yscale="log", ylabel="displacement, mm", title="Row over 100 m; drift 2 mm and 0.1 mrad")
    axis.legend()
    still, drifts = [line.ours[0] or 0.0 for line in lines[:3]], [line.ours[0] or 0.0 for line in lines[3:]]
    return Result(
        of="row",
        thesis_source="chapter 4, Figs. 4.2 and 4.3, proposes such a row and gives no figures",
        differs="the glasses are simulated, the air between them is not",
        columns=COLUMNS,
        rows=tuple(lines),
        headline=(
            f"With two stable targets and the beam at rest the error is {still[1]:.3f} mm (5 targets) and "
            f"{still[2]:.3f} mm (10). While the beam drifts by 2 mm and 0.1 mrad, with 0, 1, 2, 3 stable "
            f"targets of 5, it is {', '.join(f'{error:.3f}' for error in drifts)} mm."
        ),
        text=f"""
Simulated rows of seed {SEED}, targets at equal distances over {LENGTH_MM / 1000:g} m, each calibrated by its
own scan; {ROUNDS} rounds of {EXPOSURES} exposures a target, {BASELINE} of them the baseline. Errors are of
the targets that are not stable, of all rounds after the baseline. No place moves.

Sigma holds the scatter of the exposures, the texture of the glass, the map, the baseline and the stable
targets. A round takes {SETTLE_S:g} s of settling and {EXPOSURES} exposures at {FPS:g} a second for each
target.

With less than two stable targets the beam's angle is not known. Sigma then holds the movement that all
targets have in common, and the displacements are not significant. A third stable target shows that one of the
three has moved; it hardly reduces sigma.
""",
        figure=figure,
        caption="Error and stated sigma of the displacements",
    )


def _config(case: _Case) -> RowConfig:
    z_mm = tuple(np.linspace(0.0, LENGTH_MM, case.targets).tolist())
    round_s = case.targets * (SETTLE_S + EXPOSURES / FPS)

    def drift(t_s: float) -> BeamPose:
        share = 0.5 - 0.5 * math.cos(math.pi * min(t_s / (ROUNDS * round_s), 1.0))
        return BeamPose(2.0 * share, share, 1e-4 * share, 0.5e-4 * share)

    if case.drifts:
        return RowConfig(SEED, z_mm, drift)
    return RowConfig(SEED, z_mm)


def _calibration(config: RowConfig) -> Calibration:
    with TemporaryDirectory() as folder:
        scans = record_scans(Path(folder), Row(config))
        return calibrate([open_recording(path) for path in scans]).calibration


def _measured(case: _Case, calibration: Calibration) -> tuple[float, float]:
    """Rms of the errors and of the sigmas of the displacements, mm."""
    settings = RowSettings(stable=case.stable, baseline_rounds=BASELINE, exposures=EXPOSURES)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rounds"
        row = Row(_config(case))
        record_rounds(path, row, ROUNDS, EXPOSURES, own_only=True)
        names = {name: name for name in row.config.names}
        replay = RowReplay(open_recording(path), calibration, settings, names)
        objects = [replay.as_object(measurement) for measurement in replay.measurements()]
    monitored = [
        target
        for line in objects[BASELINE:]
        for name, target in line["targets"].items()
        if name not in case.stable
    ]
    errors = np.array([(target["dx_mm"], target["dy_mm"]) for target in monitored])
    sigmas = np.array([(target["sigma"]["dx_mm"], target["sigma"]["dy_mm"]) for target in monitored])
    return float(np.sqrt(np.mean(errors**2))), float(np.sqrt(np.mean(sigmas**2)))
