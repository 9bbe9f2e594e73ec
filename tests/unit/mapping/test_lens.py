"""The lens model against OpenCV's projection, which shares no code with it."""

import cv2
import numpy as np
import pytest
from support.lenses import TABLE_3_2, LensKind, make_lens
from support.plates import View, tilted

from altd.mapping.camera_model import CameraModel, Optics
from altd.mapping.grid import convex_hull_mm
from altd.mapping.lens import fit_lens_map, fit_lens_maps
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import Fit, fit_tensor_map

SIZE = (752, 480)
NOISE_PX = 0.05

x, y = np.meshgrid((np.arange(6) - 2.5) * 25, (np.arange(5) - 2.0) * 25)
NODES = np.column_stack([x.ravel(), y.ravel()])


def camera(points_mm: np.ndarray, focal_px: float = 1000.0, mirrored: bool = False) -> np.ndarray:
    """A tilted, shifted camera with Brown's five coefficients; y is up, v is down."""
    matrix = np.array([[focal_px, 0, 384.0], [0, focal_px, 231.0], [0, 0, 1]])
    brown = np.array([-0.2, 0.06, 0.0008, -0.0011, 0.02])
    side = -1.0 if mirrored else 1.0
    space = np.column_stack([side * points_mm[:, 0], -points_mm[:, 1], np.zeros(len(points_mm))])
    tilt, shift = np.array([0.06, -0.28, 0.03]), np.array([4.0, -3.0, 0.26 * focal_px])
    return cv2.projectPoints(space, tilt, shift, matrix, brown)[0].reshape(-1, 2)


def fit(px: np.ndarray, nodes: np.ndarray = NODES) -> Fit:
    return fit_lens_map(Nodes.ordinary(nodes, px), convex_hull_mm(nodes), SIZE)


