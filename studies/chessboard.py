"""Photographs of a chessboard through a real lens: the map at corners that it was not shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from altd.calibration.fitting import fit_nodes
from altd.errors import BadInputError
from altd.instruments.planar.homography import apply_homography, fit_homography
from altd.mapping.grid import convex_hull_mm
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import fit_tensor_map
from altd.records import FloatArray
from studies.bench import rms
from studies.plot import FOURTH, GREY, OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Chessboard: real photographs"
QUESTION = "How large is the error of a map at a corner that it was not fitted to, through a real lens?"

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "shared" / "data" / "chessboard"
"""left01.jpg … left07.jpg of OpenCV's sample data, 320 × 240; beside the checkout, not in it."""

CORNERS = (7, 5)
SQUARE_MM = 25.0
"""Any length will do: the errors are in pixels and in shares of a square."""
BOARD_MM = np.stack(np.meshgrid(np.arange(7.0), -np.arange(5.0)), axis=-1).reshape(-1, 2) * SQUARE_MM
RIM = (np.arange(35) % 7 % 6 == 0) | (np.arange(35) // 7 % 4 == 0)

MODELS = {
    "homography": GREY,
    "tensor polynomial 3 × 3": THESIS,
    "altd's map": OURS,
    "OpenCV camera, this photograph": FOURTH,
    "OpenCV camera, other photographs": THIRD,
}
"""The models to compare, and their colours."""
SHOWN = 0
"""The photograph whose errors are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class _Photo:
    name: str
    size: tuple[int, int]
    corners_px: FloatArray

    @property
    def square_px(self) -> float:
        """The mean distance of neighbours along a row."""
        return float(np.linalg.norm(np.diff(self.corners_px.reshape(5, 7, 2), axis=1), axis=2).mean())


def run(progress: Progress) -> Result:
    """Leave out every corner of every photograph in turn; raises BadInputError without photographs."""
    photos = _photographs()
    errors_px = {model: np.empty((len(photos), len(BOARD_MM), 2)) for model in MODELS}
    for index, photo in enumerate(photos):
        progress(f"chessboard: {photo.name}")
        others_px = [other.corners_px for other in photos if other is not photo]
        camera_of_others = _camera(others_px, photo.size)[:2]
        for corner in range(len(BOARD_MM)):
            for model, at_px in _predictions(photo, corner, camera_of_others).items():
                errors_px[model][index, corner] = at_px - photo.corners_px[corner]

    joint_rms_px = _camera([photo.corners_px for photo in photos], photos[0].size)[2]
    single_rms_px = float(np.mean([_camera([photo.corners_px], photo.size)[2] for photo in photos]))
    share = 100.0 / np.array([photo.square_px for photo in photos])[:, None]
    lengths_px = {model: np.linalg.norm(error_px, axis=2) for model, error_px in errors_px.items()}
    rows = tuple(
        Row(
            model,
            (
                float(error_px.mean()),
                rms(error_px),
                float(error_px.max()),
                float(error_px[:, ~RIM].mean()),
                float((error_px * share).mean()),
            ),
        )
        for model, error_px in lengths_px.items()
    )
    ours, flat, other = (rows[i].ours[0] for i in (2, 0, 4))
    return Result(
        of="model",
        thesis_source="none; the thesis tests its map on its own LED plate (Table 3.2)",
        columns=(
            Column("mean error, px"),
            Column("rms, px"),
            Column("largest, px", 3),
            Column("mean, inner corners, px"),
            Column("mean, % of a square", 3),
        ),
        rows=rows,
        headline=(
            f"At corners that it was not fitted to, altd's map errs by {ours:.3f} px on average, "
            f"a homography by {flat:.3f} px, OpenCV's camera from the other photographs by {other:.3f} px."
        ),
        text=f"""
Seven photographs of OpenCV's sample data (320 × 240) show a board of 8 × 6 squares, held by hand before a
real lens. `cv2.findChessboardCornersSB` finds its 7 × 5 inner corners. Each photograph is one plane and
one map, mm → px. Each corner is left out in turn, each model is fitted to the rest, and its pixel is
compared with the corner found: {7 * 35} errors a model. At the {int(RIM.sum())} corners on the rim this
extrapolates; *inner corners* are the others.

*homography*: Eq. 2.44–2.58 through the other 34 corners. *Tensor polynomial 3 × 3*: the thesis' map.
*altd's map*: chosen by cross-validation. *OpenCV camera, this photograph*: `cv2.calibrateCamera` on the
same 34 corners (without k3). *OpenCV camera, other photographs*: camera and distortion from all corners of
the six others, and the board's pose from these 34 (`cv2.solvePnP`).

The errors include those of the corners, some hundredths of a pixel, and of the board, which is paper. One
camera fits all seven photographs to {joint_rms_px:.3f} px rms, and each alone to {single_rms_px:.3f} px:
the board was not flat, or bent differently. Therefore the camera from the other photographs is worse here
than the models fitted to the photograph itself.
""",
        figure=_figure(photos, errors_px, lengths_px),
        caption="Mean error by photograph and model; errors over the board for the first photograph",
    )


def _predictions(photo: _Photo, corner: int, camera_of_others: tuple[Any, Any]) -> dict[str, FloatArray]:
    """The prediction of each model for a corner (2,) px that it was not shown."""
    kept_mm = np.delete(BOARD_MM, corner, axis=0)
    kept_px = np.delete(photo.corners_px, corner, axis=0)
    at_mm = BOARD_MM[corner : corner + 1]
    hull_mm = convex_hull_mm(kept_mm)
    alone = _camera([kept_px], photo.size, [kept_mm])[:2]
    predictions = (
        apply_homography(fit_homography(kept_mm, kept_px), at_mm)[0],
        fit_tensor_map(kept_mm, kept_px, hull_mm, (3, 3)).map.to_px(at_mm)[0],
        fit_nodes(Nodes.ordinary(kept_mm, kept_px), photo.size, 0).fit.map.to_px(at_mm)[0],
        _projected_px(alone, kept_mm, kept_px, at_mm),
        _projected_px(camera_of_others, kept_mm, kept_px, at_mm),
    )
    return dict(zip(MODELS, predictions, strict=True))


def _camera(
    views_px: Sequence[FloatArray], size: tuple[int, int], boards_mm: Sequence[FloatArray] | None = None
) -> tuple[Any, Any, float]:
    """OpenCV's camera matrix and distortion (k1, k2, p1, p2) from views of the board, and its rms in px."""
    boards = [_in_space(board) for board in boards_mm or [BOARD_MM] * len(views_px)]
    views = [view.astype(np.float32) for view in views_px]
    none: Any = None
    rms_px, matrix, distortion, _, _ = cv2.calibrateCamera(
        boards, views, size, none, none, flags=cv2.CALIB_FIX_K3
    )
    return matrix, distortion, rms_px


def _projected_px(
    camera: tuple[Any, Any], kept_mm: FloatArray, kept_px: FloatArray, at_mm: FloatArray
) -> FloatArray:
    """A board point (1, 2) through a known camera, the board's pose from its other corners: (2,) px."""
    _, turn, shift = cv2.solvePnP(_in_space(kept_mm), kept_px, *camera)
    turn, shift = cv2.solvePnPRefineLM(_in_space(kept_mm), kept_px, *camera, turn, shift)
    seen, _ = cv2.projectPoints(_in_space(at_mm), turn, shift, *camera)
    return np.asarray(seen.reshape(2), dtype=np.float64)


def _in_space(board_mm: FloatArray) -> Any:
    """Points of the board in space, y downwards."""
    return np.column_stack([board_mm[:, 0], -board_mm[:, 1], np.zeros(len(board_mm))]).astype(np.float32)


def _photographs() -> list[_Photo]:
    paths = sorted(PHOTOGRAPHS.glob("left*.jpg"))
    if not paths:
        raise BadInputError(PHOTOGRAPHS, "holds no photographs left*.jpg")
    photos = []
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise BadInputError(path, "is not an image that can be read")
        found, corners = cv2.findChessboardCornersSB(image, CORNERS, flags=cv2.CALIB_CB_ACCURACY)
        if not found:
            raise BadInputError(path, "shows no chessboard of 8 × 6 squares")
        size = image.shape[1], image.shape[0]
        photos.append(_Photo(path.name, size, np.asarray(corners, dtype=np.float64).reshape(-1, 2)))
    return photos


def _figure(
    photos: Sequence[_Photo], errors_px: dict[str, FloatArray], lengths_px: dict[str, FloatArray]
) -> Figure:
    figure, (bars, board) = panels(1, 2, width=9.6, height=4.2)
    at = np.arange(len(photos))
    for place, (model, colour) in enumerate(MODELS.items()):
        shift = (place - (len(MODELS) - 1) / 2) * 0.16
        bars.bar(at + shift, lengths_px[model].mean(axis=1), 0.15, color=colour, label=model)
    bars.set_xticks(at, [photo.name.removesuffix(".jpg") for photo in photos])
    bars.set(ylabel="mean error of a left-out corner, px", title="By photograph", ylim=(0.0, 0.36))
    bars.grid(visible=False, axis="x")
    bars.legend(loc="upper left", ncols=2, fontsize=7)
    photo = photos[SHOWN]
    board.plot(*photo.corners_px.T, ".", color="black", ms=3)
    for model in ("homography", "altd's map"):
        arrows = board.quiver(
            *photo.corners_px.T,
            *errors_px[model][SHOWN].T,
            color=MODELS[model],
            angles="xy",
            scale_units="xy",
            scale=0.02,
            width=0.006,
            label=f"{model}, 50 times",
        )
        arrows.set_zorder(3)
    board.invert_yaxis()
    board.set(xlabel="u, px", ylabel="v, px", title=f"Errors on {photo.name}")
    board.set_aspect("equal", adjustable="datalim")
    board.legend(loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure
