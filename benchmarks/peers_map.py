"""altd's map and other libraries' over the same nodes: px → mm against a lens that none of them knows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.interpolate import RBFInterpolator
from skimage.transform import PolynomialTransform

from altd.calibration.fitting import fit_nodes
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from altd.records import FloatArray
from hw_sim.assembly import make_lens
from hw_sim.lens import HEIGHT_PX, PIXEL_MM, WIDTH_PX

FOCAL_MM = (12.0, 8.0, 5.7, 3.6)
GRIDS = ((6, 5), (7, 5))
AREA_MM = (125.0, 100.0)
NOISE_PX = 0.05
_FIRST_SEED = 301
_DENSE = (50, 40)
_SIZE = (WIDTH_PX, HEIGHT_PX)
_MAX_DROPPED_SHARE = 0.2
"""What ``altd calibrate`` allows itself."""

ToMm = Callable[[FloatArray], FloatArray]
"""(n, 2) px to (n, 2) mm; NaN where there is none."""


@dataclass(frozen=True, slots=True)
class Task:
    """One lens: noisy nodes to fit, and a dense grid of held-out points with their exact places.

    ``focal_mm`` is the lens's nominal focal length, which its data sheet tells.
    """

    focal_mm: float
    grid: tuple[int, int]
    nodes_mm: FloatArray
    nodes_px: FloatArray
    dense_mm: FloatArray
    dense_px: FloatArray


@dataclass(frozen=True, slots=True)
class Mapper:
    """``fit`` takes the nodes and returns the map, or raises where it finds none."""

    library: str
    name: str
    how: str
    fit: Callable[[Task], ToMm]


def make_tasks(lenses: int) -> Iterator[Task]:
    """``lenses`` tilted Brown lenses a focal length, each with both grids over the same area."""
    for focal_mm in FOCAL_MM:
        for seed in range(_FIRST_SEED, _FIRST_SEED + lenses):
            rng = np.random.default_rng([seed, round(10 * focal_mm)])
            lens = make_lens((focal_mm, focal_mm), mirrored=False, rng=rng)
            for grid in GRIDS:
                nodes_mm = _grid(*(np.linspace(-0.5, 0.5, count) for count in grid))
                dense_mm = _grid(*((np.arange(count) + 0.5) / count - 0.5 for count in _DENSE))
                nodes_px, dense_px = (
                    np.column_stack(lens.project(places[:, 0], places[:, 1]))
                    for places in (nodes_mm, dense_mm)
                )
                nodes_px += rng.normal(0.0, NOISE_PX, nodes_px.shape)
                yield Task(focal_mm, grid, nodes_mm, nodes_px, dense_mm, dense_px)


def _grid(along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    return np.stack(np.meshgrid(along_x, along_y), axis=-1).reshape(-1, 2) * AREA_MM


def _altd(task: Task) -> ToMm:
    most_dropped = int(_MAX_DROPPED_SHARE * len(task.nodes_mm))
    fitted = fit_nodes(Nodes.ordinary(task.nodes_mm, task.nodes_px), _SIZE, None, most_dropped)
    inverse = InverseMap.of(fitted.fit.map)
    return lambda px: inverse.to_mm(px)[0]


def _homography(task: Task) -> ToMm:
    matrix, _ = cv2.findHomography(task.nodes_px, task.nodes_mm)
    return lambda px: _through(matrix, px)


def _through(matrix: Any, px: FloatArray) -> FloatArray:
    return np.asarray(cv2.perspectiveTransform(px[:, None, :], matrix), dtype=np.float64)[:, 0, :]


def _polynomial(order: int) -> Callable[[Task], ToMm]:
    def fit(task: Task) -> ToMm:
        transform = PolynomialTransform.from_estimate(task.nodes_px, task.nodes_mm, order=order)
        if not transform:
            raise ValueError(transform)

        def to_mm(px: FloatArray) -> FloatArray:
            return np.asarray(transform(px))

        return to_mm

    return fit


def _thin_plate(task: Task) -> ToMm:
    spline = RBFInterpolator(task.nodes_px, task.nodes_mm, kernel="thin_plate_spline")

    def to_mm(px: FloatArray) -> FloatArray:
        return np.asarray(spline(px))

    return to_mm


def _nominal(task: Task) -> tuple[Any, Any, Any]:
    """Points of the plane (x right, y down), their pixels, and the camera matrix of the data sheets."""
    plane = np.column_stack([task.nodes_mm * (1.0, -1.0), np.zeros(len(task.nodes_mm))])
    focal_px = task.focal_mm / PIXEL_MM
    matrix = np.array([[focal_px, 0, (WIDTH_PX - 1) / 2], [0, focal_px, (HEIGHT_PX - 1) / 2], [0, 0, 1.0]])
    return plane, task.nodes_px, matrix


_FINE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)


def _plane_of(rotation_vector: Any, translation: Any) -> Any:
    """The homography from undistorted rays to the plane, y turned up again."""
    rotation, _ = cv2.Rodrigues(rotation_vector)
    to_rays = np.column_stack([rotation[:, :2], np.ravel(translation)])
    return np.diag([1.0, -1.0, 1.0]) @ np.linalg.inv(to_rays)


def _calibrate_camera(flags: int) -> Callable[[Task], ToMm]:
    def fit(task: Task) -> ToMm:
        plane, px, nominal = _nominal(task)
        _, camera, distortion, turns, shifts = cv2.calibrateCamera(
            [plane.astype(np.float32)],
            [px.astype(np.float32)],
            _SIZE,
            nominal if flags & cv2.CALIB_USE_INTRINSIC_GUESS else None,
            None,
            flags=flags,
            criteria=_FINE,
        )
        back = _plane_of(turns[0], shifts[0])

        def to_mm(points_px: FloatArray) -> FloatArray:
            rays = cv2.undistortPoints(points_px[:, None, :], camera, distortion, criteria=_FINE)
            return _through(back, np.asarray(rays, dtype=np.float64)[:, 0, :])

        return to_mm

    return fit


def _fisheye(flags: int) -> Callable[[Task], ToMm]:
    def fit(task: Task) -> ToMm:
        plane, px, nominal = _nominal(task)
        # (1, n, c): OpenCV 5.0.0 raises for the (n, 1, c) that 4 took (its issue 29692).
        _, camera, distortion, turns, shifts = cv2.fisheye.calibrate(
            [plane[None]], [px[None]], _SIZE, nominal, np.zeros((4, 1)), flags=flags, criteria=_FINE
        )
        back = _plane_of(turns[0], shifts[0])

        def to_mm(points_px: FloatArray) -> FloatArray:
            rays = cv2.fisheye.undistortPoints(points_px[:, None, :], camera, distortion, criteria=_FINE)
            return _through(back, np.asarray(rays, dtype=np.float64)[:, 0, :])

        return to_mm

    return fit


_GUESS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3
_FISHEYE = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
_OPENCV = "opencv-python-headless"

MAPPERS = (
    Mapper(
        "altd",
        "altd `fit_nodes`, `InverseMap`",
        "as `altd calibrate` does: all models tried, outliers sought, a second map to check it; each point"
        " comes with its covariance",
        _altd,
    ),
    Mapper(
        _OPENCV, "OpenCV `findHomography`", "method 0, all nodes, px → mm; perspectiveTransform", _homography
    ),
    *(
        Mapper(
            "scikit-image",
            f"scikit-image polynomial {order}",
            f"PolynomialTransform.from_estimate(px, mm, order={order})",
            _polynomial(order),
        )
        for order in (2, 3, 4)
    ),
    Mapper(
        "scipy",
        "scipy thin plate spline",
        "RBFInterpolator(px, mm, kernel='thin_plate_spline'), exact at the nodes as by default:"
        " smoothing does not help",
        _thin_plate,
    ),
    Mapper(
        _OPENCV,
        "OpenCV `calibrateCamera`",
        "one view, no flags; undistortPoints, then the plane by the view's own rotation and translation",
        _calibrate_camera(0),
    ),
    Mapper(
        _OPENCV,
        "OpenCV `calibrateCamera`, guess",
        "the same from the true focal length and the image's middle: CALIB_USE_INTRINSIC_GUESS,"
        " CALIB_FIX_ASPECT_RATIO, CALIB_FIX_K3",
        _calibrate_camera(_GUESS),
    ),
    Mapper(
        _OPENCV,
        "OpenCV `calibrateCamera`, focal length",
        "the same with CALIB_FIX_FOCAL_LENGTH: it keeps the true one, which in practice nobody knows",
        _calibrate_camera(_GUESS | cv2.CALIB_FIX_FOCAL_LENGTH),
    ),
    Mapper(
        _OPENCV,
        "OpenCV `fisheye`",
        "one view, fisheye.calibrate from the same guess, CALIB_RECOMPUTE_EXTRINSIC, CALIB_FIX_SKEW;"
        " fisheye.undistortPoints, then the plane",
        _fisheye(_FISHEYE),
    ),
    Mapper(
        _OPENCV,
        "OpenCV `fisheye`, two k",
        "the same with CALIB_FIX_K3 and CALIB_FIX_K4: of twelve sets of flags the most accurate",
        _fisheye(_FISHEYE | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K4),
    ),
)


def distance_mm(task: Task, to_mm: ToMm) -> FloatArray:
    """How far each held-out point is put from where it is; infinite where it is put nowhere."""
    off = np.linalg.norm(to_mm(task.dense_px) - task.dense_mm, axis=1)
    return np.where(np.isfinite(off), off, math.inf)
