"""Laser and filter: bandwidths of App. A.2 and A.3, and a laser beside the filter's centre."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hw_sim.hardness import Hardness
from hw_sim.measure import HALF_AREA_MM, random_poses
from hw_sim.optics import WAVELENGTH_NM
from hw_sim.unit import CAMERAS, EXPOSURES_MS, Unit, UnitConfig
from studies.bench import Bench, bench, rms, truth_of
from studies.plot import FOURTH, GREY, OURS, THIRD, panels
from studies.result import Column, Progress, Result, Row
from studies.sweep import EXPOSURES

TITLE = "Wavelengths of laser and filter"
QUESTION = "How much of the laser and of stray light passes a filter, and does a unit measure behind it?"

SEED, POSES = 71, 8
WIDTHS_NM = (10.0, 11.0, 15.0, 25.0)
OFF_NM = (-10.0, 0.0, 10.0)
"""Of the laser from the filter's centre: the tolerance of the modules in App. A.2 and A.3."""
ENDS_NM = (600.0, 700.0)
"""Of App. A.1; the filter is made for the laser."""
REFERENCE_NM, LUX = 25.0, 200.0
"""Stray light behind a filter of that width; it is in proportion to the width."""

SPECIFIED = (None, None, None, None, None, 0.0573, 0.0573, None, 0.0)
COLUMNS = (
    Column("laser in the middle, %", 1, judged=False),
    Column("most on a target, %", 1, judged=False),
    Column("least on a target, %", 1, judged=False),
    Column("stray light, %", 0, judged=False),
    Column("least laser to stray light", 2, judged=False),
    Column("yaw rms, °", 5),
    Column("pitch rms, °", 5),
    Column("rms of error/sigma", 2, judged=False),
    Column("invalid", 0),
)

_Values = tuple[float | None, ...]


def cases() -> dict[str, Hardness]:
    """Filters of each width with a laser beside and in their centre, and lasers at the ends of the range."""
    beside = {
        f"{width_nm:g} nm, laser {off_nm:+g} nm": Hardness(
            filter_nm=width_nm, laser_nm=WAVELENGTH_NM + off_nm
        )
        for width_nm in WIDTHS_NM
        for off_nm in OFF_NM
    }
    made_for = {
        f"{REFERENCE_NM:g} nm, both {at_nm:g} nm": Hardness(
            filter_nm=REFERENCE_NM, laser_nm=at_nm, filter_centre_nm=at_nm
        )
        for at_nm in ENDS_NM
    }
    return beside | made_for


def _name(width_nm: float, off_nm: float) -> str:
    return f"{width_nm:g} nm, laser {off_nm:+g} nm"


def passed(unit: Unit) -> dict[str, tuple[float, float, float]]:
    """Share of the laser by camera: in the middle of its target, and the most and the least on all of it."""
    shares = {}
    for camera in CAMERAS:
        view = unit.imagers[camera].view
        laser = np.ones_like(view.x_mm) if view.laser_falloff is None else view.laser_falloff
        middle = laser.flat[int(np.argmin(np.hypot(view.x_mm, view.y_mm)))]
        on_target = laser[(np.abs(view.x_mm) <= HALF_AREA_MM[0]) & (np.abs(view.y_mm) <= HALF_AREA_MM[1])]
        shares[camera] = float(middle), float(on_target.max()), float(on_target.min())
    return shares


