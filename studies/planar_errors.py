"""Sections 2.4.3 and 2.4.5: causes of error of the planar pose, and the vanishing line against DLT."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from altd.app.planar_replay import PlanarReplay
from altd.calibration.planar import calibrate_planar
from altd.errors import BadInputError
from altd.instruments.planar.homography import (
    apply_homography,
    fit_homography,
    vanishing_line_homography,
)
from altd.instruments.planar.layout import wrapped_deg
from altd.recording.reader import open_recording
from altd.records import FloatArray, Measurement
from hw_sim.planar import LEDS_MM, PlanarScene, Stay, places_mm, record
from studies.bench import rms
from studies.plot import OURS, THIRD, panels
from studies.result import Column, Progress, Result, Row
from studies.table_2_1 import KEYS, KNOWN, MORE_KNOWN, POSES

TITLE = "Sections 2.4.3 and 2.4.5: causes of error of the planar pose"
QUESTION = (
    "What do wrong places of LEDs, the picture's resolution and camera shake cost, and is the vanishing line "
    "better than DLT?"
)

SEEDS = range(1, 4)
WRONG_MM = 0.5
"""Of a stated place of an LED, the thesis' example."""
CASES: Mapping[str, Mapping[str, Any]] = {
    "as set up": {},
    f"LEDs' places wrong by {WRONG_MM:g} mm": {"wrong_mm": WRONG_MM},
    "picture of 512 × 384 px": {"size_px": (512, 384)},
    "picture of 1536 × 1152 px": {"size_px": (1536, 1152)},
    "camera shake of 0.5 px": {"shake_px": 0.5},
}
WAYS = {"one known pose": 1, f"{MORE_KNOWN} known poses": MORE_KNOWN}
EXPOSURES = 2

NOISES_PX = (0.05, 0.5)
DRAWS, SEED = 2000, 245

_Values = tuple[float | None, ...]


def run(progress: Progress) -> Result:
    """Three cameras; each case by each way. Then homographies through drawn places of seven LEDs."""
    found: dict[tuple[str, str], _Values] = {}
    for case, settings in CASES.items():
        for way, known in WAYS.items():
            progress(f"planar-errors: {case}, {way}")
            errors, sigmas = zip(*(_errors(seed, known, **settings) for seed in SEEDS), strict=True)
            found[case, way] = _values(np.concatenate(errors), np.concatenate(sigmas))
    progress("planar-errors: homographies")
    drawn = {noise_px: homography_errors_mm(noise_px) for noise_px in NOISES_PX}
    said = "; ".join(
        f"with {noise_px:g} px " + ", ".join(f"{way} {mm:.4f} mm" for way, mm in of.items())
        for noise_px, of in drawn.items()
    )
    one, more = WAYS
    wrong = list(CASES)[1]
    return Result(
        of="case",
        thesis_source="Sec. 2.4.3; Sec. 2.4.5, Sources of Measurement Inaccuracy 1, 3 and 5; without figures",
        differs="the source names causes and measures none of them; its plate has other places of LEDs",
        columns=(
            Column("a rms, mm", judged=False),
            Column("b rms, mm", judged=False),
            Column("φ rms, °", judged=False),
            Column("rms of error/sigma", 2, judged=False),
            Column("not measured, %", 0, judged=False),
        ),
        rows=tuple(Row(f"{case}, {way}", values) for (case, way), values in found.items()),
        headline=(
            f"LEDs' places wrong by {WRONG_MM:g} mm make an error of a and b of {_mm(found[wrong, one])} rms "
            f"with one known pose and of {_mm(found[wrong, more])} with {MORE_KNOWN}, from which altd fits "
            "the places."
        ),
        text=f"""
{len(SEEDS)} simulated cameras measure the three poses of [Tables 2.1 to 2.3](table-2.1.md), each in
{EXPOSURES} frames that are measured one by one. These poses are exact, so that the tolerance of the blocks is
no part of the errors; known poses are set to 0.005 mm and 0.003° and have {EXPOSURES} frames each. Of one
known pose the calibration has no lens: distortion is then part of the errors.

*Places*: each LED is {WRONG_MM:g} mm beside its stated place, in a random direction. *Picture*: the same view
with other pixels; the blur stays as many pixels wide. *Shake*: the picture is displaced and blurred in each
exposure, by the stated sigma along each axis, also during the calibration. It displaces all LEDs alike, while
altd's sigma takes their errors as independent: no measurement states the shake of its own frame.

*Vanishing line against DLT* (2.4.3). {DRAWS} random cameras without distortion see seven LEDs with noise; rms
of the errors at the LEDs' true places, in the plane: {said}. *In pixels* means that neither plane is centred
and scaled first, *refined* is altd's `fit_homography`, which starts from the vanishing line. The thesis calls
the vanishing line more robust than DLT; here their errors are the same within {_difference(drawn):.2f} %. It
needs the singular values of a 14 × 3 matrix instead of 14 × 9, but a pseudoinverse besides.
""",
        figure=_figure(found),
        caption="Errors of a and b (rms of both) in each case, by known poses",
    )


