"""`sigma_now`: whether a value that is read late still says how good it is, of a machine that moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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
from studies.bench import QUANTITIES, bench, rms, truth_of
from studies.hard_motion import HARD, Path, start
from studies.plot import FOURTH, GREY, OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "`sigma_now`: a machine at 0 to 5 mm/s, read late"
QUESTION = "Does the sigma of a value hold for the moment at which a controller reads it?"

SEEDS = (71, 72, 73)
SPEEDS_MM_PER_S = (0.0, 0.1, 0.5, 1.0, 2.0, 5.0)
LATE_S = (0.0, 0.25, 0.5, 0.75, 1.0)
PLACES = 10
"""Of each unit at each speed."""
EXPOSURES = 60
"""At each place: half of them until the unit knows how it moves, half are judged."""
WITHIN = (0.8, 1.25)


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of valid measurements: (n, len(LATE_S), 4), NaN where sigma is not known.

    ``stated`` (n, 4) is the sigma of the measurements themselves, ``light_ns`` (n,) their newest exposures.
    """

    errors: FloatArray
    sigmas: FloatArray
    stated: FloatArray
    light_ns: FloatArray

    def ratio(self, late: int) -> list[float]:
        """Rms of error/sigma of each quantity, read as late."""
        return [rms(self.errors[:, late, k] / self.sigmas[:, late, k]) for k in range(len(QUANTITIES))]

    def between(self, first_ns: float, end_ns: float) -> Readings:
        """Those whose newest exposure fell then."""
        then = (self.light_ns >= first_ns) & (self.light_ns < end_ns)
        return Readings(self.errors[then], self.sigmas[then], self.stated[then], self.light_ns[then])


def measure(
    unit: Unit, calibration: Calibration, numbers: Sequence[int], first_ns: int = 0
) -> Iterator[Measurement]:
    """All measurements of the unit's exposures with these numbers, valid or not."""
    settings = Measuring()
    views = [View(camera, camera) for camera in CAMERAS]
    chain = MeasuringChain(views, calibration, settings, BeamInstrument(calibration, settings))
    for number in numbers:
        for camera in CAMERAS:
            yield from chain.push(unit.expose(camera, number, first_ns + number * unit.config.period_ns))


def read_late(unit: Unit, measurements: Sequence[Measurement]) -> Readings:
    """Errors against the truth of the moments at which each is read, and sigma of those moments."""
    errors, sigmas = [], []
    for measurement in measurements:
        moments_ns = [measurement.light_ns + round(late_s * 1e9) for late_s in LATE_S]
        values = [measurement.values[key].value for key in QUANTITIES]
        errors.append(values - truth_of([unit.truth(t_ns) for t_ns in moments_ns]))
        ages_s = [(t_ns - measurement.t_ns) * 1e-9 for t_ns in moments_ns]
        sigmas.append([[measurement.sigma_at(key, age_s) for key in QUANTITIES] for age_s in ages_s])
    return Readings(
        np.array(errors).reshape(-1, len(LATE_S), len(QUANTITIES)),
        np.array(sigmas, dtype=np.float64).reshape(-1, len(LATE_S), len(QUANTITIES)),
        np.array([[m.sigma(key) for key in QUANTITIES] for m in measurements], dtype=np.float64),
        np.array([m.light_ns for m in measurements], dtype=np.float64),
    )


def joined(parts: Sequence[Readings]) -> Readings:
    """All of them."""
    return Readings(
        np.concatenate([part.errors for part in parts]),
        np.concatenate([part.sigmas for part in parts]),
        np.concatenate([part.stated for part in parts]),
        np.concatenate([part.light_ns for part in parts]),
    )