def run(progress: Progress) -> Result:
    """Calibrate and measure a unit with each filter and laser."""
    found: dict[str, _Values] = {}
    with bench(progress, "filters") as on:
        for name, hard in cases().items():
            found[name] = _measured(on, hard)
    refused = [name for name, values in found.items() if values[-1]]
    return Result(
        of="filter, laser",
        thesis_source=(
            "App. A.1, a specification: 600 to 700 nm, ±1 mm/m (0.0573°); filters and lasers of App. A.2, A.3"
        ),
        differs=(
            "the ordinary simulator; sensor and lens are the same at all wavelengths; the thesis' filters "
            "have their centre at 635 and 650 nm"
        ),
        columns=COLUMNS,
        rows=tuple(Row(name, values, SPECIFIED) for name, values in found.items()),
        headline=(
            f"A laser 10 nm beside the filter's centre passes with "
            f"{_percent(found, 11.0)} % (11 nm), {_percent(found, 15.0)} % (15 nm) and "
            f"{_percent(found, 25.0)} % (25 nm) in the middle; "
            + (f"beams are refused with: {', '.join(refused)}." if refused else "no beam is refused.")
        ),
        text=f"""
*Laser* is the share that passes the filter, relative to a laser in its centre at normal incidence: in the
middle of the targets (mean of both cameras), and most and least anywhere on either. With the angle of
incidence the pass band moves towards shorter wavelengths: a laser of {WAVELENGTH_NM - 10:g} nm gains by it,
one of {WAVELENGTH_NM + 10:g} nm loses. *Stray light* is white and passes in proportion to the filter's width;
it is {LUX:g} lx behind {REFERENCE_NM:g} nm. Their ratio is 1 for a laser in the middle of a filter of
{REFERENCE_NM:g} nm.

Each unit is calibrated with its laser and filter and measures {POSES} beams of {EXPOSURES} exposures. All are
exposed longer by as much as the laser is dimmed where most of it passes. A beam that is *invalid* is refused;
if the calibration is refused, all are. A laser whose wavelength drifts after the calibration is not studied.
""",
        figure=_figure(found),
        caption="Least share of the laser on a target, and the rms of yaw and pitch",
        beside="specified",
    )


def _measured(on: Bench, hard: Hardness) -> _Values:
    stray = hard.filter_nm / REFERENCE_NM
    unit = Unit(UnitConfig(seed=SEED, hard=hard, lux=LUX * stray))
    shares = passed(unit)
    for camera, (_, most, _) in shares.items():
        unit.set_camera(camera, exposure_ms=EXPOSURES_MS[camera] / most)
    middles, mosts, leasts = zip(*shares.values(), strict=True)
    least = min(leasts)
    light = 100.0 * float(np.mean(middles)), 100.0 * max(mosts), 100.0 * least, 100.0 * stray, least / stray
    poses = random_poses(POSES, unit.config.target_distance_mm, np.random.default_rng([SEED, 44]))
    try:
        on.calibrate(unit)
    except RuntimeError:
        return *light, None, None, None, float(POSES)
    readings = on.measure(unit, poses, EXPOSURES)
    invalid = float(np.count_nonzero(~readings.valid))
    if invalid == POSES:
        return *light, None, None, None, invalid
    errors = readings.values - truth_of(poses)
    return *light, rms(errors[:, 2]), rms(errors[:, 3]), rms(errors / readings.sigmas), invalid


def _percent(found: Mapping[str, _Values], width_nm: float) -> str:
    return f"{found[_name(width_nm, OFF_NM[-1])][0]:.0f}"


def _figure(found: Mapping[str, _Values]) -> Figure:
    figure, (left, right) = panels(1, 2, width=10.0, height=3.6)
    for width_nm, colour in zip(WIDTHS_NM, (GREY, FOURTH, THIRD, OURS), strict=True):
        values = [found[_name(width_nm, off_nm)] for off_nm in OFF_NM]
        left.plot(OFF_NM, [of[2] or 0.0 for of in values], "o-", color=colour, label=f"{width_nm:g} nm")
        angle_deg = [np.nan if of[5] is None or of[6] is None else np.hypot(of[5], of[6]) for of in values]
        right.plot(OFF_NM, np.array(angle_deg) / np.sqrt(2.0), "o-", color=colour, label=f"{width_nm:g} nm")
    left.set(xlabel="laser from the filter's centre, nm", ylabel="least of the laser on a target, %")
    right.set(xlabel="laser from the filter's centre, nm", ylabel="rms of yaw and pitch, °")
    left.legend()
    return figure