def inside(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform((-60, -48), (60, 48), (count, 2))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("focal_px", [600.0, 1000.0, 2000.0])
def test_a_brown_camera_is_found_from_either_side(focal_px: float, mirrored: bool) -> None:
    points = inside(100, np.random.default_rng(1))
    fitted = fit(camera(NODES, focal_px, mirrored)).map
    assert fitted.to_px(points) == pytest.approx(camera(points, focal_px, mirrored), abs=0.01)


def test_the_lens_map_misses_less_than_the_tensor_polynomial_on_a_lens() -> None:
    rng = np.random.default_rng(2)
    points, ratios = inside(200, rng), []
    for _ in range(10):
        px = camera(NODES) + rng.normal(0, NOISE_PX, NODES.shape)
        tensor = fit_tensor_map(NODES, px, convex_hull_mm(NODES))
        lens = fit(px)
        assert lens.leave_one_out_px < tensor.leave_one_out_px
        miss = [np.sqrt(np.mean((m.map.to_px(points) - camera(points)) ** 2)) for m in (lens, tensor)]
        ratios.append(miss[0] / miss[1])
    assert np.mean(ratios) < 0.7


def test_what_a_node_misses_the_map_by_that_never_saw_it() -> None:
    rng = np.random.default_rng(4)
    px = camera(NODES) + rng.normal(0, NOISE_PX, NODES.shape)
    missed = []
    for node in range(len(NODES)):
        rest = np.delete(np.arange(len(NODES)), node)
        without = fit(px[rest], NODES[rest]).map
        missed.append(px[node] - without.to_px(NODES[node : node + 1])[0])
    assert fit(px).leave_one_out_px == pytest.approx(np.sqrt(np.mean(np.square(missed))), rel=0.1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_fisheye_is_found_from_either_side(mirrored: bool) -> None:
    lens = make_lens(TABLE_3_2[3], np.random.default_rng(6))
    side = np.array([-1.0 if mirrored else 1.0, 1.0])
    points = inside(100, np.random.default_rng(1))
    nodes = Nodes.ordinary(NODES, lens(NODES * side))
    fitted = fit_lens_map(nodes, convex_hull_mm(NODES), SIZE, "fisheye").map
    assert (fitted.model, fitted.folds) == ("fisheye", False)
    assert fitted.to_px(points) == pytest.approx(lens(points * side), abs=0.005)


def test_a_fisheye_is_better_by_the_fisheye_model() -> None:
    rng = np.random.default_rng(7)
    ratios = []
    for _ in range(6):
        lens = make_lens(LensKind(3.6, 110.0, None), rng)  # 36° off its axis
        px = lens(NODES) + rng.normal(0, 0.02, NODES.shape)
        brown, fisheye = (
            fit_lens_map(Nodes.ordinary(NODES, px), convex_hull_mm(NODES), SIZE, optics)
            for optics in ("brown", "fisheye")
        )
        ratios.append(fisheye.leave_one_out_px / brown.leave_one_out_px)
    assert np.mean(ratios) < 0.7


def test_a_lens_behind_a_bent_window_is_found_with_a_polynomial_on_top() -> None:
    """A shift by up to 0.6 px that goes with x² and x y, as a pane that is no pane gives."""

    def through_window(p: np.ndarray) -> np.ndarray:
        x, y = p[:, 0] / 62.5, p[:, 1] / 50
        return camera(p) + np.column_stack([0.6 * x**3 * y, 0.5 * x * y**3])

    rng = np.random.default_rng(8)
    px = through_window(NODES) + rng.normal(0, 0.02, NODES.shape)
    points = inside(200, rng)
    fits = fit_lens_maps(Nodes.ordinary(NODES, px), convex_hull_mm(NODES), SIZE)
    assert [fit.map.model for fit in fits] == [
        "lens",
        "lens+tensor",
        "lens+tensor",
        "fisheye",
        "fisheye+tensor",
        "fisheye+tensor",
    ]
    assert [fit.degree for fit in fits[:3]] == [None, (2, 2), (3, 3)]
    miss = [np.sqrt(np.mean((fit.map.to_px(points) - through_window(points)) ** 2)) for fit in fits]
    assert miss[2] < 0.02
    assert miss[2] < 0.3 * miss[0]
    assert fits[2].leave_one_out_px < 0.5 * fits[0].leave_one_out_px


def test_a_bend_that_no_lens_has_is_left_to_the_tensor_polynomial() -> None:
    def bent(p: np.ndarray) -> np.ndarray:
        return np.column_stack([370 + 4 * p[:, 0] + 2 * np.sin(p[:, 1] / 20), 240 - 4 * p[:, 1]])

    px = bent(NODES) + np.random.default_rng(5).normal(0, NOISE_PX, NODES.shape)
    assert fit(px).leave_one_out_px > 2 * fit_tensor_map(NODES, px, convex_hull_mm(NODES)).leave_one_out_px


def test_nodes_that_cannot_carry_a_lens_are_refused() -> None:
    with pytest.raises(ValueError, match="10 nodes are too few for a lens model"):
        fit(camera(NODES[:10]), NODES[:10])
    line = np.column_stack([np.linspace(-60, 60, 20), np.zeros(20)])
    with pytest.raises(ValueError, match="the nodes lie on a line"):
        fit_lens_map(Nodes.ordinary(line, camera(line)), convex_hull_mm(NODES), SIZE)


def by_opencv(optics: Optics, p: np.ndarray, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """OpenCV's projections of the points with a camera's parameters, and its derivatives, by formula."""
    width, height = SIZE
    focal_px = 1.4 * width * np.exp(p[6])
    middle = np.array([(width - 1) / 2, (height - 1) / 2]) + width * p[7:9]
    matrix = np.array([[focal_px, 0, middle[0]], [0, focal_px, middle[1]], [0, 0, 1]])
    space = np.column_stack([points_mm[:, 0], -points_mm[:, 1], np.zeros(len(points_mm))])[:, None, :]
    move = np.array([p[3], p[4], focal_px / np.exp(p[5])])
    if optics == "brown":
        px, slopes = cv2.projectPoints(space, p[:3].copy(), move, matrix, p[9:].copy())
        turned, moved, focal, centre, bent = np.split(slopes[:, :14], [3, 6, 8, 10], axis=1)
    else:
        distortion = np.array([*p[9:], 0.0, 0.0])
        px, slopes = cv2.fisheye.projectPoints(space, p[:3].copy(), move, matrix, distortion)
        focal, centre, bent, turned, moved = np.split(slopes[:, :14], [2, 4, 8, 11], axis=1)
    away = move[2] * moved[:, 2:]
    nearer = focal_px * focal.sum(axis=1, keepdims=True) + away
    columns = [turned, moved[:, :2], -away, nearer, width * centre, bent[:, : len(p) - 9]]
    return px.reshape(-1, 2), np.hstack(columns)


@pytest.mark.parametrize("optics", ["brown", "fisheye"])
def test_projection_and_derivatives_are_opencvs(optics: Optics) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        bent = rng.normal(0, (0.2, 0.05, 3e-4, 3e-4)[: 4 if optics == "brown" else 2])
        pose = [*rng.normal(0, 0.2, 3), *rng.normal(0, 5, 2), np.log(4.4) + rng.normal(0, 0.1)]
        parameters = np.array([*pose, *rng.normal(0, 0.05, 3), *bent])
        mine = CameraModel(optics, parameters, False, *SIZE)
        px, slopes = by_opencv(optics, parameters, NODES)
        assert np.abs(mine.to_px(NODES) - px).max() < 1e-11
        assert mine.jacobian(NODES) == pytest.approx(slopes, rel=1e-5, abs=1e-6 * np.abs(slopes).max())


def test_weak_priors_make_a_fit_better_than_opencvs_own_from_the_same_start() -> None:
    """One picture of a plane hardly tells tilt from principal point; truth and rival are OpenCV's."""
    rng = np.random.default_rng(9)
    points, ratios = inside(200, rng), []
    for _ in range(30):
        middle = (375.5 + rng.normal(0, 8), 239.5 + rng.normal(0, 8))
        brown = (rng.uniform(-0.3, -0.1), rng.uniform(0, 0.1), *rng.normal(0, 3e-4, 2), 0.0)
        turn = tilted(rng.uniform(0, 30), rng.uniform(0, 6.28), rng.uniform(-3, 3))
        view = View(rng.uniform(900, 1350), rng.uniform(340, 420), turn, brown, middle_px=middle)
        seen_px = view.to_px(NODES) + rng.normal(0, 0.04, NODES.shape)
        face = np.column_stack([NODES[:, 0], -NODES[:, 1], np.zeros(len(NODES))]).astype(np.float32)
        start = np.array([[1.4 * SIZE[0], 0, 375.5], [0, 1.4 * SIZE[0], 239.5], [0, 0, 1.0]])
        flags = cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
        given = [face], [seen_px.astype(np.float32)[:, None, :]], SIZE, start, None
        _, matrix, distortion, turns, moves = cv2.calibrateCamera(*given, flags=flags)
        space = np.column_stack([points[:, 0], -points[:, 1], np.zeros(len(points))])
        rival_px = cv2.projectPoints(space, turns[0], moves[0], matrix, distortion)[0].reshape(-1, 2)
        true_px = view.to_px(points)
        rms = [np.sqrt(np.mean((px - true_px) ** 2)) for px in (fit(seen_px).map.to_px(points), rival_px)]
        ratios.append(rms[0] / rms[1])
    assert np.mean(ratios) < 0.95
