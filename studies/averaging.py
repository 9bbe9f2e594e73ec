"""Averaging: what one to a hundred frames make of a unit that vibrates."""

import numpy as np

from altd.records import FloatArray
from hw_sim.beam import BeamPose
from hw_sim.motion import Vibration
from hw_sim.unit import Unit, UnitConfig
from studies.bench import bench, rms, truth_of
from studies.plot import GREY, OURS, THESIS, panels, plain_decades
from studies.result import Column, Progress, Result, Row

TITLE = "Averaging: 1 to 100 frames under vibration"
QUESTION = "The thesis believes that the mean of up to 20 frames filters vibration. Does it?"

SEED = 71
POSE = BeamPose(12.0, -7.0, 0.03, -0.05)
EXPOSURES = 400
WINDOWS = (1, 2, 5, 10, 20, 50, 100)


def sliding_mean(values: FloatArray, window: int) -> FloatArray:
    """Means of ``window`` successive rows of (n, k), one for each place where they all exist."""
    total = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    return np.asarray((total[window:] - total[:-window]) / window)


def run(progress: Progress) -> Result:
    """One beam at rest, a unit that shakes, and every window length on the same frames."""
    vibration = Vibration()
    unit = Unit(UnitConfig(seed=SEED, vibration=vibration))
    still = Unit(UnitConfig(seed=SEED))
    with bench(progress, "averaging") as on:
        on.calibrate(still)
        recording = on.record(unit, [POSE], EXPOSURES)
        readings = {window: on.replay(recording, window, 1) for window in WINDOWS}
    unit.place(POSE)
    times_ns = [k * unit.config.period_ns for k in range(EXPOSURES)]
    moving = truth_of([unit.truth(t_ns) for t_ns in times_ns])
    rest = truth_of([POSE])

    rows, scatter, residual = [], [], []
    for window, lines in readings.items():
        values = lines.values[window - 1 :]
        scatter.append(np.nanstd(values, axis=0))
        residual.append(sliding_mean(moving, window).std(axis=0))
        errors = values - rest
        rows.append(
            Row(
                f"{window}",
                (
                    float(scatter[-1][0]),
                    float(residual[-1][0]),
                    rms(errors[:, 0]),
                    float(np.nanmean(lines.sigmas[window - 1 :, 0])),
                    float(scatter[-1][2]),
                    float(residual[-1][2]),
                    rms(errors[:, 2]),
                    float(np.nanmean(lines.sigmas[window - 1 :, 2])),
                    100.0 * float(np.mean(~lines.valid[window - 1 :])),
                ),
            )
        )

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
        differs="the vibration is an assumption, without blur within an exposure",
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
{unit.config.fps:g} a second are measured with sliding windows of each length.

*σ* is the scatter of altd's readings, *vibration left* that of the true mean position over the same
exposures. If both agree, altd adds nothing. *Error rms* is against the beam at rest and includes print
and speckle at this one place. *Stated sigma* should cover it, but a single exposure cannot detect
vibration. *Invalid* are windows in which altd found the beam unsteady. A line near a multiple of the frame
rate averages out slowly: the camera sees 24.6 Hz as 4.6 Hz. Blur within an exposure is not simulated.
""",
        figure=figure,
        caption="Scatter of the mean against the number of exposures, and how much of it is vibration",
    )
