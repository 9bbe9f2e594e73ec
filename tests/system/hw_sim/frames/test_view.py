from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.beam import BeamPose, Footprint, Laser, footprint
from hw_sim.lens import Lens
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import FRONT, REAR, Unit
from hw_sim.view import ELECTRONS_PER_EXPOSURE, INK_REFLECTANCE

Projection = Callable[[Lens, npt.ArrayLike], npt.NDArray[np.float64]]

LASER = Laser(diameters_mm=(10.0, 8.0), angle_rad=0.4)
POSES = [BeamPose(0.0, 0.0), BeamPose(-45.0, 30.0), BeamPose(50.0, -35.0), BeamPose(10.0, -8.0, 0.1, 0.2)]


def light(
    unit: Unit, camera: str, spots: list[Footprint], *, leds_on: bool = False
) -> npt.NDArray[np.float64]:
    """Mean electrons of a frame: no noise."""
    imager = unit.imagers[camera]
    return imager.mean_e(spots, leds_on, imager.settings.exposure_ms).astype(np.float64)


def first_moment(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    rows, columns = np.indices(image.shape)
    return np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()


def expected_moment(lens: Lens, pose: BeamPose, z_mm: float, project: Projection) -> npt.NDArray[np.float64]:
    """The picture's first moment by integrating over the target, in mm, through OpenCV's camera.

    A pixel's light is the target's radiance times cos⁴; so a patch of the target counts with the area
    that it has in the picture.
    """
    direction = np.array([pose.slope_x, pose.slope_y, 1.0])
    direction /= np.linalg.norm(direction)
    axis = np.arange(-13.0, 13.0, 0.1)
    patch = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    offset = np.column_stack([patch, np.zeros(len(patch))])
    across = offset - np.outer(offset @ direction, direction)
    first = np.array([np.cos(LASER.angle_rad), np.sin(LASER.angle_rad), 0.0])
    first -= direction * (first @ direction)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    weight = np.exp(-2.0 * ((across @ first / 5.0) ** 2 + (across @ second / 4.0) ** 2))

    at = patch + pose.at(z_mm)
    step = 0.01
    pixels = project(lens, at)
    by_x = (project(lens, at + np.array([step, 0.0])) - pixels) / step
    by_y = (project(lens, at + np.array([0.0, step])) - pixels) / step
    weight *= np.abs(by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0])
    face = np.column_stack([-at[:, 0] if lens.mirrored else at[:, 0], -at[:, 1], np.zeros(len(at))])
    seen = face @ lens.rotation.T + lens.translation_mm
    weight *= (seen[:, 2] / np.linalg.norm(seen, axis=1)) ** 4
    return np.asarray((pixels * weight[:, None]).sum(axis=0) / weight.sum())


@pytest.mark.parametrize("pose", POSES)
def test_the_rear_spot_lies_where_opencv_and_an_integral_over_the_plate_put_it(
    pose: BeamPose, clean_unit: Unit, opencv_project: Projection
) -> None:
    lens = clean_unit.imagers[REAR].view.lens
    seen = first_moment(light(clean_unit, REAR, [footprint(LASER, pose, 280.0)]))
    assert np.abs(seen - expected_moment(lens, pose, 280.0, opencv_project)).max() < 0.002


def test_the_dots_of_the_front_spot_lie_around_the_same_place(
    clean_unit: Unit, opencv_project: Projection
) -> None:
    lens = clean_unit.imagers[FRONT].view.lens
    for pose in POSES:
        seen = first_moment(light(clean_unit, FRONT, [footprint(LASER, pose, 0.0)]))
        assert np.abs(seen - expected_moment(lens, pose, 0.0, opencv_project)).max() < 0.1


def test_dots_scatter_the_covered_share_of_the_light(clean_unit: Unit) -> None:
    """The hexagonal fill, π/(2√3)·(d/pitch)², of what a plain sheet of ink would scatter."""
    view = clean_unit.imagers[FRONT].view
    scattered = view.response / view.lens.relative_illumination(view.x_mm, view.y_mm)
    plain_ink = ELECTRONS_PER_EXPOSURE * INK_REFLECTANCE
    assert scattered.mean() / plain_ink == pytest.approx(np.pi / (2.0 * np.sqrt(3.0)) * 0.5**2, rel=0.003)


def test_the_frame_leds_shine_where_opencv_puts_them(clean_unit: Unit, opencv_project: Projection) -> None:
    for camera in (FRONT, REAR):
        lit = light(clean_unit, camera, [], leds_on=True)
        for u, v in opencv_project(clean_unit.imagers[camera].view.lens, LED_POSITIONS_MM):
            rows, columns = slice(round(v) - 14, round(v) + 15), slice(round(u) - 14, round(u) + 15)
            du, dv = first_moment(lit[max(rows.start, 0) : rows.stop, columns])
            assert columns.start + du == pytest.approx(u, abs=0.1)
            assert max(rows.start, 0) + dv == pytest.approx(v, abs=0.1)
        assert light(clean_unit, camera, []).max() == 0.0
