import cv2
import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig


def smoothed(unit: Unit, camera: str, sequence: int = 0) -> npt.NDArray[np.float32]:
    """A frame less its median, hot pixels and dots smoothed away."""
    pixels = unit.expose(camera, sequence, 0).pixels.astype(np.float32)
    even = cv2.GaussianBlur(cv2.medianBlur(pixels, 3) if camera == REAR else pixels, (0, 0), 4.0)
    return np.asarray(even - np.median(even), dtype=np.float32)


def spots(unit: Unit, camera: str) -> list[tuple[int, int]]:
    """(u, v) of the middles of all that shines out, for a crude look from outside."""
    bright = (smoothed(unit, camera) > 8.0).astype(np.uint8)
    _, _, _, middles = cv2.connectedComponentsWithStats(bright)
    return [(round(u), round(v)) for u, v in middles[1:]]


def test_quick_frames_have_the_mean_and_the_noise_of_exact_ones(unit: Unit) -> None:
    for camera in CAMERAS:
        quick, exact = (
            np.stack([unit.expose(camera, k, 0, exact=drawn).pixels for k in range(12)]).astype(np.float64)
            for drawn in (False, True)
        )
        assert quick.mean() == pytest.approx(exact.mean(), rel=0.003)
        assert quick.var(axis=0).mean() == pytest.approx(exact.var(axis=0).mean(), rel=0.02)


def test_the_signal_goes_with_exposure_times_gain(unit: Unit) -> None:
    unit.inject(Fault.NO_LASER)

    def level(exposure_ms: float, gain: float) -> float:
        unit.set_camera(REAR, exposure_ms=exposure_ms, gain=gain)
        return float(unit.expose(REAR, 0, 0).pixels[100:300, 200:500].mean()) - 4.08

    once = level(1.0, 1.0)
    assert level(4.0, 1.0) == pytest.approx(4.0 * once, rel=0.03)
    assert level(1.0, 4.0) == pytest.approx(4.0 * once, rel=0.03)


def test_frames_are_read_only_and_carry_what_they_are(unit: Unit) -> None:
    unit.leds_on = True
    frame = unit.expose(REAR, 8, 123)
    assert (frame.camera, frame.sequence, frame.t_ns, frame.bits, frame.leds_on) == (REAR, 8, 123, 8, True)
    with pytest.raises(ValueError, match="read-only"):
        frame.pixels[0, 0] = 1


def test_each_target_has_leds_of_its_own(unit: Unit) -> None:
    unit.switch_leds(REAR, True)
    assert (len(spots(unit, FRONT)), len(spots(unit, REAR))) == (1, 7)
    assert not unit.expose(FRONT, 0, 0).leds_on
    assert unit.expose(REAR, 0, 0).leds_on
    unit.leds_on = True
    unit.switch_leds(REAR, False)
    assert (len(spots(unit, FRONT)), len(spots(unit, REAR))) == (7, 1)


def test_a_frame_that_has_grown_takes_the_rear_target_further_along_the_beam() -> None:
    near, far = (Unit(UnitConfig(seed=2, expansion=expansion)) for expansion in (0.0, 0.1))
    for unit in (near, far):
        unit.place(BeamPose(0.0, 0.0, 0.1, 0.12))
    assert np.array_equal(near.expose(FRONT, 0, 0).pixels, far.expose(FRONT, 0, 0).pixels)
    lens = far.imagers[REAR].view.lens
    for unit, along_mm in ((near, 280.0), (far, 308.0)):
        u, v = lens.project(0.1 * along_mm, 0.12 * along_mm)
        assert spots(unit, REAR) == [(pytest.approx(u, abs=2.0), pytest.approx(v, abs=2.0))]


@pytest.mark.parametrize(
    ("fault", "front", "rear"),
    [
        (Fault.NO_LASER, 0, 0),
        (Fault.FRONT_SPOT_MISSING, 0, 1),
        (Fault.REAR_SPOT_MISSING, 1, 0),
        (Fault.FRONT_SECOND_SPOT, 2, 1),
        (Fault.REAR_SECOND_SPOT, 1, 2),
        (Fault.LEDS_ON, 7, 7),
    ],
)
def test_a_fault_changes_what_shines(unit: Unit, fault: Fault, front: int, rear: int) -> None:
    unit.inject(fault)
    assert (len(spots(unit, FRONT)), len(spots(unit, REAR))) == (front, rear)
    unit.clear(fault)
    assert (len(spots(unit, FRONT)), len(spots(unit, REAR))) == (1, 1)


def test_dark_leds_are_not_confessed_either(unit: Unit) -> None:
    unit.inject(Fault.LEDS_DARK)
    unit.leds_on = True
    frame = unit.expose(FRONT, 0, 0)
    unit.leds_on = False
    assert frame.leds_on
    assert len(spots(unit, FRONT)) == 1
    assert np.array_equal(frame.pixels, unit.expose(FRONT, 0, 0).pixels)


def test_a_light_that_blinks_by_itself_comes_and_goes_with_its_fault(unit: Unit) -> None:
    def seen() -> set[int]:
        u, v = (round(float(part)) for part in unit.imagers[FRONT].view.lens.project(-40.0, 30.0))
        frames = [unit.expose(FRONT, number, 0).pixels[v - 2 : v + 3, u - 2 : u + 3] for number in range(20)]
        return {round(float(pixels.mean()) > 60.0) for pixels in frames}

    assert seen() == {0}
    unit.inject(Fault.FRONT_BLINKING_LIGHT)
    assert seen() == {0, 1}
    unit.clear()
    assert seen() == {0}


def test_a_blow_moves_the_spots_of_all_targets_together(unit: Unit) -> None:
    before = [spots(unit, camera)[0] for camera in CAMERAS]
    unit.inject(Fault.PUSHED_ASIDE)
    after = [spots(unit, camera)[0] for camera in CAMERAS]
    for camera, (u, v), (u_after, v_after) in zip(CAMERAS, before, after, strict=True):
        lens = unit.imagers[camera].view.lens
        (x_mm, y_mm), (x_after, y_after) = lens.unproject(u, v), lens.unproject(u_after, v_after)
        assert (x_after - x_mm, y_after - y_mm) == (pytest.approx(5.0, abs=0.6), pytest.approx(0.0, abs=0.6))
