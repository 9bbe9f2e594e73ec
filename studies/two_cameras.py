"""Section 2.4.6: two fixed cameras that calibrate themselves by a plate at unknown poses."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from altd.instruments.planar.homography import apply_homography, fit_homography
from altd.records import FloatArray
from hw_sim.lens import Lens, rotation
from hw_sim.planar import HALF_RANGE, HEIGHT_PX, LEDS_MM, MIDDLE_MM, WIDTH_PX, PlanarScene, places_mm
from studies.bench import rms
from studies.plot import FOURTH, GREY, OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Section 2.4.6: two fixed cameras without a calibration object"
QUESTION = "How well do one and two cameras measure a plate whose poses and LEDs were not measured?"

DRAWS, CALIBRATING, MEASURED, SEED = 10, 12, 20, 246
NOISES_PX = (0.01, 0.02, 0.05)
SIDE_DEG = 20.0
"""Angle of each camera from the plate's normal, to the left and to the right."""
FIRST = (*MIDDLE_MM, 0.0)
"""The pose that defines the fixed frame."""
KNOWN_LEDS = (0, 3)
"""LEDs whose places define the plate's frame and a length, where the others are not known."""
GUESS_MM, APART_MM = 2.0, 0.1
"""Sigma of guessed places, from which the fit starts; sigma of the measured distance of the cameras."""
FOCAL_PX = 1375.0
"""Unit of the distortion."""
_MIDDLE_PX = np.array([(WIDTH_PX - 1) / 2.0, (HEIGHT_PX - 1) / 2.0])
_OF_CAMERA, _STEPS, _SCALE_MM = 12, 12, 100.0

Free = npt.NDArray[np.bool_]
"""Which of all numbers are fitted, (n,)."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way of calibrating: cameras, what is known, and what gives the length."""

    name: str
    cameras: int
    knows_poses: bool = False
    knows_leds: bool = True
    by_distance: bool = False


WAYS = (
    Way("one camera, known poses", 1, True),
    Way("one camera, unknown poses", 1),
    Way("one camera, unknown poses and LEDs", 1, False, False),
    Way("two cameras, unknown poses and LEDs", 2, False, False),
    Way("the same, length by the cameras' distance", 2, False, False, True),
)


@cache
def lenses(seed: int) -> list[Lens]:
    """Two cameras at the sides of the plate's normal, each with its own lens."""
    found = []
    for number, side in enumerate((-1.0, 1.0)):
        lens = PlanarScene(2 * seed + number).lens
        turned = rotation(math.radians(side * SIDE_DEG), 0.0, 0.0)
        middle = turned[:, :2] @ np.array([MIDDLE_MM[0], -MIDDLE_MM[1]])
        away = np.array([0.0, 0.0, 58.0 * lens.focal_mm]) - middle
        found.append(replace(lens, rotation=turned, translation_mm=away))
    return found


def pictures(cameras: Sequence[Lens], leds_mm: FloatArray, poses: FloatArray) -> FloatArray:
    """Places of the LEDs in all pictures, px (cameras, poses, LEDs, 2)."""
    at_mm = [places_mm(leds_mm, (a, b, phi)) for a, b, phi in poses.tolist()]
    return np.array([[np.stack(lens.project(*mm.T), axis=-1) for mm in at_mm] for lens in cameras])


def _modelled(cameras: FloatArray, leds_mm: FloatArray, poses: FloatArray) -> FloatArray:
    """The same by the model: a homography of eight and a distortion of four numbers, (cameras, 12)."""
    phi = np.radians(poses[:, 2, None])
    x, y = leds_mm.T
    plane_x = (poses[:, 0, None] - MIDDLE_MM[0] + np.cos(phi) * x - np.sin(phi) * y) / _SCALE_MM
    plane_y = (poses[:, 1, None] - MIDDLE_MM[1] + np.sin(phi) * x + np.cos(phi) * y) / _SCALE_MM
    h = cameras[:, :, None, None]
    depth = h[:, 6] * plane_x + h[:, 7] * plane_y + 1.0
    u = (h[:, 0] * plane_x + h[:, 1] * plane_y + h[:, 2]) / depth
    v = (h[:, 3] * plane_x + h[:, 4] * plane_y + h[:, 5]) / depth
    r2 = u * u + v * v
    k1, k2, p1, p2 = (h[:, at] for at in range(8, 12))
    radial = 1.0 + r2 * (k1 + r2 * k2)
    bent_u = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
    bent_v = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
    return np.asarray(_MIDDLE_PX + FOCAL_PX * np.stack([bent_u, bent_v], axis=-1))


