import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from altd.devices.trigger_times import TriggerTimes
from altd.measuring.synchrony import SynchronyCheck
from altd.reasons import Reason
from altd.records import FrameSet, NoSpot, Spot
from hw_sim.beam import BeamPose
from hw_sim.motion import SLOW_DRIVE, Vibration, make_path, make_vibration

PERIOD_NS = 50_000_000
MS = 1_000_000
Motion = Callable[[int], BeamPose]


def at_rest(_t_ns: int) -> BeamPose:
    return BeamPose(0.0, 0.0)


def shaking(seed: int, vibration: Vibration | None = None) -> Motion:
    """A machine on its way whose drive shakes it; yaw and pitch have motions of their own."""
    rng = np.random.default_rng(seed)
    shakes, drives = make_vibration(vibration or Vibration(), rng), make_path(SLOW_DRIVE, rng)
    return lambda t_ns: shakes.moved(drives.moved(BeamPose(0.0, 0.0), t_ns), t_ns)


def on_its_way(seed: int) -> Motion:
    drives = make_path(SLOW_DRIVE, np.random.default_rng(seed))
    return lambda t_ns: drives.moved(BeamPose(0.0, 0.0), t_ns)


@functools.cache
def triggered_ns() -> list[int]:
    """Instants of software triggers."""
    triggers, times_ns = TriggerTimes(PERIOD_NS, 0), [0]
    while len(times_ns) < 1300:
        times_ns.append(triggers.after(times_ns[-1]))
    return times_ns


def frame_sets(
    motion: Motion, late: int = 0, apart_ms: int = 0, count: int = 400, first: int = 0, is_even: bool = True
) -> Iterator[FrameSet]:
    """The cameras' pictures of it, the rear one's so many exposures late but stamped as if they
    were not. ``apart_ms``: the rear camera runs freely and exposes so much behind; its stamps show it."""
    rng = np.random.default_rng([first, count])
    for n in range(first, first + count):
        t_ns, then_ns = (k * PERIOD_NS if is_even else triggered_ns()[k + 8] for k in (n, n - late))
        one, other = motion(t_ns), motion(then_ns + apart_ms * MS)
        places = {
            "front": (375 - 4.1 * one.x_mm, 240 - 4.0 * one.y_mm),
            "rear": (
                370 + 3.6 * (other.x_mm + 280 * other.slope_x),
                250 - 3.5 * (other.y_mm + 280 * other.slope_y),
            ),
        }
        spots = {
            name: Spot(*(float(c + rng.normal(0, 0.04)) for c in place), 0.04, 44.0, 150.0)
            for name, place in places.items()
        }
        half_ns = apart_ms * MS // 2
        yield FrameSet(n, t_ns + half_ns, spots, {"front": -half_ns, "rear": half_ns})


def said(check: SynchronyCheck, seen: Iterator[FrameSet]) -> list[str]:
    return [check.inspect(frame_set) for frame_set in seen]


def fresh() -> SynchronyCheck:
    return SynchronyCheck(("front", "rear"))


@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("late", [1, 2, 4, -1])
def test_pictures_that_are_whole_frames_late_are_seen_within_ten_seconds(
    late: int, seed: int, is_even: bool
) -> None:
    verdicts = said(fresh(), frame_sets(shaking(seed), late, is_even=is_even))
    when = "after" if late > 0 else "before"
    moved = "1 exposure" if abs(late) == 1 else f"{abs(late)} exposures"
    wanted = f"the rear spot moves {moved} {when} the front spot, although they are stamped alike"
    assert set(verdicts[200:]) == {wanted}


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "vibration",
    [
        Vibration(),
        Vibration(rms_mm=0.3, rms_mrad=0.1),
        Vibration(rms_mm=0.02, rms_mrad=0.8),
        Vibration(random_share=0.0),
        Vibration(lines_hz=(0.5,), random_share=0.02),
        Vibration(rms_mm=0.1, rms_mrad=0.4, lines_hz=(5.0,), random_share=0.0),
    ],
    ids=["ordinary", "strong", "yaw most of all", "lines alone", "a slow rock", "one line"],
)
@pytest.mark.parametrize("is_even", [True, False])
def test_cameras_in_step_are_never_accused(vibration: Vibration, seed: int, is_even: bool) -> None:
    assert set(said(fresh(), frame_sets(shaking(seed, vibration), count=1200, is_even=is_even))) == {""}