def at_speed(
    seed: int, calibration: Calibration, speed_mm_per_s: float, vibration: Vibration | None
) -> Readings:
    """A unit on stretches of its machine's path, where x moves with this speed at most."""
    rng = np.random.default_rng([seed, round(100 * speed_mm_per_s)])
    drive = Drive()
    if speed_mm_per_s:
        drive = replace(drive, period_s=2.0 * math.pi * drive.x_mm / speed_mm_per_s)
    unit = Unit(UnitConfig(seed=seed, vibration=vibration, drive=drive if speed_mm_per_s else None))
    parts = []
    for _ in range(PLACES):
        x_mm, y_mm, slope_x, slope_y = rng.uniform(-1.0, 1.0, 4) * (25.0, 20.0, 0.05, 0.05)
        unit.place(BeamPose(x_mm, y_mm, slope_x, slope_y))
        first_ns = round(rng.uniform(0.0, drive.period_s) * 1e9)
        known = [m for m in measure(unit, calibration, range(EXPOSURES), first_ns) if m.valid]
        parts.append(read_late(unit, [m for m in known if m.sequence >= EXPOSURES // 2]))
    return joined(parts)


HARD_EXPOSURES = 700
HARD_FROM = 240
"""After what happens for the first time has been seen: steps of 5 s take 10."""
SHOWN_LATE = HARD_LATE = (0, 2, 4)
STARTS, START_S = 16, 3.0
AFTER_START_S = (0.0, 0.05, 0.1, 0.2, 1.0)
AFTER_START_LATE = 2


def on_path(calibration: Calibration, path: Path, lost: int, vibration: Vibration | None) -> Readings:
    """A unit on one of the hard paths."""
    unit = Unit(UnitConfig(seed=SEEDS[0], vibration=vibration))
    unit.follow(path)
    numbers = [number for number in range(HARD_EXPOSURES) if lost == 1 or number % lost]
    measured = list(measure(unit, calibration, numbers))
    return read_late(unit, [m for m in measured if m.valid and m.sequence >= HARD_FROM])


def after_first_starts(calibration: Calibration, vibration: Vibration | None) -> list[Readings]:
    """Valid measurements of a machine that starts for the first time, by the time since then."""
    rng = np.random.default_rng(SEEDS[0])
    spans_s = list(itertools.pairwise(AFTER_START_S))
    parts: list[list[Readings]] = [[] for _ in spans_s]
    for _ in range(STARTS):
        unit = Unit(UnitConfig(seed=SEEDS[0], vibration=vibration))
        start_s = START_S + float(rng.uniform(0.0, 0.05))
        unit.follow(start(start_s, 5.0))
        measured = list(measure(unit, calibration, range(round(20 * (START_S + 1.0)))))
        readings = read_late(unit, [m for m in measured if m.valid])
        for part, (first_s, end_s) in zip(parts, spans_s, strict=True):
            part.append(readings.between((start_s + first_s) * 1e9, (start_s + end_s) * 1e9))
    return [joined(part) for part in parts]


def run(progress: Progress) -> Result:
    """Three units at every speed, with and without vibration; then hard motion."""
    vibrations = (None, Vibration())
    at: dict[tuple[float, int], list[Readings]] = {}
    hard: dict[str, list[Readings]] = {}
    for seed in SEEDS:
        with bench(progress, "sigma-now") as on:
            on.calibrate(Unit(UnitConfig(seed=seed)))
            calibration = load_calibration(on.calibration_file)
        for speed, (kind, vibration) in itertools.product(SPEEDS_MM_PER_S, enumerate(vibrations)):
            progress(f"sigma-now: unit {seed}, {speed:g} mm/s")
            at.setdefault((speed, kind), []).append(at_speed(seed, calibration, speed, vibration))
        if seed == SEEDS[0]:
            for name, path, lost in HARD:
                progress(f"sigma-now: {name}")
                hard[name] = [on_path(calibration, path, lost, vibration) for vibration in vibrations]
            progress("sigma-now: first starts")
            starts = [after_first_starts(calibration, vibration) for vibration in vibrations]
    driven = {
        f"{speed:g} mm/s": [joined(at[speed, kind]) for kind in range(len(vibrations))]
        for speed in SPEEDS_MM_PER_S
    }
    rows = [_row(name, late, of) for name, of in driven.items() for late in range(len(LATE_S))]
    driven_cells = _cells(rows)
    shown = [_row(name, late, of) for name, of in driven.items() for late in SHOWN_LATE]
    hard_rows = [_row(name, late, of) for name, of in hard.items() for late in HARD_LATE]
    start_rows = [
        _row(f"{1000 * first_s:g} to {1000 * end_s:g} ms after a first start to 5 mm/s", AFTER_START_LATE, of)
        for (first_s, end_s), of in zip(
            itertools.pairwise(AFTER_START_S), zip(*starts, strict=True), strict=True
        )
    ]
    return Result(
        of="motion, read late by, s",
        thesis_source="none; App. A.4 averages up to 20 frames a second, of a machine at rest or not",
        columns=tuple(
            Column(f"{name}{of}", digits, judged=False)
            for of in ("", ", vibration")
            for name, digits in (("x", 2), ("y", 2), ("yaw", 2), ("pitch", 2), ("`sigma_now` of x, mm", 3))
        ),
        rows=(*shown, *hard_rows, *start_rows),
        headline=(
            f"Of {len(driven_cells)} cells of rms(error/`sigma_now`), 0 to 5 mm/s, read 0 to 1 s late, with "
            f"and without vibration, {_inside(driven_cells)} lie within {WITHIN[0]:g} to {WITHIN[1]:g}; all "
            f"are between {min(driven_cells):.2f} and {max(driven_cells):.2f}."
        ),
        text=_text(driven, _outside(rows), hard_rows),
        figure=_figure(driven),
        caption="`sigma_now` of x (lines), rms of its error (circles); error/sigma of all four quantities",
    )


def _row(name: str, late: int, of: Sequence[Readings]) -> Row:
    """Ratios and the mean sigma, without vibration and with it."""
    numbers: list[float | None] = []
    for readings in of:
        numbers += [*readings.ratio(late), rms(readings.sigmas[:, late, 0])]
    return Row(f"{name}, {LATE_S[late]:.2f}", tuple(numbers))


def _ratios(row: Row) -> list[float]:
    return [value for place, value in enumerate(row.ours) if place % 5 != 4 and value is not None]


def _cells(rows: Sequence[Row]) -> list[float]:
    return [ratio for row in rows for ratio in _ratios(row)]


def _inside(cells: Sequence[float]) -> int:
    return sum(WITHIN[0] <= round(cell, 2) <= WITHIN[1] for cell in cells)


def _outside(rows: Sequence[Row]) -> str:
    """The motions and reading times with cells outside, in words."""
    late: dict[str, list[str]] = {}
    for row in rows:
        if _inside(_ratios(row)) < len(_ratios(row)):
            motion, _, time = row.name.rpartition(", ")
            late.setdefault(motion, []).append(time)
    return "; ".join(f"{motion}, {', '.join(times)} s late" for motion, times in late.items()) or "none"


def _text(driven: dict[str, list[Readings]], outside: str, hard_rows: Sequence[Row]) -> str:
    rest = driven["0 mm/s"]
    still, shaken = (rms(of.sigmas[:, 0, 0]) for of in rest)
    own = [rms(rest[0].errors[:, 0, k] / rest[0].stated[:, k]) for k in range(len(QUANTITIES))]
    vibration = Vibration()
    lines_hz = ", ".join(f"{hz:g}" for hz in vibration.lines_hz)
    highest = max(_cells(hard_rows))
    return f"""
Each cell is the rms of (value − truth at the moment of reading)/(`sigma_now` of that moment). Windows have
20 exposures at 20 a second, so a value read at once is about half a second old. The plot has more reading
times.

{len(SEEDS)} units are on {PLACES} stretches each of the simulator's path at each speed, the highest of x.
Vibration is {vibration.rms_mm:g} mm and {vibration.rms_mrad:g} mrad rms, most of it at {lines_hz} Hz; the
truth includes it. At rest, read at once, `sigma_now` of x is {still:.4f} mm without vibration (sigma:
{rms(rest[0].stated[:, 0]):.4f} mm) and {shaken:.4f} mm with it.

Outside of {WITHIN[0]:g} to {WITHIN[1]:g}: {outside}. There the ratio is that of sigma itself,
{min(own):.2f} to {max(own):.2f} at these {len(SEEDS) * PLACES} places. Print and speckle are the same in all
exposures; sigma includes them and is on the safe side.

The other rows are motions of one unit that break the assumptions of `sigma_now`; the highest ratio is
{highest:.2f}. It is too large for steps and a slow sway, because rates and accelerations are assumed to
continue. A vibration near a multiple of the frame rate looks slow (20.5 Hz like 0.5 Hz); one at exactly 20
Hz is invisible and in no sigma. Steps are judged from {HARD_FROM / 20:g} s on, after a start and a stop.

**The first start of a machine cannot be predicted.** A value that was read before has the sigma of a
machine at rest and is off by the distance since. The last rows show the time soon after. The first exposure
of the motion can still be within the noise, under vibration the first two.
"""


def _figure(driven: dict[str, list[Readings]]) -> Figure:
    """Without vibration left, with it right: sigma and error of x above, ratios below."""
    figure, axes = panels(2, 2, height=6.0)
    colours = (GREY, FOURTH, THIRD, THESIS, OURS, "black")
    for kind, what in enumerate(("without vibration", "with vibration")):
        for (name, of), colour in zip(driven.items(), colours, strict=True):
            readings = of[kind]
            late = range(len(LATE_S))
            sigma = [rms(readings.sigmas[:, each, 0]) for each in late]
            axes[kind].semilogy(LATE_S, sigma, color=colour, lw=1.3, label=name)
            error = [rms(readings.errors[:, each, 0]) for each in late]
            axes[kind].semilogy(LATE_S, error, "o", color=colour, ms=4)
            ratios = np.array([readings.ratio(each) for each in late])
            axes[2 + kind].plot(LATE_S, ratios, ".-", color=colour, lw=0.8, ms=4)
        axes[kind].set(title=what, ylabel="x, mm")
        axes[2 + kind].axhspan(*WITHIN, color="#e8f0e8", zorder=0)
        axes[2 + kind].set(xlabel="read late by, s", ylabel="rms(error/sigma_now)", ylim=(0.0, 2.0))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(colours))
    return figure
