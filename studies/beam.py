"""The beam's form, the distance of the laser, the filter's angle, and refraction in the window."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from altd.cli.refraction import bending, index_per_kelvin
from hw_sim.beam import BeamFlaws, BeamPose, Laser
from hw_sim.hardness import Hardness
from hw_sim.measure import HALF_AREA_MM, random_poses
from hw_sim.optics import WAVELENGTH_NM
from hw_sim.unit import CAMERAS, EXPOSURES_MS, Unit, UnitConfig
from studies.bench import SIMULATORS, Bench, bench, rms, truth_of
from studies.plot import OURS, THESIS, THIRD, panels, plain_decades
from studies.result import Column, Progress, Result, Row
from studies.sweep import EXPOSURES

TITLE = "Beam, distance, filter and window"
QUESTION = "How far do the beam's form, its distance, the filter's angle and the window's glass disturb it?"

SEED, POSES = 71, 12

USUAL_MM = (12.0, 11.0)
FORMS: tuple[tuple[str, tuple[float, float], Mapping[str, float]], ...] = (
    ("12 × 11 mm", USUAL_MM, {}),
    ("15 mm round", (15.0, 15.0), {}),
    ("13 × 5 mm", (13.0, 5.0), {}),
    ("halo of 10 %", USUAL_MM, {"halo_share": 0.1}),
    ("asymmetric, skew 0.2", USUAL_MM, {"skew": 0.2}),
    ("clipped at 1.3 half diameters", USUAL_MM, {"aperture": 1.3}),
)
"""Name, diameters, and flaws in place of the simulator's own (``BeamFlaws``)."""

DISTANCES = ((10.0, 1.0), (25.0, 1.0), (50.0, 1.0), (100.0, 1.0), (50.0, 2.0), (75.0, 2.0), (100.0, 2.0))
"""In m, with the beam quality M² (ISO 11146-1): 1 is the limit of diffraction."""
AIR = (20.0, 1013.25)
"""°C and hPa, as by default in ``altd refraction``; the gradient is 1 K/m."""

FILTERS = (
    ("25 nm, 0 mrad", 25.0, 0.0, 0.0),
    ("10 nm, 0 mrad", 10.0, 0.0, 0.0),
    ("10 nm, 20 mrad after calibration", 10.0, 20.0, 0.0),
    ("10 nm, 3° after calibration", 10.0, 52.4, 0.0),
    ("10 nm, 6° after calibration", 10.0, 104.7, 0.0),
    ("10 nm, 10 mrad", 10.0, 10.0, 10.0),
    ("10 nm, 20 mrad", 10.0, 20.0, 20.0),
    ("10 nm, 3°", 10.0, 52.4, 52.4),
)
"""Name, width, and tilt in mrad at the measurement and at the calibration."""

GLASS_MM = 4.0
ANGLES_DEG = (0.0, 3.5, 7.0, 10.5, 14.0)
STATES = ("corrected", "not corrected")

NOTABLE = 1.25
"""Ratio of two rms errors of the same number of beams from which the page states it."""

SPECIFIED = (1.0, 1.0, 0.0573, 0.0573, None, 0.0, None, None)
COLUMNS = (
    Column("x rms, mm"),
    Column("y rms, mm"),
    Column("yaw rms, °", 5),
    Column("pitch rms, °", 5),
    Column("rms of error/sigma", 2, judged=False),
    Column("invalid", 0),
    Column("bent by 1 K/m, mm", 2, judged=False),
    Column("bent, °", 5, judged=False),
)

_Values = tuple[float | None, ...]
_Cases = dict[str, _Values]


def grown(diameter_mm: float, distance_m: float, quality: float) -> float:
    """The 1/e² diameter, mm, of a beam with its waist at the laser: d √(1 + (4 M² λ L / π d²)²)."""
    spread = 4.0 * quality * WAVELENGTH_NM * 1e-6 * distance_m * 1e3 / (math.pi * diameter_mm**2)
    return diameter_mm * math.sqrt(1.0 + spread**2)