class Model:
    """Cameras (c, 12), places of LEDs (n, 2) mm and poses (p, 3), of which some numbers are free."""

    def __init__(self, *blocks: FloatArray) -> None:
        self._shapes = [block.shape for block in blocks]
        self.values = np.concatenate([block.ravel() for block in blocks])
        self._ends = np.cumsum([block.size for block in blocks])[:-1]

    def blocks(self, values: FloatArray) -> list[FloatArray]:
        """Cameras, LEDs and poses."""
        parts = np.split(values, self._ends)
        return [part.reshape(shape) for part, shape in zip(parts, self._shapes, strict=True)]

    def slopes(self, free: Free) -> FloatArray:
        """Derivatives of all coordinates in the pictures by the free numbers."""
        columns = []
        for at in np.flatnonzero(free):
            step = np.zeros_like(self.values)
            step[at] = 1e-5
            ahead, behind = (_modelled(*self.blocks(self.values + of * step)) for of in (1.0, -1.0))
            columns.append((ahead - behind).ravel() / 2e-5)
        return np.stack(columns, axis=1)

    def fit(self, seen_px: FloatArray, free: Free) -> None:
        """Gauss–Newton steps to the least squares."""
        for _ in range(_STEPS):
            misfit = (seen_px - _modelled(*self.blocks(self.values))).ravel()
            step = np.linalg.lstsq(self.slopes(free), misfit, rcond=None)[0]
            self.values[free] += step
            if np.abs(step).max() < 1e-7:
                return


def undetermined(cameras: int, turns: bool) -> int:
    """Combinations of all numbers of ``cameras``, LEDs and poses that leave all pictures as they are."""
    rng = np.random.default_rng(SEED)
    poses = _poses(rng, CALIBRATING) * (1.0, 1.0, float(turns))
    leds_mm = np.array(LEDS_MM)
    seen_px = pictures(lenses(1)[:cameras], leds_mm, poses)
    model = Model(_first_cameras(seen_px, leds_mm, poses), leds_mm, poses)
    free = np.ones(model.values.size, dtype=bool)
    slopes = model.slopes(free)
    sizes = np.linalg.svd(slopes / np.linalg.norm(slopes, axis=0), compute_uv=False)
    return int(np.sum(sizes < 1e-7 * sizes[0]))


def calibrated(way: Way, seen_px: FloatArray, leds_mm: FloatArray, poses: FloatArray) -> Model:
    """The model fitted to pictures; only what the way knows of LEDs and poses is used."""
    leds_mm, poses = leds_mm.copy(), poses.copy()
    free = [np.ones((way.cameras, _OF_CAMERA)), np.zeros(leds_mm.shape), np.zeros(poses.shape)]
    if not way.knows_leds:
        rng = np.random.default_rng(SEED)
        free[1][[at for at in range(len(leds_mm)) if at not in KNOWN_LEDS]] = 1.0
        leds_mm += free[1] * rng.normal(0.0, GUESS_MM, leds_mm.shape)
    cameras = _first_cameras(seen_px, leds_mm, poses[:1])
    if not way.knows_poses:
        free[2][1:] = 1.0
        poses[1:] = [_guessed(cameras[0], leds_mm, px) for px in seen_px[0, 1:]]
    model = Model(cameras, leds_mm, poses)
    model.fit(seen_px, np.concatenate([of.ravel() for of in free]).astype(bool))
    return model


def _first_cameras(seen_px: FloatArray, leds_mm: FloatArray, poses: FloatArray) -> FloatArray:
    """Cameras without distortion, from these poses."""
    at_mm = np.concatenate([places_mm(leds_mm, (a, b, phi)) for a, b, phi in poses.tolist()])
    found = np.zeros((len(seen_px), _OF_CAMERA))
    for camera, px in zip(found, seen_px, strict=True):
        image = ((px[: len(poses)] - _MIDDLE_PX) / FOCAL_PX).reshape(-1, 2)
        h = fit_homography((at_mm - MIDDLE_MM) / _SCALE_MM, image)
        camera[:8] = (h / h[2, 2]).ravel()[:8]
    return found


def _guessed(camera: FloatArray, leds_mm: FloatArray, px: FloatArray) -> tuple[float, float, float]:
    """Pose by the camera's homography and the best turn of the LEDs."""
    back = np.linalg.inv(np.append(camera[:8], 1.0).reshape(3, 3))
    at_mm = apply_homography(back, (px - _MIDDLE_PX) / FOCAL_PX) * _SCALE_MM + MIDDLE_MM
    here, there = (points @ (1.0, 1.0j) for points in (leds_mm, at_mm))
    turn = np.angle(np.vdot(here - here.mean(), there - there.mean()))
    origin = there.mean() - np.exp(1.0j * turn) * here.mean()
    return float(origin.real), float(origin.imag), math.degrees(turn)


