"""Averaging: what one to a hundred frames make of a unit that vibrates."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from altd.records import FloatArray
from hw_sim.beam import BeamPose, Laser
from hw_sim.hardness import Hardness
from hw_sim.motion import Vibration
from hw_sim.unit import CAMERAS, EXPOSURES_MS, FRONT, Unit, UnitConfig
from studies.bench import Bench, Readings, bench, rms, truth_of
from studies.plot import GREY, OURS, THESIS, panels, plain_decades
from studies.result import Column, Progress, Result, Row

TITLE = "Averaging: 1 to 100 frames under vibration"
QUESTION = "The thesis believes that the mean of up to 20 frames filters vibration. Does it?"

SEED = 71
POSE = BeamPose(12.0, -7.0, 0.03, -0.05)
EXPOSURES = 400
WINDOWS = (1, 2, 5, 10, 20, 50, 100)
INSTANTS = 8
"""Of an exposure: its picture is their mean, so that it is blurred."""
LONG_MS, LONG_WINDOWS = 20.0, (1, 20)
"""Exposure of a laser that is as many times weaker, and windows that are measured with it."""


def sliding_mean(values: FloatArray, window: int) -> FloatArray:
    """Means of ``window`` successive rows of (n, k), one for each place where they all exist."""
    total = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    return np.asarray((total[window:] - total[:-window]) / window)


def run(progress: Progress) -> Result:
    """One beam at rest, a unit that shakes, and every window length on the same frames."""
    vibration = Vibration()
    usual_ms, usual_mw = EXPOSURES_MS[FRONT], Laser().power_mw
    shaken = UnitConfig(seed=SEED, vibration=vibration, hard=Hardness(instants=INSTANTS))
    weak_mw = usual_mw * usual_ms / LONG_MS
    dark = replace(shaken, laser=Laser(power_mw=weak_mw), lux=0.0)
    with bench(progress, "averaging") as on:
        on.calibrate(Unit(UnitConfig(seed=SEED)))
        readings, moving = _shaken(on, shaken, usual_ms, WINDOWS)
        blurred, moving_long = _shaken(on, dark, LONG_MS, LONG_WINDOWS)
    scatter = [_scatter(lines, window) for window, lines in readings.items()]
    residual = [sliding_mean(moving, window).std(axis=0) for window in WINDOWS]
    rows = [_row(f"{window}", lines, window, moving) for window, lines in readings.items()]
    rows += [
        _row(f"{window}, exposed for {LONG_MS:g} ms", lines, window, moving_long)
        for window, lines in blurred.items()
    ]

    figure, axes = panels(1, 2)
    for axis, column, unit_name, what in ((axes[0], 0, "mm", "x"), (axes[1], 2, "°", "yaw")):
        axis.loglog(
            WINDOWS,
            [s[column] for s in scatter],
            "o-",
            color=OURS,
            ms=4,
            lw=1.3,
            label="scatter of altd's means",
        )
        axis.loglog(
            WINDOWS, [s[column] for s in residual], color=THESIS, lw=1.3, label="vibration left in the mean"
        )
        white = residual[0][column] / np.sqrt(WINDOWS)
        axis.loglog(WINDOWS, white, color=GREY, lw=1.0, ls="--", label="σ/√N")
        axis.set_xticks(WINDOWS, [str(window) for window in WINDOWS])
        axis.minorticks_off()
        plain_decades(axis.yaxis)
        axis.set(xlabel="exposures averaged", ylabel=f"σ of {what}, {unit_name}", title=what)
        axis.legend()
    lines_hz = ", ".join(f"{at:g}" for at in vibration.lines_hz)
    at_20 = rows[WINDOWS.index(20)].ours
    return Result(
        of="frames",
        thesis_source="App. A.4 and ch. 5: up to 20 frames a second are averaged; not tested under vibration",
        differs="the vibration is an assumption",
        columns=tuple(
            Column(name, digits, judged=False)
            for name, digits in (
                ("x σ, mm", 4),
                ("vibration left, mm", 4),
                ("x error rms, mm", 4),
                ("stated sigma, mm", 4),
                ("yaw σ, °", 5),
                ("vibration left, °", 5),
                ("yaw error rms, °", 5),
                ("stated sigma, °", 5),
                ("invalid, %", 1),
            )
        ),
        rows=tuple(rows),
        headline=(
            f"Twenty frames, one second, cut a vibration of {vibration.rms_mm:g} mm and "
            f"{vibration.rms_mrad:g} mrad rms to {at_20[0]:.4f} mm and {at_20[4]:.5f}°."
        ),
        text=f"""