def slanted_poses(angle_deg: float, distance_mm: float, rng: np.random.Generator) -> list[BeamPose]:
    """Beams pitched by the angle, up and down in turn, with both spots on the area."""
    slope, poses = math.tan(math.radians(angle_deg)), []
    half_mm = np.array(HALF_AREA_MM) - (0.0, 0.5 * slope * distance_mm)
    for sign in (1.0, -1.0) * (POSES // 2):
        x_mm, middle_mm = rng.uniform(-1.0, 1.0, size=2) * half_mm
        y_mm = float(middle_mm) - 0.5 * sign * slope * distance_mm
        poses.append(BeamPose(float(x_mm), y_mm, 0.0, sign * slope))
    return poses


def run(progress: Progress) -> Result:
    """The same beams on each simulator."""
    groups: dict[str, dict[str, _Cases]] = {}
    for ending, hard in SIMULATORS.items():
        base = UnitConfig(seed=SEED, hard=hard or Hardness())
        with bench(progress, f"beam{ending}") as on:
            on.calibrate(Unit(base))
            groups[ending] = {"Distance": _distances(on, base), "Form": _forms(on, base)}
            groups[ending] |= {"Filter": _filters(on, base), "Window": _window(on, base)}
    worse = "\n\n".join(
        f"{group}, {'harder' if ending else 'ordinary'} simulator: {_worse(cases)}."
        for group in groups[""]
        for ending, cases in ((ending, of[group]) for ending, of in groups.items())
    )
    steepest = [groups[""]["Window"][f"{ANGLES_DEG[-1]:g}°, {state}"][3] for state in STATES]
    narrow = [_angle_deg(of["Filter"]["10 nm, 0 mrad"]) for of in groups.values()]
    return Result(
        of="case",
        thesis_source="App. A.1, a specification without a test: ±1 mm, ±1 mm/m (0.0573°); laser of App. A.2",
        differs=(
            "all light has 650 nm and the filters pass 25 and 10 nm; [other wavelengths and widths]"
            "(filters.md) have a study of their own"
        ),
        columns=COLUMNS,
        rows=tuple(
            Row(case + ending, groups[ending][group][case], SPECIFIED)
            for group, cases in groups[""].items()
            for case in cases
            for ending in groups
        ),
        headline=(
            f"At {ANGLES_DEG[-1]:g}° the window's glass is an error of {steepest[1]:.4f}° in pitch, "
            f"{steepest[0]:.4f}° once it is corrected; behind a filter of 10 nm yaw and pitch are right to "
            f"{narrow[0]:.4f}° on the ordinary and {narrow[1]:.4f}° on the harder simulator."
        ),
        text=f"""
Worse than the first row of its group, by a factor of {NOTABLE:g} or more in the quantity that suffers most:

{worse}

Each row has {POSES} beams of {EXPOSURES} exposures, the same in all rows of form, distance and filter. The
truth of a beam is the centroid of its light except for the halo.

*Distance*: a beam of 12 × 11 mm at the laser grows by diffraction and its beam quality M² (ISO 11146-1). At
100 m it has {grown(12.0, 100.0, 1.0):.1f} × {grown(11.0, 100.0, 1.0):.1f} mm with an M² of 1, the least
that is possible, and {grown(12.0, 100.0, 2.0):.1f} × {grown(11.0, 100.0, 2.0):.1f} mm with 2; 15 mm are
specified. The last two columns are what a temperature gradient of 1 K/m bends the beam, by the formula of
`altd refraction`. No other column has it: the unit measures the bent beam, and altd does not correct it.
Turbulence, scintillation and haze are not simulated.

*Form*: the unit is calibrated with 12 × 11 mm and measured with each other beam, or calibrated with that beam
too (*calibrated so*). All have 3 mW and an exposure that is inverse to their peak. The harder simulator's
beam has flaws of its own (skew 0.075, clipped at 1.7 half diameters, a halo of 2 %), of which a row replaces
one. A spot that is formed unlike those of the calibration is refused as `front_distorted` or
`rear_distorted`.

*Filter*: band-pass filters before both lenses, tilted against the lens axis. The spot is scattered light, so
its angle on the filter is that of its place in the picture; the beam's own angle does not matter. The unit is
calibrated with each tilt, or (*after calibration*) with none. Of two scans with 10 nm tilted by 6°
`altd calibrate` refused one: too little of the outermost spots passes. A filter that tilts after the
calibration makes measurements wrong that stay valid: calibrate again when a filter was touched.

*Window*: {GLASS_MM:g} mm of glass with an index of 1.52 behind the print, beams pitched by the angle. The
calibration states the glass (*corrected*) or does not; the frames are the same. A thickness or index that is
stated wrong, and the front camera's path through the glass, are not simulated.
""",
        figure=_figure(groups),
        caption="Error of yaw and pitch (rms of both) in each case",
        beside="specified",
    )


def _distances(on: Bench, base: UnitConfig) -> _Cases:
    cases = {}
    for distance_m, quality in DISTANCES:
        x_mm, y_mm = (grown(diameter_mm, distance_m, quality) for diameter_mm in USUAL_MM)
        seen = _measured(on, exposed(base, (x_mm, y_mm)), _poses(base))
        bent = bending(abs(index_per_kelvin(*AIR)), distance_m)
        cases[f"{distance_m:g} m, M² {quality:g}"] = (*seen[:-2], bent.deviation_mm, bent.angle_deg)
    return cases


def _forms(on: Bench, base: UnitConfig) -> _Cases:
    units, poses = {}, _poses(base)
    for name, diameters_mm, flaws in FORMS:
        hard = base.hard or Hardness()
        if flaws:
            hard = replace(hard, beam=replace(hard.beam or BeamFlaws(), **flaws))
        units[name] = exposed(replace(base, hard=hard), diameters_mm)
    cases = {name: _measured(on, unit, poses) for name, unit in units.items()}
    for name in list(units)[-2:]:
        on.calibrate(units[name])
        cases[f"{name}, calibrated so"] = _measured(on, units[name], poses)
    return cases


def _filters(on: Bench, base: UnitConfig) -> _Cases:
    cases, calibrated = {}, None
    for name, width_nm, tilt_mrad, calibrated_mrad in FILTERS:
        measured, scanned = (
            replace(base, hard=replace(base.hard or Hardness(), filter_nm=width_nm, filter_tilt_mrad=mrad))
            for mrad in (tilt_mrad, calibrated_mrad)
        )
        if scanned != calibrated:
            on.calibrate(Unit(scanned))
            calibrated = scanned
        cases[name] = _measured(on, Unit(measured), _poses(base))
    return cases


def _window(on: Bench, base: UnitConfig) -> _Cases:
    glazed = replace(base, glass_mm=GLASS_MM)
    recorded = {}
    for angle_deg in ANGLES_DEG:
        poses = slanted_poses(angle_deg, base.target_distance_mm, np.random.default_rng([SEED, 43]))
        recorded[angle_deg] = poses, on.record(Unit(glazed), poses, EXPOSURES)
        _leave_out_glass(recorded[angle_deg][1])
    cases = {}
    for state, calibrated in zip(STATES, (glazed, base), strict=True):
        on.calibrate(Unit(calibrated))  # its beam is normal to the glass: the pictures are the same
        for angle_deg, (poses, recording) in recorded.items():
            cases[f"{angle_deg:g}°, {state}"] = _replayed(on, recording, poses)
    return cases


def _poses(base: UnitConfig) -> list[BeamPose]:
    return random_poses(POSES, base.target_distance_mm, np.random.default_rng([SEED, 42]))


def exposed(config: UnitConfig, diameters_mm: tuple[float, float]) -> Unit:
    """The unit with a beam of that size, exposed as bright as the usual one."""
    laser = Laser(diameters_mm=diameters_mm)
    unit = Unit(replace(config, laser=laser))
    for camera in CAMERAS:
        dimmer = config.laser.peak_mw_per_mm2 / laser.peak_mw_per_mm2
        unit.set_camera(camera, exposure_ms=EXPOSURES_MS[camera] * dimmer)
    return unit


def _leave_out_glass(recording: Path) -> None:
    """Let the recording state no targets: their glass is then the calibration's."""
    file = recording / "recording.json"
    header = json.loads(file.read_text())
    del header["targets"]
    file.write_text(json.dumps(header))


def _measured(on: Bench, unit: Unit, poses: Sequence[BeamPose]) -> _Values:
    return _replayed(on, on.record(unit, poses, EXPOSURES), poses)


def _replayed(on: Bench, recording: Path, poses: Sequence[BeamPose]) -> _Values:
    means = on.replay(recording, EXPOSURES, EXPOSURES)
    errors = means.values - truth_of(poses)
    refused = np.count_nonzero(~means.valid)
    if refused == len(poses):
        return (*[None] * 5, float(refused), None, None)
    return (*(rms(errors[:, at]) for at in range(4)), rms(errors / means.sigmas), float(refused), None, None)


def _angle_deg(values: _Values) -> float:
    """The rms of yaw and pitch; NaN where none was measured."""
    return math.sqrt(sum((math.nan if value is None else value) ** 2 for value in values[2:4]) / 2.0)


def _worse(cases: _Cases) -> str:
    """The cases with errors well above those of the first case, and with beams that are not measured."""
    (_, usual), *others = cases.items()
    notes = []
    for name, values in others:
        ratios = [(value or 0.0) / (of or math.inf) for value, of in zip(values[:4], usual[:4], strict=True)]
        said = []
        if max(ratios) >= NOTABLE:
            said.append(f"{COLUMNS[ratios.index(max(ratios))].name.split()[0]} × {max(ratios):.1f}")
        if refused := values[5]:
            said.append(f"{refused:g} of {POSES} refused")
        if said:
            notes.append(f"{name} ({', '.join(said)})")
    return "; ".join(notes) or "nothing"


def _figure(groups: Mapping[str, Mapping[str, _Cases]]) -> Figure:
    figure, axes = panels(2, 2, width=11.0, height=6.4)
    for axis, group in zip(axes, groups[""], strict=True):
        names = list(groups[""][group])
        for (ending, of), colour in zip(groups.items(), (OURS, THIRD), strict=True):
            at_deg = [_angle_deg(values) for values in of[group].values()]
            axis.plot(at_deg, names, "o", color=colour, ms=5, label=f"{group}{ending}")
        bent = [values[-1] for values in groups[""][group].values() if values[-1] is not None]
        if bent:
            axis.plot(bent, names, "x", color=THESIS, label="bent by 1 K/m")
        axis.set(xscale="log", xlabel="rms of yaw and pitch, °", title=group)
        plain_decades(axis.xaxis)
        axis.invert_yaxis()
        axis.legend(loc="best")
    return figure
