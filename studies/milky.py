"""Section 3.3.1, Fig. 3.7: a window of milky glass against printed dots."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from altd.records import FloatArray, Spot
from altd.vision.localise import locate
from hw_sim.beam import BeamPose
from hw_sim.measure import random_poses
from hw_sim.milky import MilkyGlass
from hw_sim.sensor import FULL_WELL_E
from hw_sim.unit import CAMERAS, REAR, Unit, UnitConfig
from studies.bench import Bench, bench, pooled_std, rms, truth_of
from studies.plot import FOURTH, GREY, OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Fig. 3.7: milky glass against printed dots"
QUESTION = "What does a window that scatters the passing beam do to both spots, and what is then measured?"

SEED, POSES, EXPOSURES = 71, 12, 4
BLUR_MM = 1.0
"""Of the front spot by the volume of an opal glass, sigma: about a third of its thickness of 3 mm."""
WINDOWS: Mapping[str, MilkyGlass | None] = {
    "dots of 0.5/1.0 mm": None,
    "ground 5°, haze 100 %": MilkyGlass(1.0, 5.0),
    "ground 5°, haze 20 %": MilkyGlass(0.2, 5.0),
    "ground 15°, haze 100 %": MilkyGlass(1.0, 15.0),
    "ground 15°, haze 50 %": MilkyGlass(0.5, 15.0),
    "ground 15°, haze 20 %": MilkyGlass(0.2, 15.0),
    "opal, haze 100 %": MilkyGlass(1.0, None, BLUR_MM),
    "opal, haze 50 %": MilkyGlass(0.5, None, BLUR_MM),
    "opal, haze 20 %": MilkyGlass(0.2, None, BLUR_MM),
}
DOTS, OPAL, THIN = "dots of 0.5/1.0 mm", "opal, haze 100 %", "opal, haze 20 %"

MAX_EXPOSURE_MS = 40.0
"""At 20 frames a second."""
FULL_SHARE = 0.75
LEVEL = [BeamPose(x_mm, y_mm) for x_mm in (-50.0, 0.0, 50.0) for y_mm in (-40.0, 0.0, 40.0)]

COLUMNS = (
    Column("front repeat σ, mm"),
    Column("front error, rms mm"),
    Column("front spots found, %", 0, judged=False),
    Column("rear peak, % of dots", 2, judged=False),
    Column("rear FWHM, mm", 1, judged=False),
    Column("rear error, rms mm"),
    Column("rear spots found, %", 0, judged=False),
    Column("yaw rms, °", 5),
    Column("pitch rms, °", 5),
    Column("invalid, %", 0, judged=False),
)

_Values = tuple[float | None, ...]


def run(progress: Progress) -> Result:
    """The same unit and beams with each window."""
    found: dict[str, _Values] = {}
    peaks: dict[str, float] = {}
    profiles: dict[str, FloatArray] = {}
    with bench(progress, "milky") as on:
        for name, glass in WINDOWS.items():
            progress(f"milky: {name}")
            unit = Unit(UnitConfig(seed=SEED, milky=glass))
            set_exposures(unit)
            profiles[name] = rear_profile(unit)
            peaks[name] = float(profiles[name].max())
            found[name] = _values(on, unit, peaks[name] / peaks[DOTS], fwhm_mm(profiles[name]))
    return Result(
        of="window",
        thesis_source="Sec. 3.3.1, Fig. 3.7: a photograph of both; no figures are printed",
        differs=(
            "the ordinary simulator, 200 lx; lobes and haze are assumed, and the grain of the glass is "
            "that of ink"
        ),
        columns=COLUMNS,
        rows=tuple(Row(name, values) for name, values in found.items()),
        headline=(
            f"Behind opal glass the rear spot is {found[OPAL][4]:.0f} mm wide and has "
            f"{found[OPAL][3]:.2f} % of the irradiance behind dots: no beam is measured. A window that "
            f"scatters 20 % of the light to all sides would do: yaw and pitch to {_angles(found[THIN])}, "
            f"with dots {_angles(found[DOTS])}."
        ),
        text=f"""
*Haze* is the share of the passing light that the window scatters; the rest passes straight. *Ground* glass
scatters about the beam's direction, half as strongly at the stated angle; *opal* glass scatters light in its
volume until it has no direction (Lambertian), and blurs the front spot by {BLUR_MM:g} mm (sigma). Light on
the rear target is the beam convolved with the lobe over {UnitConfig().target_distance_mm:g} mm; power is
conserved. Of opal glass the peak is P/(πD²) and the width 1.29 D
([test](../../tests/unit/hw_sim/test_milky.py)). Speckle of the scattered laser light is finer than a pixel.

Both cameras are exposed for {100.0 * FULL_SHARE:g} % of full scale at level beams, stray light included, for
at most {MAX_EXPOSURE_MS:g} ms. {POSES} beams at any angle have {EXPOSURES} exposures each. *Found* are spots
that `locate` finds without knowing others; their errors are against the beam, through the true lens. If the
calibration is refused, all beams are invalid.