def measured(model: Model, seen_px: FloatArray) -> FloatArray:
    """Poses (p, 3) of pictures by a calibrated model."""
    cameras, leds_mm, _ = model.blocks(model.values)
    found = []
    for number in range(seen_px.shape[1]):
        px = seen_px[:, number : number + 1]
        one = Model(cameras, leds_mm, np.array([_guessed(cameras[0], leds_mm, px[0, 0])]))
        one.fit(px, np.arange(one.values.size) >= one.values.size - 3)
        found.append(one.values[-3:])
    return np.array(found)


def length_by_distance(model: Model, cameras: Sequence[Lens], apart_mm: float) -> float:
    """Factor of all lengths that brings the two cameras, whose lenses are known, to that distance."""
    places = []
    for h, lens in zip(model.blocks(model.values)[0], cameras, strict=True):
        focal_px = lens.focal_mm / 0.006
        to_px = np.array([[FOCAL_PX, 0.0, _MIDDLE_PX[0]], [0.0, FOCAL_PX, _MIDDLE_PX[1]], [0.0, 0.0, 1.0]])
        inner = np.array(
            [[focal_px, 0.0, lens.principal_px[0]], [0.0, focal_px, lens.principal_px[1]], [0.0, 0.0, 1.0]]
        )
        first, second, shift = (np.linalg.inv(inner) @ to_px @ np.append(h[:8], 1.0).reshape(3, 3)).T
        size = 0.5 * (np.linalg.norm(first) + np.linalg.norm(second))
        turned = np.stack([first, second, np.cross(first, second) / size], axis=1) / size
        places.append(-np.linalg.solve(turned, shift / size) * _SCALE_MM)
    return float(apart_mm / np.linalg.norm(places[1] - places[0]))


def _poses(rng: np.random.Generator, count: int) -> FloatArray:
    """Poses (count, 3) of the plate over its range; the first is ``FIRST``."""
    poses = np.array(FIRST) + rng.uniform(-1.0, 1.0, (count, 3)) * HALF_RANGE
    poses[0] = FIRST
    return poses


def _errors(way: Way, noise_px: float, draw: int) -> tuple[FloatArray, FloatArray, float]:
    """Errors (p, 3) of measured poses, the same with placement and length fitted, and that of lengths."""
    rng = np.random.default_rng([SEED, draw])
    both, leds_mm = lenses(draw + 1), np.array(LEDS_MM)
    poses = _poses(rng, CALIBRATING), _poses(rng, MEASURED)
    seen_px = [pictures(both, leds_mm, of) for of in poses]
    noisy = [(px + rng.normal(0.0, noise_px, px.shape))[: way.cameras] for px in seen_px]
    apart_mm = _apart_mm(both) + rng.normal(0.0, APART_MM)
    model = calibrated(way, noisy[0], leds_mm, poses[0])
    found = measured(model, noisy[1])
    if way.by_distance:
        factor = length_by_distance(model, both, apart_mm)
        found[:, :2] = MIDDLE_MM + factor * (found[:, :2] - MIDDLE_MM)
    errors = found - poses[1]
    fitted = _placement(poses[1])
    numbers = np.linalg.lstsq(fitted, errors.ravel(), rcond=None)[0]
    return errors, errors - (fitted @ numbers).reshape(-1, 3), float(numbers[-1])


def _apart_mm(cameras: Sequence[Lens]) -> float:
    places = [lens.rotation.T @ lens.translation_mm for lens in cameras]
    return float(np.linalg.norm(places[1] - places[0]))


def _placement(poses: FloatArray) -> FloatArray:
    """Changes of a, b, φ by origin and axes of both frames, and by the length: (3 p, 7)."""
    a, b, phi = poses[:, 0] - MIDDLE_MM[0], poses[:, 1] - MIDDLE_MM[1], np.radians(poses[:, 2])
    one, none = np.ones_like(a), np.zeros_like(a)
    columns = (
        (one, none, none),
        (none, one, none),
        (-b, a, none),
        (np.cos(phi), np.sin(phi), none),
        (-np.sin(phi), np.cos(phi), none),
        (none, none, one),
        (a, b, none),
    )
    return np.stack([np.stack(of, axis=-1).ravel() for of in columns], axis=1)


