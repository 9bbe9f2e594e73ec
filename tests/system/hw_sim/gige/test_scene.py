"""The cameras' pictures, against the truth that a unit of the same seed knows in this process."""

import time

import cv2
import numpy as np
import pytest
from support.gige_unit import Client, Received, Served, client, served

from hw_sim.gige.command import make_unit
from hw_sim.targets import LED_POSITIONS_MM
from hw_sim.unit import CAMERAS, EXPOSURES_MS, FRONT, REAR, Unit

SEED = 5
Z_MM = {FRONT: 0.0, REAR: 280.0}


@pytest.fixture(scope="module")
def driven_unit() -> Unit:
    return make_unit(SEED, drive=True)


def middle(pixels: np.ndarray, box: tuple[slice, slice]) -> np.ndarray:
    """(u, v) of the spot within a fixed box, by plain moments of what is over a fifth of the peak."""
    even = cv2.GaussianBlur(cv2.medianBlur(pixels, 3), (0, 0), 3.0)[box].astype(float)
    even -= np.median(even)
    even = np.maximum(even - 0.2 * even.max(), 0.0)
    v, u = np.mgrid[box]
    return np.array([(even * u).sum(), (even * v).sum()]) / even.sum()


def box_around(u: float, v: float, half: int = 55) -> tuple[slice, slice]:
    return slice(round(v) - half, round(v) + half + 1), slice(round(u) - half, round(u) + half + 1)


def projected(unit: Unit, camera: str, t_ns: float) -> np.ndarray:
    """The place of the beam in a camera's picture at an instant of the monotonic clock, (u, v)."""
    u, v = unit.imagers[camera].view.lens.project(*unit.truth(round(t_ns)).at(Z_MM[camera]))
    return np.array([float(u), float(v)])


def monotonic_ns(frame: Received) -> int:
    """When the frame's exposure began, on the clock that this process shares with the server."""
    return frame.timestamp_ns - utc_minus_monotonic_ns()


def utc_minus_monotonic_ns() -> int:
    """Of the try in which least time passed between the clocks' readings: a busy machine parts them."""
    tries = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(10)]
    before_ns, utc_ns, after_ns = min(tries, key=lambda one: one[2] - one[0])
    return utc_ns - (before_ns + after_ns) // 2


def test_the_spots_are_where_the_truth_says_in_separate_processes_and_within_a_millisecond(
    driven_unit: Unit,
) -> None:
    arguments = ("--seed", str(SEED), "--drive")
    with (
        served(*arguments, "--only", FRONT) as front_server,
        served(*arguments, "--only", REAR) as rear_server,
        client(front_server.front) as front,
        client(rear_server.rear) as rear,
    ):
        held = {FRONT: front, REAR: rear}
        frames: dict[str, list[tuple[int, np.ndarray]]] = {camera: [] for camera in CAMERAS}
        for camera in CAMERAS:
            held[camera].set(PixelFormat="Mono12")
            held[camera].start()
        for _ in range(100):
            for camera in CAMERAS:
                frame = held[camera].frame()
                frames[camera].append((monotonic_ns(frame), frame.pixels))
    for camera in CAMERAS:
        half_ns = 0.5e6 * EXPOSURES_MS[camera]
        middles_ns = [began_ns + half_ns for began_ns, _ in frames[camera]]
        truth = np.array([projected(driven_unit, camera, t_ns) for t_ns in middles_ns])
        assert np.ptp(truth, axis=0).max() > 1.0  # or it stood still
        box = box_around(*truth.mean(axis=0))
        off = np.array([middle(pixels, box) for _, pixels in frames[camera]]) - truth
        assert np.abs(off.mean(axis=0)).max() < 0.7  # effect of grain and dots on moments
        off -= off.mean(axis=0)
        step_ns = 1e5
        later = np.array([projected(driven_unit, camera, t_ns + step_ns) for t_ns in middles_ns])
        px_per_ms = (later - truth) / (1e-6 * step_ns)
        late_ms = (px_per_ms * off).sum() / (px_per_ms**2).sum()
        assert off.std() < 0.25
        assert abs(late_ms) < 0.4


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


def spot_light(unit: Unit, camera: str, pixels: np.ndarray) -> float:
    """Peak over background, smoothed, where the beam of ``--pose`` 0 0 0 0 is."""
    u, v = (float(x) for x in unit.imagers[camera].view.lens.project(0.0, 0.0))
    part = cv2.GaussianBlur(pixels, (0, 0), 4.0)[box_around(u, v)]
    return float(part.max()) - float(np.median(part))


def peaks_apart_px(frames: list[np.ndarray]) -> float:
    """Largest distance of the frames' smoothed peaks."""
    peaks = [cv2.minMaxLoc(cv2.GaussianBlur(pixels, (0, 0), 8.0))[3] for pixels in frames]
    return float(np.ptp(peaks, axis=0).max())


def test_faults_and_a_vibration_come_and_go_by_lines_on_standard_input(driven_unit: Unit) -> None:
    with (
        served("--seed", str(SEED), "--faults", "front_spot_missing", "--listen") as cameras,
        client(cameras.front) as front,
        client(cameras.rear) as rear,
    ):
        said_to, said_by = cameras.process.stdin, cameras.process.stderr
        assert said_to is not None
        assert said_by is not None

        def fault(names: str) -> None:
            """Once this is back the fault is there: the cameras have refused what came behind it."""
            said_to.write(f"{names}\ngremlins\n")
            said_to.flush()
            assert "'gremlins'" in said_by.readline()

        def lit(held: Client, camera: str) -> bool:
            return spot_light(driven_unit, camera, held.take(1)[0].pixels) > 30.0

        assert (lit(front, FRONT), lit(rear, REAR)) == (False, True)
        fault("no_laser")
        assert (lit(front, FRONT), lit(rear, REAR)) == (False, False)
        fault("")
        assert (lit(front, FRONT), lit(rear, REAR)) == (True, True)
        at_rest = [frame.pixels for frame in front.take(3)]
        fault("line 3.3 8")
        vibrating = [frame.pixels for frame in front.take(8)][-3:]
        assert [peaks_apart_px(frames) > 3.0 for frames in (at_rest, vibrating)] == [False, True]
        fault("rear_silent")
        front.start()
        rear.start()
        assert rear.next(within_us=500_000) is None
        assert front.next() is not None
        fault("out_of_step")
        next_exposure(rear)
        later_ns = rear.frame().timestamp_ns - next_exposure(front).timestamp_ns
        assert 15e6 < later_ns % 50e6 < 35e6
        fault("dropped_frames")
        numbers = [next_exposure(front).number] + [front.frame().number for _ in range(60)]
        assert 60 < (numbers[-1] - numbers[0]) % 65535 < 120  # one in five, 15 of 75
        assert front.next() is not None