Ground glass of a narrow lobe sends its light past the front camera, which is beside the beam: the spot is dim
or lost, and drawn towards the camera. The direct part of the beam behind a glass of little haze is as sharp
as behind dots. On the simulator such a window without a pattern is even better than dots; whether a glass
like that exists, keeps clean and has no grain of its own must be measured.
""",
        figure=_figure(profiles, found),
        caption="Light on the rear target along x through the middle of the spot, and error of yaw and pitch",
    )


def set_exposures(unit: Unit) -> None:
    """Expose both cameras for the brightest of the level beams."""
    for camera in CAMERAS:
        brightest_e, view = 0.0, unit.imagers[camera].view
        for pose in LEVEL:
            unit.place(pose)
            region, light_e = view.beam_e(unit.spots(camera, 0), 1.0)
            light_e += view.ambient[region] * np.float32(unit.config.lux)
            brightest_e = max(brightest_e, float(light_e.max()))
        unit.set_camera(camera, exposure_ms=min(FULL_SHARE * FULL_WELL_E / brightest_e, MAX_EXPOSURE_MS))


AT_MM = np.concatenate([np.arange(0.0, 20.0, 0.05), np.arange(20.0, 400.0, 0.5)]).astype(np.float32)
"""Along x from the middle of the spot."""


def rear_profile(unit: Unit) -> FloatArray:
    """Irradiance on the rear target at ``AT_MM`` from the middle of a level beam, mW/mm²."""
    unit.place(BeamPose(0.0, 0.0))
    total = sum(spot.irradiance(AT_MM, np.zeros_like(AT_MM)) for spot in unit.spots(REAR, 0))
    return np.asarray(total, dtype=np.float64)


def fwhm_mm(profile: FloatArray) -> float:
    """Full width at half maximum."""
    return 2.0 * float(AT_MM[np.argmax(profile < 0.5 * profile[0])])


def _values(on: Bench, unit: Unit, peak: float, width_mm: float) -> _Values:
    rng = np.random.default_rng([SEED, 46])
    poses = random_poses(POSES, unit.config.target_distance_mm, rng)
    front_mm, rear_mm = (_located_mm(unit, camera, poses) for camera in CAMERAS)
    errors_mm = front_mm - truth_of(poses)[:, None, :2]
    rear_at_mm = np.array([pose.at(unit.config.target_distance_mm) for pose in poses])[:, None]
    shares = [100.0 * float(np.isfinite(of[..., 0]).mean()) for of in (front_mm, rear_mm)]
    whole = np.isfinite(front_mm).all(axis=(1, 2)).any()
    front = (rms(pooled_std(front_mm)), rms(errors_mm)) if whole else (None, None)
    rear = rms(rear_mm - rear_at_mm) if shares[1] else None
    light = *front, shares[0], 100.0 * peak, width_mm, rear, shares[1]
    try:
        on.calibrate(unit)
    except RuntimeError:
        return *light, None, None, 100.0
    seen = on.measure(unit, poses, EXPOSURES)
    errors = seen.values - truth_of(poses)
    invalid = 100.0 * float(1.0 - seen.valid.mean())
    angles = (rms(errors[:, 2]), rms(errors[:, 3])) if seen.valid.any() else (None, None)
    return *light, *angles, invalid


def _located_mm(unit: Unit, camera: str, poses: Sequence[BeamPose]) -> FloatArray:
    """Places (poses, exposures, 2) of the located spots through the true lens; NaN where there is none."""
    lens = unit.imagers[camera].view.lens
    places = np.full((len(poses), EXPOSURES, 2), np.nan)
    for number, pose in enumerate(poses):
        unit.place(pose)
        for exposure in range(EXPOSURES):
            sequence = number * EXPOSURES + exposure
            spot = locate(unit.expose(camera, sequence, sequence * unit.config.period_ns))
            if isinstance(spot, Spot):
                places[number, exposure] = lens.unproject(spot.u_px, spot.v_px)
    return places


def _angles(values: _Values) -> str:
    return "–" if values[7] is None else f"{rms(np.array(values[7:9], dtype=np.float64)):.4f}°"


def _figure(profiles: Mapping[str, FloatArray], found: Mapping[str, _Values]) -> Figure:
    figure, (light, error) = panels(1, 2, width=11.0, height=3.8)
    shown = (DOTS, "ground 5°, haze 100 %", "ground 15°, haze 100 %", OPAL, THIN)
    for name, colour in zip(shown, (OURS, GREY, THIRD, THESIS, FOURTH), strict=True):
        light.loglog(AT_MM[1:], profiles[name][1:], color=colour, label=name)
    light.set(xlabel="distance from the middle, mm", ylabel="mW/mm²", ylim=(1e-6, 0.1))
    light.legend(fontsize=6)
    for column, colour, label in ((7, OURS, "yaw"), (8, THESIS, "pitch")):
        values = np.array([of[column] for of in found.values()], dtype=np.float64)
        error.plot(values, list(found), "o", color=colour, label=label)
    error.set(xlabel="rms error, °", xlim=(0.0, None))
    error.invert_yaxis()
    error.legend()
    return figure