def _errors(seed: int, known: int, wrong_mm: float = 0.0, **settings: Any) -> tuple[FloatArray, FloatArray]:
    """Measured minus stated a, b and φ, and their sigmas, (n, 3) each; NaN where nothing was measured."""
    scene, rng = PlanarScene(seed, **settings), np.random.default_rng([seed, 245])
    around = rng.uniform(0.0, 2.0 * np.pi, len(LEDS_MM))
    scene.true_leds_mm = scene.true_leds_mm + wrong_mm * np.stack([np.cos(around), np.sin(around)], axis=1)
    lit = tuple(range(len(LEDS_MM)))
    places = [KNOWN] if known == 1 else scene.poses(known)
    asked = [pose for pose, _ in POSES.values()]
    stays = [Stay(scene.near(pose), lit, pose) for pose in places]
    stays += [Stay(pose, lit) for pose in asked]
    with tempfile.TemporaryDirectory() as folder:
        record(Path(folder) / "plate", scene, stays, EXPOSURES, lambda done, planned: None)
        recording = open_recording(Path(folder) / "plate")
        nothing = np.full((EXPOSURES * len(asked), 3), np.nan)
        try:
            calibration = calibrate_planar([recording]).calibration
        except BadInputError:
            return nothing, nothing
        measured = list(PlanarReplay(recording, calibration, 1, 1).measurements())[-len(nothing) :]
    values, sigmas = (_of(measured, name) for name in ("value", "sigma"))
    errors = values - np.repeat(asked, EXPOSURES, axis=0)
    errors[:, 2] = [wrapped_deg(float(phi)) for phi in errors[:, 2]]
    return errors, sigmas


def _of(measured: Sequence[Measurement], name: str) -> FloatArray:
    """Values or sigmas (n, 3), NaN where a measurement is invalid."""
    return np.array(
        [[getattr(of.values[key], name) if key in of.values else np.nan for key in KEYS] for of in measured],
        dtype=np.float64,
    )


def _values(errors: FloatArray, sigmas: FloatArray) -> _Values:
    missing = np.isnan(errors).any(axis=1)
    if missing.all():
        return None, None, None, None, 100.0
    return *(rms(errors[:, k]) for k in range(3)), rms(errors / sigmas), 100.0 * float(missing.mean())


def direct_linear_transform(source: FloatArray, target: FloatArray) -> FloatArray:
    """Homography (3, 3) of least algebraic residuals with nine elements of norm 1: classical DLT."""
    plane = np.column_stack([source, np.ones(len(source))])
    nothing = np.zeros_like(plane)
    of_x = np.hstack([plane, nothing, -target[:, :1] * plane])
    of_y = np.hstack([nothing, plane, -target[:, 1:] * plane])
    rows = np.linalg.svd(np.vstack([of_x, of_y]), full_matrices=len(source) == 4)[2]
    return np.asarray(rows[-1].reshape(3, 3))