def run(progress: Progress) -> Result:
    """Each way with each noise, over drawn cameras."""
    found: dict[tuple[str, float], tuple[float, ...]] = {}
    for way in WAYS:
        for noise_px in NOISES_PX:
            progress(f"two-cameras: {way.name}, {noise_px:g} px")
            drawn = [_errors(way, noise_px, draw) for draw in range(DRAWS)]
            errors, left, lengths = (np.array(of) for of in zip(*drawn, strict=True))
            found[way.name, noise_px] = (
                *(rms(errors[..., at]) for at in range(3)),
                rms(left[..., :2]),
                rms(left[..., 2]),
                1e6 * rms(lengths),
            )
    counts = {(cameras, turns): undetermined(cameras, turns) for cameras in (1, 2) for turns in (True, False)}
    known, _, alone, both, distant = (found[way.name, NOISES_PX[1]] for way in WAYS)
    return Result(
        of="way, noise",
        thesis_source="Sec. 2.4.6: two stationary cameras need no calibration object; without figures",
        differs="the source names the way and does not try it; places of LEDs have noise, none are rendered",
        columns=(
            Column("a rms, mm", judged=False),
            Column("b rms, mm", judged=False),
            Column("φ rms, °", judged=False),
            Column("a, b, placement fitted, mm", judged=False),
            Column("φ, placement fitted, °", judged=False),
            Column("length, ppm", 0, judged=False),
        ),
        rows=tuple(Row(f"{name}, {noise:g} px", values) for (name, noise), values in found.items()),
        headline=(
            f"With {NOISES_PX[1]:g} px two cameras that know neither poses nor LEDs measure a and b to "
            f"{_rms(both):.4f} mm, one to {_rms(alone):.4f} mm, one with {CALIBRATING} known poses to "
            f"{_rms(known):.4f} mm; if the cameras' distance is the only known length, to "
            f"{_rms(distant):.4f} mm. Origin, axes and length are not in the pictures."
        ),
        text=f"""
The plate of [planar pose](../planar.md) moves in its plane by ±{HALF_RANGE[0]:g} mm, ±{HALF_RANGE[1]:g} mm
and ±{HALF_RANGE[2]:g}°. Two cameras see it from {SIDE_DEG:g}° left and right; {DRAWS} drawn pairs, each
calibrated by {CALIBRATING} poses, measure {MEASURED} others. One least-squares fit has all cameras (a
homography and four numbers of distortion each), places of LEDs and poses that are not known. It starts from
places guessed to {GUESS_MM:g} mm. A rigid plate has the same distances at all poses: that makes up for a
measured layout.

*Undetermined.* Lenses are not known. {counts[1, True]} combinations of the numbers leave the pictures of one
camera as they are, and {counts[2, True]} those of two: origin and axes of the fixed frame (3) and of the
plate (3), and the length. Without turns of the plate they are {counts[1, False]} and {counts[2, False]}. Here
one known pose gives the fixed frame, and the places of two LEDs, {_led_distance_mm():.0f} mm apart, the
plate's frame and the length. In the last way the length is the distance of the cameras, known to {APART_MM:g}
mm, with lenses that are known exactly. *Placement fitted* is what is left when these seven are fitted to the
truth.

The plate's turns replace the measured layout, and one camera is enough for that. The second camera makes the
errors of a and b {_rms(alone) / _rms(both):.1f} times smaller, and its distance from the first can be the
length. altd has no such calibration: a unit uses [known poses](../planar.md#set-up), which also give
placement and length.
""",
        figure=_figure(found),
        caption="Errors of a and b (rms of both) by noise of an LED's place in the picture",
    )


def _led_distance_mm() -> float:
    first, second = (np.array(LEDS_MM[at]) for at in KNOWN_LEDS)
    return float(np.linalg.norm(second - first))


def _rms(values: Sequence[float]) -> float:
    """Of a and b."""
    return rms(np.array(values[:2]))


def _figure(found: Mapping[tuple[str, float], tuple[float, ...]]) -> Figure:
    figure, (axis,) = panels(1, 1, width=7.5, height=3.4)
    for way, colour in zip(WAYS, (OURS, THIRD, GREY, THESIS, FOURTH), strict=True):
        sizes = [_rms(found[way.name, noise]) for noise in NOISES_PX]
        axis.loglog(NOISES_PX, sizes, "o-", color=colour, ms=4, label=way.name)
    axis.set(xlabel="noise of an LED's place, px", ylabel="rms of a and b, mm")
    axis.legend(fontsize=6)
    return figure
