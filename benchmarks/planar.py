"""``python -m benchmarks.planar``: the planar pose on simulated plates, among false lights, on photographs.

Simulated plates: a calibration from known poses, then new poses whose LEDs are lost one by one.

False lights: LEDs and other lights at random, without rendering; each pose that is marked valid is judged.

Photographs: ``../shared/data/chessboard``. A hand holds the board, so no two photographs show one plane, and
no true pose of a photograph is known. But the corners are rigid: seven of them, taken as a plate that has
moved in the plane of the 28 others, have moved by a = b = 0 and turned by φ = 0. The rest is error.
"""

import math
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from altd.app.planar_replay import PlanarReplay
from altd.calibration.planar import calibrate_planar
from altd.instruments.planar.homography import fit_homography
from altd.instruments.planar.instrument import Leds, PlanarCalibration, PlanarInstrument
from altd.instruments.planar.layout import Pose, rigid_pose, wrapped_deg
from altd.instruments.planar.plane import homography_camera, lens_camera
from altd.recording.reader import open_recording
from altd.records import FloatArray, Value
from altd.vision.led_discs import Disc
from benchmarks.harness import Columns, Parser, end, quiet
from hw_sim.planar import HEIGHT_PX, MIDDLE_MM, WIDTH_PX, PlanarScene, known_and_unknown, places_mm, record
from hw_sim.plate import LED_DIAMETER_MM

KEYS = ("a_mm", "b_mm", "phi_deg")
SEEDS = range(401, 411)
KNOWN, UNKNOWN, EXPOSURES = 12, 10, 4

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "shared" / "data" / "chessboard"
SQUARE_MM = 25.0
BOARD_MM = np.stack(np.meshgrid(np.arange(7.0), -np.arange(5.0)), axis=-1).reshape(-1, 2) * SQUARE_MM
GROUPS, IN_GROUP = 20, 7

_Errors = dict[int, list[tuple[FloatArray, FloatArray]]]
"""Error and sigma of a, b, φ, by the number of LEDs; NaN if the pose is not valid."""


def simulated(seed: int, errors: _Errors) -> PlanarCalibration:
    """Record, calibrate and measure one camera and plate; adds to ``errors``."""
    scene = PlanarScene(seed)
    stays = known_and_unknown(scene, scene.poses(KNOWN), [], None)
    stays += known_and_unknown(scene, [], scene.poses(UNKNOWN), None)
    with tempfile.TemporaryDirectory() as folder:
        record(Path(folder) / "plate", scene, stays, EXPOSURES, quiet)
        recording = open_recording(Path(folder) / "plate")
        calibration = calibrate_planar([recording]).calibration
        measured = list(PlanarReplay(recording, calibration, EXPOSURES, EXPOSURES).measurements())
    for stay, measurement in zip(stays[KNOWN:], measured[KNOWN:], strict=True):
        values = [measurement.values.get(key, Value(math.nan, math.nan)) for key in KEYS]
        off = np.array([value.value for value in values]) - stay.pose
        off[2] = wrapped_deg(off[2]) if math.isfinite(off[2]) else math.nan
        errors[len(stay.lit)].append((off, np.array([value.sigma for value in values], dtype=np.float64)))
    return calibration


def print_simulated(seeds: Sequence[int]) -> dict[int, PlanarCalibration]:
    """Print the errors over all seeds by the number of LEDs."""
    errors: _Errors = defaultdict(list)
    calibrations = {}
    for seed in seeds:
        calibrations[seed] = simulated(seed, errors)
        of = calibrations[seed]
        print(f"seed {seed}: {of.fit.camera.model}, leave-one-out (mm, °) {dict(of.rms)}", flush=True)
    print("rms of the error, and of error/sigma", _POSES.head, sep="\n")
    for leds, of_leds in sorted(errors.items(), reverse=True):
        _print_row(str(leds), of_leds)
    _print_row("all", [each for of_leds in errors.values() for each in of_leds])
    return calibrations


_POSES = Columns(
    *("LEDs:<5", "poses:>6", "valid:>6", "a mm:>8.4f", "b mm:>8.4f", "phi °:>8.4f"),
    *("a:>9.2f", "b:>6.2f", "phi:>6.2f"),
)


def _print_row(name: str, of_leds: Sequence[tuple[FloatArray, FloatArray]]) -> None:
    off, sigma = (np.array(column) for column in zip(*of_leds, strict=True))
    good = np.isfinite(off[:, 0])
    rms = np.sqrt(np.mean(off[good] ** 2, axis=0))
    ratio = np.sqrt(np.mean((off[good] / sigma[good]) ** 2, axis=0))
    print(_POSES.row(name, len(off), good.sum(), *rms, *ratio))