def homography_errors_mm(noise_px: float) -> dict[str, float]:
    """Rms error in the plane by way of estimation, of seven LEDs with noise seen by random cameras."""
    rng = np.random.default_rng([SEED, round(1000 * noise_px)])
    errors: dict[str, list[FloatArray]] = {}
    for _ in range(DRAWS):
        pose = rng.uniform((-45.0, 668.0, -40.0), (45.0, 732.0, 40.0))
        at_mm = places_mm(np.array(LEDS_MM), (float(pose[0]), float(pose[1]), float(pose[2])))
        camera = _camera(rng)
        seen_px = apply_homography(camera, at_mm)
        noisy_px = seen_px + rng.normal(0.0, noise_px, seen_px.shape)
        for way, homography in _estimates(noisy_px, at_mm).items():
            errors.setdefault(way, []).append(apply_homography(homography, seen_px) - at_mm)
    return {way: rms(np.concatenate(of)) for way, of in errors.items()}


def _camera(rng: np.random.Generator) -> FloatArray:
    """Homography from the plane in mm to px of a camera that is tilted by up to 40°, 435 mm away."""
    tilt, towards = np.radians(rng.uniform(0.0, 40.0)), rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    cross = np.array([[0.0, 0.0, axis[1]], [0.0, 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turned = np.eye(3) + np.sin(tilt) * cross + (1.0 - np.cos(tilt)) * cross @ cross
    shift = np.array([0.0, 0.0, 435.0]) - turned[:, :2] @ (0.0, 700.0)
    inner = np.array([[1250.0, 0.0, 511.5], [0.0, 1250.0, 383.5], [0.0, 0.0, 1.0]])
    return np.asarray(inner @ np.column_stack([turned[:, :2], shift]))


def _estimates(source: FloatArray, target: FloatArray) -> dict[str, FloatArray]:
    """Homographies from px to mm by way of estimation."""
    (to_unit, here), (to_unit_there, there) = _centred(source), _centred(target)
    back = np.linalg.inv(to_unit_there)
    return {
        "vanishing line": back @ vanishing_line_homography(here, there) @ to_unit,
        "DLT": back @ direct_linear_transform(here, there) @ to_unit,
        "refined": fit_homography(source, target),
        "vanishing line in pixels": vanishing_line_homography(source, target),
        "DLT in pixels": direct_linear_transform(source, target),
    }


def _centred(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Similarity that takes points (n, 2) to the middle 0 and the rms distance √2, and the points there."""
    middle = points.mean(axis=0)
    scale = np.sqrt(2.0 / np.square(points - middle).sum(axis=1).mean())
    similarity = np.array(
        [[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]]
    )
    return similarity, (points - middle) * scale


def _figure(found: Mapping[tuple[str, str], _Values]) -> Figure:
    figure, (axis,) = panels(1, 1, width=8.0, height=3.2)
    for way, colour in zip(WAYS, (THIRD, OURS), strict=True):
        sizes = [np.hypot(found[case, way][0] or np.nan, found[case, way][1] or np.nan) for case in CASES]
        axis.plot(sizes / np.sqrt(2.0), list(CASES), "o", color=colour, label=way)
    axis.set(xscale="log", xlabel="rms of a and b, mm")
    axis.invert_yaxis()
    axis.legend()
    return figure


def _mm(values: _Values) -> str:
    """The rms of a and b."""
    return f"{rms(np.array(values[:2], dtype=np.float64)):.3f} mm"


def _difference(drawn: Mapping[float, Mapping[str, float]]) -> float:
    """Largest difference of the two ways' errors, %."""
    pairs = [
        (of[f"DLT{end}"], of[f"vanishing line{end}"]) for of in drawn.values() for end in ("", " in pixels")
    ]
    return max(100.0 * abs(dlt / line - 1.0) for dlt, line in pairs)