@pytest.mark.parametrize("hertz", [3.0, 5.0, 8.0])
def test_a_phase_between_the_spots_is_no_lag_at_uneven_times(hertz: float) -> None:
    """The rear spot vibrates as the front one did a mean interval before."""

    def motion(t_ns: int) -> BeamPose:
        now, then = (2 * np.pi * hertz * (t_ns - ago_ns) * 1e-9 for ago_ns in (0, PERIOD_NS))
        front, rear = 0.3 * np.array([np.sin(now), np.cos(now)]), 0.3 * np.array([np.sin(then), np.cos(then)])
        return BeamPose(*front, *(rear - front) / 280)

    assert set(said(fresh(), frame_sets(motion, is_even=False))) == {""}


@pytest.mark.parametrize("apart_ms", [-25, -10, -3, 3, 10, 25, 30])
def test_nor_are_cameras_that_run_freely_and_say_so(apart_ms: int) -> None:
    for seed in (1, 2):
        assert set(said(fresh(), frame_sets(shaking(seed), apart_ms=apart_ms, count=800))) == {""}


def test_cameras_two_milliseconds_apart_can_be_told() -> None:
    for apart_ms in (-2, 2):
        assert said(fresh(), frame_sets(shaking(1), late=1, apart_ms=apart_ms))[-1]


@pytest.mark.parametrize("motion", [at_rest, on_its_way(1), shaking(1, Vibration(random_share=0.0))])
def test_rest_smooth_motion_and_pure_lines_cannot_tell_and_do_not(motion: Motion) -> None:
    assert set(said(fresh(), frame_sets(motion, late=1, count=800))) == {""}


def test_what_was_found_holds_when_the_machine_stops_and_ends_with_the_contrary() -> None:
    check = fresh()
    assert said(check, frame_sets(shaking(1), late=1))[-1]
    assert all(said(check, frame_sets(at_rest, first=400)))
    after = said(check, frame_sets(shaking(1), first=800, count=600))
    assert after[0]
    assert not after[-1]


def test_what_was_found_ends_with_a_new_start_of_the_cameras() -> None:
    check = fresh()
    assert said(check, frame_sets(shaking(1), late=1))[-1]
    check.restart()
    assert set(said(check, frame_sets(shaking(1), count=600))) == {""}


def test_lost_exposures_are_no_motion() -> None:
    lost = NoSpot(Reason.SPOT_MISSING)
    seen = [
        replace(each, spots={**each.spots, "rear": lost}) if each.sequence % 130 == 5 else each
        for each in frame_sets(shaking(2), count=1200)
        if each.sequence % 170 != 0
    ]
    assert set(said(fresh(), iter(seen))) == {""}


@pytest.mark.parametrize("every", [195, 150, 120])
def test_one_lost_exposure_in_a_hundred_does_not_blind_it(every: int) -> None:
    seen = (one for one in frame_sets(shaking(4), late=1, count=800) if one.sequence % every)
    assert "moves 1 exposure after" in said(fresh(), seen)[-1]


def test_an_outlier_of_one_spot_is_no_motion() -> None:
    def jumping() -> Iterator[FrameSet]:
        for each in frame_sets(at_rest, count=800):
            for name, at in (("front", 50), ("rear", 51)):
                if each.sequence % 100 == at:
                    spot = each.spots[name]
                    assert isinstance(spot, Spot)
                    each = replace(each, spots={**each.spots, name: replace(spot, u_px=spot.u_px + 40.0)})
            yield each

    assert set(said(fresh(), jumping())) == {""}