The beam is at rest and the unit vibrates with {vibration.rms_mm:g} mm rms in x and y and
{vibration.rms_mrad:g} mrad rms in yaw and pitch. {100 * (1 - vibration.random_share):.0f} % of the power
is in lines at {lines_hz} Hz, the rest is spread up to 80 Hz. {EXPOSURES} exposures at
{UnitConfig().fps:g} a second are measured with sliding windows of each length.

*σ* is the scatter of altd's readings, *vibration left* that of the true mean position over the same
exposures. If both agree, altd adds nothing. *Error rms* is against the beam at rest and includes print
and speckle at this one place. *Stated sigma* should cover it, but a single exposure cannot detect
vibration. *Invalid* are windows in which altd found the beam unsteady. A line near a multiple of the frame
rate averages out slowly: the camera sees 24.6 Hz as 4.6 Hz.

A picture is the mean of {INSTANTS} instants of its exposure of {usual_ms:g} ms, so that it is blurred. In the
last rows the laser has {weak_mw:g} mW instead of {usual_mw:g} mW and is exposed for {LONG_MS:g} ms, in the
dark: {shaken.lux:g} lx saturate such a picture. Blur averages the faster lines within each picture.
""",
        figure=figure,
        caption="Scatter of the mean against the number of exposures, and how much of it is vibration",
    )


def _shaken(
    on: Bench, config: UnitConfig, exposure_ms: float, windows: Sequence[int]
) -> tuple[dict[int, Readings], FloatArray]:
    """Readings by window, and the true mean beam (n, 4) of each exposure, of a unit that shakes."""
    unit = Unit(config)
    for camera in CAMERAS:
        unit.set_camera(camera, exposure_ms=exposure_ms)
    recording = on.record(unit, [POSE], EXPOSURES)
    readings = {window: on.replay(recording, window, 1) for window in windows}
    unit.place(POSE)
    within_ns = (np.arange(INSTANTS) + 0.5 - INSTANTS / 2) * (exposure_ms * 1e6 / INSTANTS)
    times_ns = unit.config.period_ns * np.arange(EXPOSURES)[:, None] + within_ns
    instants = truth_of([unit.truth(round(t_ns)) for t_ns in times_ns.ravel()])
    return readings, instants.reshape(EXPOSURES, INSTANTS, -1).mean(axis=1)


def _scatter(lines: Readings, window: int) -> FloatArray:
    return np.asarray(np.nanstd(lines.values[window - 1 :], axis=0))


def _row(name: str, lines: Readings, window: int, moving: FloatArray) -> Row:
    """Of x, then of yaw: scatter, vibration left, error, stated sigma; and the share of invalid windows."""
    scatter, residual = _scatter(lines, window), sliding_mean(moving, window).std(axis=0)
    errors, sigmas = lines.values[window - 1 :] - truth_of([POSE]), lines.sigmas[window - 1 :]
    values = [
        value
        for at in (0, 2)
        for value in (scatter[at], residual[at], rms(errors[:, at]), np.nanmean(sigmas[:, at]))
    ]
    refused = 100.0 * float(np.mean(~lines.valid[window - 1 :]))
    return Row(name, (*(float(value) for value in values), refused))
