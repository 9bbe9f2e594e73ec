"""The cameras' pictures, against the truth that a unit of the same seed knows in this process."""

import time

import cv2
import numpy as np
import pytest
from support.gige_unit import Client, Received, Served, client, served

from hw_sim.gige.command import make_unit
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import CAMERAS, Unit

SEED = 5


@pytest.fixture(scope="module")
def driven_unit() -> Unit:
    return make_unit(SEED, drive=True)


def bright_leds(unit: Unit, camera: str, pixels: np.ndarray) -> int:
    """The number of the LEDs' places that are far brighter than their surroundings."""
    count = 0
    for place in LED_POSITIONS_MM:
        u, v = (round(float(x)) for x in unit.imagers[camera].view.lens.project(*place))
        around = pixels[max(v - 20, 0) : v + 21, max(u - 20, 0) : u + 21]
        count += float(pixels[v - 2 : v + 3, u - 2 : u + 3].mean()) > float(np.median(around)) + 60.0
    return count


def leds_after(unit: Unit, held: Client, camera: str, **features: bool | str) -> int:
    """The LEDs in the very next exposure after features were set."""
    held.set(**features)
    return bright_leds(unit, camera, next_exposure(held).pixels)


def next_exposure(held: Client) -> Received:
    """The first frame whose exposure has not begun yet."""
    now_ns = time.time_ns()
    while (frame := held.frame()).timestamp_ns < now_ns:
        pass
    return frame


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_cameras_output_lights_the_leds_around_its_own_target_in_the_next_exposure(
    unit_at_rest: Served, driven_unit: Unit, camera: str
) -> None:
    (other,) = set(CAMERAS) - {camera}
    with client(getattr(unit_at_rest, camera)) as own, client(getattr(unit_at_rest, other)) as others:
        others.set(UserOutputValue=False)  # whatever the test before this one left
        own.start()
        for on in (True, False, True):
            assert leds_after(driven_unit, own, camera, UserOutputValue=on) == (6 if on else 0)
        others.start()
        others.frame()
        own.frame()
        for _ in range(20):
            assert bright_leds(driven_unit, camera, own.frame().pixels) == 6
            assert bright_leds(driven_unit, other, others.frame().pixels) == 0
        own.set(LineSelector="Line1")
        assert leds_after(driven_unit, own, camera, LineMode="Input") == 0
        assert leds_after(driven_unit, own, camera, LineMode="Output") == 6
        assert leds_after(driven_unit, own, camera, LineSource="UserOutput1") == 0
        own.set(UserOutputSelector="UserOutput1")
        assert leds_after(driven_unit, own, camera, UserOutputValue=True) == 6
        own.set(UserOutputValue=False, LineSource="UserOutput0", UserOutputSelector="UserOutput0")
        assert leds_after(driven_unit, own, camera, UserOutputValue=False) == 0


def peaks_apart_px(frames: list[np.ndarray]) -> float:
    """Largest distance of the frames' smoothed peaks."""
    peaks = [cv2.minMaxLoc(cv2.GaussianBlur(pixels, (0, 0), 8.0))[3] for pixels in frames]
    return float(np.ptp(peaks, axis=0).max())


def test_faults_and_a_vibration_come_and_go_by_lines_on_standard_input() -> None:
    with (
        served("--seed", str(SEED), "--faults", "front_spot_missing", "--listen") as cameras,
        client(cameras.front) as front,
        client(cameras.rear) as rear,
    ):
        said_to, said_by = cameras.process.stdin, cameras.process.stderr
        assert said_to is not None
        assert said_by is not None

        def lit(camera: Client) -> bool:
            smooth = cv2.GaussianBlur(cv2.medianBlur(camera.take(1)[0].pixels, 3), (0, 0), 4.0)
            return float(smooth.max()) - float(np.median(smooth)) > 30.0

        assert (lit(front), lit(rear)) == (False, True)
        for faults, seen in (("no_laser", False), ("", True)):
            said_to.write(f"{faults}\ngremlins\n")
            said_to.flush()
            assert "'gremlins'" in said_by.readline()  # the cameras have refused what came behind the faults
            assert (lit(front), lit(rear)) == (seen, seen)
        at_rest = [frame.pixels for frame in front.take(3)]
        said_to.write("line nan 8\nline 3.3 8\ngremlins\n")
        said_to.flush()
        assert "line nan 8: is no vibration" in said_by.readline()
        assert "'gremlins'" in said_by.readline()
        vibrating = [frame.pixels for frame in front.take(8)][-3:]
        assert [peaks_apart_px(frames) > 3.0 for frames in (at_rest, vibrating)] == [False, True]
