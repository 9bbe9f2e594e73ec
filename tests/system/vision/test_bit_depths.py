"""The same light on chips that are read with 8 to 16 bits: how far the position depends on the depth."""

import numpy as np
import pytest

from altd.measuring.calibration import Calibration
from altd.records import Spot
from altd.vision.localise import locate
from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

DEPTHS = (8, 10, 12, 16)
EXPOSURES = 16
POSES = (BeamPose(0.0, 0.0), BeamPose(30.3, 20.7, 0.05, 0.02), BeamPose(-41.2, 11.3, -0.03, 0.08))


@pytest.fixture(scope="module")
def units() -> dict[int, Unit]:
    return {bits: Unit(UnitConfig(seed=3, bits=bits)) for bits in DEPTHS}


@pytest.fixture(scope="module")
def off_px(units: dict[int, Unit], calibration_of_unit_3: Calibration) -> dict[str, np.ndarray]:
    """Positions less those with 16 bits, by camera: (8, 10, 12 bits; poses; exposures; u, v)."""
    targets = {target.name: target for target in calibration_of_unit_3.targets}

    def at(camera: str, bits: int, pose: BeamPose, sequence: int) -> tuple[float, float]:
        units[bits].place(pose)
        taken = units[bits].expose(camera, sequence, 0, exact=True)
        spot = locate(taken, targets[camera].localiser, targets[camera].flat)
        assert isinstance(spot, Spot)
        return spot.u_px, spot.v_px

    numbers = range(EXPOSURES)
    found = {
        camera: np.array(
            [[[at(camera, bits, pose, n) for n in numbers] for pose in POSES] for bits in DEPTHS]
        )
        for camera in CAMERAS
    }
    return {camera: places[:-1] - places[-1] for camera, places in found.items()}


def test_the_depths_see_the_same_electrons(units: dict[int, Unit]) -> None:
    frames = {bits: unit.expose(FRONT, 7, 0, exact=True) for bits, unit in units.items()}
    shares = {bits: taken.pixels / taken.full_scale for bits, taken in frames.items()}
    for bits, share in shares.items():
        assert np.abs(share - shares[16]).max() <= 0.5 / frames[bits].full_scale + 1e-4


@pytest.mark.parametrize("camera", [FRONT, REAR])
def test_what_is_measured_is_the_same_within_a_hundredth_of_a_pixel(
    camera: str, off_px: dict[str, np.ndarray]
) -> None:
    """The mean of a window; one of 16 exposures, the daemon takes 20."""
    assert np.hypot(*np.moveaxis(off_px[camera].mean(axis=2), -1, 0)).max() <= 0.01


@pytest.mark.parametrize("camera", [FRONT, REAR])
@pytest.mark.parametrize(("bits", "limit_px"), [(8, 0.012), (10, 0.005), (12, 0.002)])
def test_a_single_frame_differs_by_what_rounding_adds(
    bits: int, limit_px: float, camera: str, off_px: dict[str, np.ndarray]
) -> None:
    """Rounding to 8 bits is noise of 0.29 counts beside 0.68 counts of the read-out: rms over u and v."""
    off = off_px[camera][DEPTHS.index(bits)]
    assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) <= limit_px
