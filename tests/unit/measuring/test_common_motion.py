"""Motion of all spots at once: a shock, and the lag of the second spot when a rigid motion starts."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.located import SPOT, located

from altd.devices.trigger_times import TriggerTimes
from altd.measuring.shock import ShockWatch
from altd.measuring.start_of_motion import StartOfMotion
from altd.reasons import Reason
from altd.records import NoSpot

PERIOD_NS = 50_000_000
Path = Callable[[str, float], float]


PX_PER_MM = {"front": 4.0, "rear": 4.0}


def shocks(
    path: Path, lost: tuple[int, ...] = (), seconds: float = 3.0, px_per_mm: Mapping[str, float] = PX_PER_MM
) -> list[int]:
    """The numbers of the exposures with which a shock is seen; ``path`` gives u of a camera at a second."""
    watch = ShockWatch(px_per_mm)
    found = []
    for number in range(round(seconds * 20)):
        for camera in ("front", "rear"):
            one = located(camera, number, number * PERIOD_NS + (camera == "rear") * 20_000_000)
            spot = replace(SPOT, u_px=path(camera, number * 0.05))
            lost_now = number in lost
            one = replace(one, spot=NoSpot(Reason.SPOT_MISSING) if lost_now else spot)
            if watch.is_shock(one):
                found.append(number)
    return found


def jump_px(at_s: float, px: float) -> Callable[[float], float]:
    return lambda t_s: 300.0 + (px if t_s >= at_s else 0.0)


@pytest.mark.parametrize(
    ("jumps", "lost", "seen"),
    [
        ([(1.0, 12.0)], (), [20]),
        ([(1.0, 12.0), (2.0, -15.0)], (), [20, 40]),
        ([(1.0, 50.0)], tuple(range(15, 25)), []),
    ],
    ids=["one", "two", "while the beam was away"],
)
def test_each_jump_of_all_spots_is_a_shock(
    jumps: list[tuple[float, float]], lost: tuple[int, ...], seen: list[int]
) -> None:
    def path(_: str, t_s: float) -> float:
        return 300.0 + sum(px for at_s, px in jumps if t_s >= at_s)

    assert shocks(path, lost) == seen


@pytest.mark.parametrize(("mm", "seen"), [(1.8, []), (2.6, [20])])
@pytest.mark.parametrize("resolution", [0.5, 1.0, 2.0])
def test_a_shock_is_one_on_the_targets_whatever_the_cameras_resolve(
    resolution: float, mm: float, seen: list[int]
) -> None:
    px_per_mm = {"front": 3.5 * resolution, "rear": 3.7 * resolution}

    def path(camera: str, t_s: float) -> float:
        return 300.0 + (px_per_mm[camera] * mm if t_s >= 1.0 else 0.0)

    assert shocks(path, px_per_mm=px_per_mm) == seen


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(lambda camera, t_s: 300 + 120.0 * t_s, id="steady motion, 30 mm/s"),
        pytest.param(lambda camera, t_s: 300 + 1.5 * math.sin(2 * math.pi * 7.3 * t_s), id="vibration"),
        pytest.param(
            lambda camera, t_s: jump_px(1.0, 12.0)(t_s) if camera == "rear" else 300.0, id="one spot alone"
        ),
        pytest.param(
            lambda camera, t_s: jump_px(1.0 + (camera == "rear"), 12.0)(t_s), id="one after the other"
        ),
    ],
)
def test_what_is_no_shock(path: Path) -> None:
    assert shocks(path) == []


def test_vibration_between_uneven_frames_is_no_shock() -> None:
    """Of 0.45 mm at 40 Hz: extrapolated over a long interval from a short one it doubles its size."""
    watch = ShockWatch(PX_PER_MM)
    found = set()
    for number, t_ns in enumerate(frame_times_ns(False, 2000)):
        spot = replace(SPOT, u_px=300.0 + 1.8 * math.sin(2 * math.pi * 40.3 * t_ns * 1e-9))
        found |= {
            watch.is_shock(replace(located(camera, number, t_ns), spot=spot)) for camera in ("front", "rear")
        }
    assert found == {False}


NOISE_PX = np.full(4, 0.05)


def frame_times_ns(is_even: bool, count: int = 160) -> list[int]:
    """The instants of a camera that runs freely, or of software triggers."""
    triggers, times_ns = TriggerTimes(PERIOD_NS, 0), [0]
    while len(times_ns) < count:
        times_ns.append(times_ns[-1] + PERIOD_NS if is_even else triggers.after(times_ns[-1]))
    return times_ns


def verdict(
    of_time: Callable[[float], float], by_px: list[float], late: int, seed: int, is_even: bool = True
) -> int | str | None:
    """The first lag that is decided; ``by_px`` (4,) are the spots' displacements for a motion of 1."""
    rng, start = np.random.default_rng(seed), StartOfMotion()
    times_ns = frame_times_ns(is_even)
    for number in range(5, 155):
        now, then = (of_time(1e-9 * times_ns[number - delay] - 3.01) for delay in (0, late))
        places = np.array(by_px) * [now, now, then, then] + rng.normal(0, NOISE_PX)
        if (lag := start.add(places, NOISE_PX, times_ns[number])) is not None:
            return lag
    return "open" if start.is_open else None


def jerk(t_s: float) -> float:
    return max(t_s, 0.0) ** 3


def jump(t_s: float) -> float:
    return max(t_s, 0.0)


def sway(t_s: float) -> float:
    return float(1 - np.cos(4 * max(t_s, 0.0)))


@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("late", [-3, -1, 0, 1, 2, 3])
@pytest.mark.parametrize("course", [jerk, jump, sway])
@pytest.mark.parametrize("by_px", [[8.0, 30.0, -9.0, 28.0], [5.0, -9.0, 40.0, 2.0], [-20.0, 0.0, 0.0, 20.0]])
def test_one_motion_shows_the_lag(
    by_px: list[float], course: Callable[[float], float], late: int, is_even: bool
) -> None:
    assert [verdict(course, by_px, late, seed, is_even) for seed in range(3)] == [late] * 3


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("by_px", [[0.0, 0.0, 8.0, 30.0], [8.0, 30.0, 0.0, 0.0], [0.3, 0.2, 0.2, 0.4]])
def test_spots_of_which_one_rests_or_both_creep_show_none(by_px: list[float], late: int) -> None:
    assert {verdict(jump, by_px, late, seed) for seed in range(5)} <= {"open", None}


@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("delay_s", [0.02, 0.2])
def test_a_yaw_that_begins_later_than_the_shift_is_no_lag(delay_s: float, is_even: bool) -> None:
    """The second spot moves with the first one at once, and faster from then on."""
    for seed in range(5):
        rng, start, lags = np.random.default_rng(seed), StartOfMotion(), []
        for t_ns in frame_times_ns(is_even):
            shift, yaw = (jump(1e-9 * t_ns - 3.01 - since_s) for since_s in (0.0, delay_s))
            places = np.array([20.0, 10.0, 20.0, 10.0]) * shift + np.array([0.0, 0.0, 15.0, 0.0]) * yaw
            lags.append(start.add(places + rng.normal(0, NOISE_PX), NOISE_PX, t_ns))
        assert set(lags) <= {None, 0}


def test_without_enough_rest_nothing_is_decided() -> None:
    start = StartOfMotion()
    rng = np.random.default_rng(1)
    places = [np.full(4, 20.0 * jump(0.05 * n - 0.5)) + rng.normal(0, NOISE_PX) for n in range(60)]
    assert {start.add(each, NOISE_PX, n * PERIOD_NS) for n, each in enumerate(places)} == {None}
    assert not start.is_open