def print_false_lights(calibrations: Mapping[int, PlanarCalibration], poses: int) -> None:
    """Count poses from LEDs among other lights: right, wrong by more than six sigma, or refused."""
    table = Columns("LEDs:<6", "other lights:<16", "right:>5", "wrong:>7", "refused:>9")
    print(table.head)
    for lit, others in [(7, 1), (4, 1), (3, 1), (2, 1), (1, 1), (0, 2), (5, 3), (3, 2), (2, 4), (2, 0)]:
        tally: Counter[str] = Counter()
        for seed, calibration in calibrations.items():
            rng = np.random.default_rng([seed, lit, others])
            scene, instrument = PlanarScene(seed), PlanarInstrument(calibration)
            for pose in scene.poses(poses):
                leds_mm = places_mm(scene.true_leds_mm, pose)[rng.permutation(len(scene.leds_mm))[:lit]]
                lights_mm = rng.uniform((-90.0, -70.0), (90.0, 70.0), size=(others, 2)) + MIDDLE_MM
                seen = np.vstack([leds_mm, lights_mm])
                tally[_outcome(instrument, _discs(scene, seen, rng), pose)] += 1
        print(
            table.row(lit, others, *(tally[outcome] for outcome in ("right", "wrong", "refused"))), flush=True
        )


def _discs(scene: PlanarScene, at_mm: FloatArray, rng: np.random.Generator) -> list[Disc]:
    """Discs of lights at (n, 2) mm, as wide as LEDs, with noise of their centres."""
    px = np.stack(scene.lens.project(*at_mm.T), axis=-1)
    right, up = (np.stack(scene.lens.project(*(at_mm + step).T), axis=-1) - px for step in np.eye(2))
    area_px = np.abs(right[:, 0] * up[:, 1] - right[:, 1] * up[:, 0]) * math.pi / 4 * LED_DIAMETER_MM**2
    px += rng.normal(0.0, 0.006, size=px.shape)
    return [
        Disc(u, v, area, 150.0, 1.3, False, (0, 0, 1, 1))
        for (u, v), area in zip(px.tolist(), area_px.tolist(), strict=True)
        if 10 < u < WIDTH_PX - 10 and 10 < v < HEIGHT_PX - 10
    ]


def _outcome(instrument: PlanarInstrument, discs: Sequence[Disc], pose: Pose) -> str:
    leds = instrument.identify(discs)
    solved = instrument.solve(leds) if isinstance(leds, Leds) else leds
    if not isinstance(solved, dict):
        return "refused"
    off = np.array([solved[key].value for key in KEYS]) - pose
    sigma = np.array([solved[key].sigma for key in KEYS], dtype=np.float64)
    off[2] = wrapped_deg(off[2])
    return "wrong" if np.any(np.abs(off) > 6.0 * sigma + 0.02) else "right"


_Planar = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], Pose]
"""Pose of corners (n, 2) mm imaged at (n, 2) px, in the plane of others (m, 2) mm imaged at (m, 2) px."""


