"""Mean or now: the lag and the noise of both outputs, at rest and in motion, without and with vibration."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from altd.calibration.file import load_calibration
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.records import FloatArray, Measurement
from hw_sim.beam import BeamPose
from hw_sim.motion import Drive, Vibration
from hw_sim.unit import CAMERAS, Unit, UnitConfig
from studies.bench import bench, rms
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result, Row

TITLE = "`[measuring] output`: mean and now, at rest and in motion"
QUESTION = "How large are lag and scatter of each output, and does its sigma hold?"

SEEDS = (71, 72, 73)
SPEEDS_MM_PER_S = (0.0, 1.0, 5.0)
PLACES = 4
EXPOSURES = 80
"""At each place: half of them until the unit knows how it moves, half are judged."""
_STEP_NS = 1_000_000
SETTINGS = {"mean": Measuring(), "now": Measuring(output="now")}


def measured(unit: Unit, calibration: Calibration, first_ns: int) -> Iterator[tuple[str, Measurement]]:
    """The results of both outputs on the same frames."""
    views = [View(camera, camera) for camera in CAMERAS]
    chains = {
        name: MeasuringChain(views, calibration, settings, BeamInstrument(calibration, settings))
        for name, settings in SETTINGS.items()
    }
    for number, camera in itertools.product(range(EXPOSURES), CAMERAS):
        frame = unit.expose(camera, number, first_ns + number * unit.config.period_ns)
        for name, chain in chains.items():
            for measurement in chain.push(frame):
                if measurement.valid and number >= EXPOSURES // 2:
                    yield name, measurement


def at_speed(
    seed: int, calibration: Calibration, speed_mm_per_s: float, vibration: Vibration | None
) -> Mapping[str, list[tuple[float, float, float, float]]]:
    """By output: x minus the truth at the newest exposure, the same at its own instant, sigma, all mm; mm/s.

    Sigma and speed are those of the newest exposure's instant.
    """
    rng = np.random.default_rng([seed, round(100 * speed_mm_per_s)])
    drive = Drive()
    if speed_mm_per_s:
        drive = replace(drive, period_s=2.0 * math.pi * drive.x_mm / speed_mm_per_s)
    unit = Unit(UnitConfig(seed=seed, vibration=vibration, drive=drive if speed_mm_per_s else None))
    found: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in SETTINGS}
    for _ in range(PLACES):
        x_mm, y_mm, slope_x, slope_y = rng.uniform(-1.0, 1.0, 4) * (25.0, 20.0, 0.05, 0.05)
        unit.place(BeamPose(x_mm, y_mm, slope_x, slope_y))
        first_ns = round(rng.uniform(0.0, drive.period_s) * 1e9)
        for name, measurement in measured(unit, calibration, first_ns):
            value = measurement.values["x_mm"].value
            age_s = (measurement.light_ns - measurement.t_ns) * 1e-9
            sigma = measurement.sigma_at("x_mm", age_s)
            found[name].append(
                (
                    value - unit.truth(measurement.light_ns).x_mm,
                    value - unit.truth(measurement.t_ns).x_mm,
                    math.nan if sigma is None else sigma,
                    _speed(unit, measurement.light_ns),
                )
            )
    return found


def _speed(unit: Unit, t_ns: int) -> float:
    before, after = (unit.truth(t_ns + since_ns).x_mm for since_ns in (-_STEP_NS, _STEP_NS))
    return (after - before) / (2e-9 * _STEP_NS)


def run(progress: Progress) -> Result:
    """Three units at each speed, without and with vibration."""
    found: dict[tuple[float, bool, str], list[tuple[float, float, float, float]]] = {}
    for seed in SEEDS:
        with bench(progress, "output-now") as on:
            on.calibrate(Unit(UnitConfig(seed=seed)))
            calibration = load_calibration(on.calibration_file)
        for speed, vibration in itertools.product(SPEEDS_MM_PER_S, (None, Vibration())):
            progress(f"output-now: unit {seed}, {speed:g} mm/s")
            for name, of_unit in at_speed(seed, calibration, speed, vibration).items():
                found.setdefault((speed, vibration is not None, name), []).extend(of_unit)
    arrays = {key: np.array(rows) for key, rows in found.items()}
    rows = [
        Row(_name(speed, vibrates, output), _numbers(arrays[speed, vibrates, output], speed, vibrates))
        for speed, vibrates, output in itertools.product(SPEEDS_MM_PER_S, (False, True), SETTINGS)
    ]
    mean, now = (rms(arrays[1.0, False, output][:, 0]) for output in SETTINGS)
    rest_mean, rest_now = (rms(arrays[0.0, True, output][:, 0]) for output in SETTINGS)
    return Result(
        of="motion, output",
        thesis_source="none; App. A.4 averages up to 20 frames a second",
        columns=(
            Column("error when new, mm", 4, judged=False),
            Column("lag, ms", 0, judged=False),
            Column("error at its own instant, mm", 4, judged=False),
            Column("sigma when new, mm", 4, judged=False),
            Column("error/sigma", 2, judged=False),
        ),
        rows=tuple(rows),
        headline=(
            f"At 1 mm/s a new mean is {mean:.2f} mm behind the beam, the output `now` is {now:.4f} mm off; "
            f"at rest under vibration they err by {rest_mean:.3f} and {rest_now:.3f} mm."
        ),
        text=(
            "x of three simulated units, from pictures; rms over all places. *When new* is at the newest "
            "exposure. The lag is the slope of error against speed. `now` scatters more: a straight line "
            "through 20 exposures scatters twice as much at its end as in its middle. Its sigma includes the "
            "vibration at that instant, as `sigma_now` of the mean does. In a motion each sigma also "
            "includes a lag of both cameras (rectangular, one frame interval wide), which these units do "
            "not have."
        ),
        figure=_figure(arrays),
        caption="Rms error of x when new: mean (orange) and now (blue)",
    )


def _name(speed: float, vibrates: bool, output: str) -> str:
    return f"{speed:g} mm/s{', vibration' * vibrates}: {output}"


def _numbers(found: FloatArray, speed: float, vibrates: bool) -> tuple[float | None, ...]:
    new, own, sigma, velocity = found.T
    lag_ms = None if vibrates or not speed else -1000 * float(new @ velocity / (velocity @ velocity))
    return rms(new), lag_ms, rms(own), rms(sigma), rms(new / sigma)


def _figure(arrays: Mapping[tuple[float, bool, str], FloatArray]) -> Figure:
    figure, axes = panels(1, 2)
    for axis, vibrates in zip(axes, (False, True), strict=True):
        for output, colour in (("mean", THESIS), ("now", OURS)):
            errors = [rms(arrays[speed, vibrates, output][:, 0]) for speed in SPEEDS_MM_PER_S]
            axis.plot(SPEEDS_MM_PER_S, errors, "o-", color=colour, label=output)
        axis.set_yscale("log")
        axis.set_xlabel("speed, mm/s")
        axis.set_ylabel("rms error of x when new, mm")
        axis.set_title("with vibration" if vibrates else "without vibration")
        axis.legend()
    return figure