def print_photographs() -> None:
    """Print the errors of poses of seven corners in the plane of the others, by method."""
    views = []
    for path in sorted(PHOTOGRAPHS.glob("left*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None  # noqa: S101  a file of ../shared
        found, corners = cv2.findChessboardCornersSB(image, (7, 5), flags=cv2.CALIB_CB_ACCURACY)
        if found:
            views.append(np.asarray(corners, dtype=np.float64).reshape(-1, 2))
            size = image.shape[1], image.shape[0]
    if not views:
        print(f"no photographs in {PHOTOGRAPHS}")
        return
    errors: dict[str, list[FloatArray]] = defaultdict(list)
    rng = np.random.default_rng(24)
    for number, view in enumerate(views):
        methods = _methods(size, [other for at, other in enumerate(views) if at != number])
        for _ in range(GROUPS):
            group = rng.permutation(len(BOARD_MM))[:IN_GROUP]
            rest = np.setdiff1d(np.arange(len(BOARD_MM)), group)
            for name, pose_of in methods.items():
                pose = pose_of(BOARD_MM[group], view[group], BOARD_MM[rest], view[rest])
                # of the group's middle: the plate's origin is a corner of the board, at a lever arm
                middle = BOARD_MM[group].mean(axis=0)
                turned = np.array([-middle[1], middle[0]]) * math.radians(pose[2])
                errors[name].append(np.array([*(np.array(pose[:2]) + turned), pose[2]]))
    count = len(views) * GROUPS
    print(f"{len(views)} photographs, {count} poses of {IN_GROUP} corners; squares of {SQUARE_MM:g} mm")
    table = Columns("method:<52", "rms a mm:>8.3f", "b mm:>8.3f", "phi °:>8.3f")
    print(table.head)
    for name, of_method in errors.items():
        print(table.row(name, *np.sqrt(np.mean(np.square(of_method), axis=0))))


def _methods(size: tuple[int, int], others: Sequence[FloatArray]) -> dict[str, _Planar]:
    """Methods: ours from one photograph; OpenCV's with its camera from the other photographs, or this one."""
    of_others = _camera([BOARD_MM] * len(others), others, size)

    def homography(at: FloatArray, px: FloatArray, rest: FloatArray, rest_px: FloatArray) -> Pose:
        camera = homography_camera(fit_homography(rest_px, rest), rest, size)
        return rigid_pose(at, camera.to_mm(px))

    def lens(at: FloatArray, px: FloatArray, rest: FloatArray, rest_px: FloatArray) -> Pose:
        return rigid_pose(at, lens_camera(rest, rest_px, size).to_mm(px))

    def in_plane(flag: int, camera: tuple[Any, Any] | None = of_others) -> _Planar:
        def pose_of(at: FloatArray, px: FloatArray, rest: FloatArray, rest_px: FloatArray) -> Pose:
            matrix, distortion = camera or _camera([rest], [rest_px], size)
            turn, shift = _pnp(flag, rest, rest_px, matrix, distortion)
            rays = cv2.undistortPoints(px.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
            plane = np.column_stack([turn[:, :2], shift])
            at_plane = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(plane).T
            return rigid_pose(at, at_plane[:, :2] / at_plane[:, 2:] * (1.0, -1.0))

        return pose_of

    def in_space(flag: int) -> _Planar:
        def pose_of(at: FloatArray, px: FloatArray, rest: FloatArray, rest_px: FloatArray) -> Pose:
            turn, shift = _pnp(flag, rest, rest_px, *of_others)
            own_turn, own_shift = _pnp(flag, at, px, *of_others)
            moved = (_in_space(at) @ own_turn.T + own_shift - shift) @ turn
            return rigid_pose(at, np.asarray(moved[:, :2] * (1.0, -1.0), dtype=np.float64))

        return pose_of

    return {
        "altd, homography": homography,
        "altd, lens": lens,
        "OpenCV solvePnP of the others, in their plane": in_plane(cv2.SOLVEPNP_ITERATIVE),
        "OpenCV IPPE of the others, in their plane": in_plane(cv2.SOLVEPNP_IPPE),
        "OpenCV solvePnP, camera from these others": in_plane(cv2.SOLVEPNP_ITERATIVE, None),
        "OpenCV solvePnP of both, in space": in_space(cv2.SOLVEPNP_ITERATIVE),
        "OpenCV IPPE of both, in space": in_space(cv2.SOLVEPNP_IPPE),
    }


def _camera(
    boards_mm: Sequence[FloatArray], views_px: Sequence[FloatArray], size: tuple[int, int]
) -> tuple[Any, Any]:
    """OpenCV's camera matrix and distortion (k1, k2, p1, p2)."""
    none: Any = None
    boards = [_in_space(board) for board in boards_mm]
    views = [view.astype(np.float32) for view in views_px]
    return cv2.calibrateCamera(boards, views, size, none, none, flags=cv2.CALIB_FIX_K3)[1:3]


def _pnp(
    flag: int, at_mm: FloatArray, px: FloatArray, matrix: Any, distortion: Any
) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) of a plane whose points (n, 2) mm are imaged at (n, 2) px."""
    _, turn, shift = cv2.solvePnP(_in_space(at_mm), px, matrix, distortion, flags=flag)
    return np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64), np.asarray(shift, dtype=np.float64).ravel()


def _in_space(board_mm: FloatArray) -> Any:
    """Points of the board in space, y downwards."""
    return np.column_stack([board_mm[:, 0], -board_mm[:, 1], np.zeros(len(board_mm))]).astype(np.float32)


def main(argv: Sequence[str] | None = None) -> int:
    """Print all three tables."""
    parser = Parser("benchmarks.planar", __doc__)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(SEEDS), help="of the simulated plates")
    parser.count("--poses", 100, "among false lights, of each seed")
    arguments = parser.parse_args(argv)
    if arguments.seeds:
        calibrations = print_simulated(arguments.seeds)
        print_false_lights(calibrations, arguments.poses)
    print_photographs()
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.planar")
