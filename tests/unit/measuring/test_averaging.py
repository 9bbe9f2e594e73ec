from dataclasses import replace

import numpy as np
import pytest

from altd.measuring.averaging import FrameSetWindow, mean_spots
from altd.reasons import Reason
from altd.records import Fault, FrameSet, MeanSpots, NoSpot, Spot

TARGETS = ("front", "rear")
PERIOD_NS = 50_000_000


def spot(u: float, v: float, sigma: float = 0.02) -> Spot:
    return Spot(u, v, sigma, 44.0, 180.0)


def frame_set(number: int, front=(300.0, 200.0), rear=(310.0, 220.0)) -> FrameSet:
    spots = {
        target: place if isinstance(place, NoSpot) else spot(*place)
        for target, place in (("front", front), ("rear", rear))
    }
    return FrameSet(number, number * PERIOD_NS, spots)


def mean_of(frame_sets: list[FrameSet], window: int | None = None) -> MeanSpots:
    mean = mean_spots(frame_sets, TARGETS, window or len(frame_sets))
    assert isinstance(mean, MeanSpots), mean
    return mean


def why_not(frame_sets: list[FrameSet], window: int | None = None) -> list[str]:
    mean = mean_spots(frame_sets, TARGETS, window or len(frame_sets))
    assert isinstance(mean, tuple), mean
    assert all(isinstance(fault, Fault) for fault in mean)
    return [str(fault) for fault in mean]


MISSING = NoSpot(Reason.SPOT_MISSING)


def test_the_mean_and_its_time_are_those_of_the_exposures() -> None:
    mean = mean_of([frame_set(n, front=(300.0 + n, 200.0 - n)) for n in range(5)])
    assert mean.px.tolist() == [[302.0, 198.0], [310.0, 220.0]]
    assert (mean.t_ns, mean.frames, mean.lost) == (2 * PERIOD_NS, 5, 0)


@pytest.mark.parametrize("count", [4, 8, 20])
def test_an_outlier_exposure_does_not_move_the_mean(count: int) -> None:
    rng = np.random.default_rng(1)
    steady = [frame_set(n, front=tuple(rng.normal((300, 200), 0.02))) for n in range(count)]
    clean = mean_of(steady[:-1], count)
    kicked = mean_of([*steady[:-1], frame_set(count, front=(340.0, 200.0))])
    assert kicked.frames == count - 1
    assert kicked.px == pytest.approx(clean.px, abs=1e-12)


def test_the_covariance_of_the_mean_is_that_of_monte_carlo() -> None:
    rng = np.random.default_rng(2)
    shake, noise, count = 0.4, 0.02, 20
    means, predicted = [], []
    for _ in range(1500):
        common = rng.normal(0, shake, (count, 2))
        front = common + rng.normal((300, 200), noise, (count, 2))
        rear = common + rng.normal((310, 220), noise, (count, 2))
        mean = mean_of([frame_set(n, tuple(front[n]), tuple(rear[n])) for n in range(count)])
        means.append(mean.px.ravel())
        predicted.append(mean.covariance_px2)
    observed, expected = np.cov(np.array(means).T), np.mean(predicted, axis=0)
    assert np.sqrt(np.diag(expected) / np.diag(observed)) == pytest.approx(1.0, abs=0.1)
    difference = np.array([1.0, 0, -1.0, 0])  # vibration that both targets share cancels
    assert np.sqrt(difference @ expected @ difference) < 0.15 * np.sqrt(expected[0, 0])


def test_light_that_one_spot_does_not_explain_is_not_averaged_down() -> None:
    """It is the same in all exposures: noise²/n remains, and its square beside it, of its spot alone."""
    excess_px, noise_px, count = 0.05, 0.02, 16
    rng = np.random.default_rng(6)
    covariances, plain = [], []
    for _ in range(50):
        places = rng.normal((300, 200, 310, 220), noise_px, (count, 4))
        frame_sets = [frame_set(n, tuple(at[:2]), tuple(at[2:])) for n, at in enumerate(places)]
        plain.append(mean_of(frame_sets).covariance_px2)
        spots_of = [
            one.spots | {"rear": replace(one.spots["rear"], excess_px=excess_px)} for one in frame_sets
        ]
        mean = mean_of([replace(one, spots=spots) for one, spots in zip(frame_sets, spots_of, strict=True)])
        assert mean.excess_px == pytest.approx((0.0, excess_px))
        covariances.append(mean.covariance_px2)
    added = np.mean(covariances, axis=0) - np.mean(plain, axis=0)
    assert added == pytest.approx(np.diag([0.0, 0.0, excess_px**2, excess_px**2]), abs=1e-12)
    assert np.mean(plain, axis=0).diagonal() == pytest.approx(noise_px**2 / count, rel=0.15)


def test_steady_motion_does_not_count_as_scatter() -> None:
    rng = np.random.default_rng(5)
    errors, sigmas = [], []
    for _ in range(400):
        path = rng.normal(300, 0.1, 20) + 0.15 * np.arange(20)
        mean = mean_of([frame_set(n, front=(u, 200.0)) for n, u in enumerate(path)])
        errors.append(mean.px[0, 0] - (300 + 0.15 * mean.t_ns / PERIOD_NS))
        sigmas.append(np.sqrt(mean.covariance_px2[0, 0]))
    assert np.mean(sigmas) == pytest.approx(np.std(errors), rel=0.1)


def test_one_exposure_has_the_spots_own_noise() -> None:
    assert np.sqrt(np.diag(mean_of([frame_set(0)]).covariance_px2)) == pytest.approx(0.02)


def test_a_few_lost_exposures_are_counted_and_the_mean_stands() -> None:
    mean = mean_of([frame_set(n, front=MISSING if n in (1, 4) else (300.0, 200.0)) for n in range(10)])
    assert (mean.frames, mean.lost) == (8, 2)


SATURATED, OUT_OF_STEP = NoSpot(Reason.SATURATED), NoSpot(Reason.OUT_OF_STEP)


@pytest.mark.parametrize(
    ("frame_sets", "reasons"),
    [
        (
            [frame_set(n, front=MISSING if n % 3 else (300.0, 200.0)) for n in range(10)],
            ["front_spot_missing"],
        ),
        (
            [frame_set(n, rear=MISSING if n > 16 else (310.0, 220.0)) for n in range(20)],
            ["rear_spot_missing"],
        ),
        (
            [frame_set(n, front=MISSING, rear=SATURATED if n else MISSING) for n in range(4)],
            ["front_spot_missing", "rear_saturated", "rear_spot_missing"],
        ),
        ([frame_set(n, front=OUT_OF_STEP, rear=OUT_OF_STEP) for n in range(4)], ["out_of_step"]),
    ],
    ids=["less than half", "gone for three exposures", "most frequent first", "of the whole unit"],
)
def test_a_window_without_a_mean_says_why(frame_sets: list[FrameSet], reasons: list[str]) -> None:
    assert why_not(frame_sets) == reasons


def test_exposures_that_nobody_wanted_are_what_a_window_lacks_and_not_those_that_failed() -> None:
    """Of ten, six under the LEDs; of the other four one or two lack their spot, as any window may."""
    window = FrameSetWindow(TARGETS, 10, 1)
    for n in range(10):
        window.add(frame_set(n))
    for n in range(10, 16):
        window.skip(n)
    for n, is_seen in ((16, True), (17, False), (18, True), (19, False)):
        outcome = window.add(frame_set(n, front=(300.0, 200.0) if is_seen else MISSING))
        assert isinstance(outcome, MeanSpots) or [str(fault) for fault in outcome or ()] == ["warming_up"]
    assert not isinstance(outcome, MeanSpots)
    means = [window.add(frame_set(n)) for n in range(20, 24)]
    assert [isinstance(mean, MeanSpots) for mean in means] == [False, False, True, True]


def test_a_spot_that_is_gone_is_told_whatever_the_leds_took() -> None:
    """At once where the window lacks more than that, with the third exposure in any case."""
    for taken, told_from in ((6, 3), (1, 1)):
        window = FrameSetWindow(TARGETS, 10, 1)
        for n in range(taken):
            window.skip(n)
        outcomes = [window.add(frame_set(n, front=MISSING)) for n in range(taken, taken + 4)]
        told = [[str(fault) for fault in outcome or ()] for outcome in outcomes]  # type: ignore[union-attr]
        assert told == [["warming_up"]] * (told_from - 1) + [["front_spot_missing"]] * (5 - told_from)


def test_what_was_passed_over_before_a_gap_excuses_nothing_after_it() -> None:
    window = FrameSetWindow(TARGETS, 4, 1)
    for n in range(4):
        window.skip(n)
    window.forget()
    outcome = window.add(frame_set(4, front=MISSING))
    assert [str(fault) for fault in outcome or ()] == ["front_spot_missing"]  # type: ignore[union-attr]


@pytest.mark.parametrize(("count", "jump"), [(4, 2), (20, 8), (20, 10), (20, 12), (7, 3)])
def test_a_beam_that_jumps_within_the_window_is_unsteady(count: int, jump: int) -> None:
    rng = np.random.default_rng(3)
    places = (rng.normal((300 if n < jump else 330, 200), 0.02) for n in range(count))
    frame_sets = [frame_set(n, front=tuple(place)) for n, place in enumerate(places)]
    assert why_not(frame_sets) == ["unsteady"]


def test_vibration_and_steady_motion_are_not_a_jump() -> None:
    rng = np.random.default_rng(4)
    for count in (2, 3, 8, 20):
        for trial in range(300):
            time = np.arange(count) / 20
            shake = rng.normal(0, 0.5) * np.sin(2 * np.pi * rng.uniform(1, 30) * time + rng.uniform(0, 6))
            path = 300 + shake + rng.normal(0, 0.3, count) + rng.uniform(-5, 5) * time
            mean = mean_spots([frame_set(n, front=(u, 200.0)) for n, u in enumerate(path)], TARGETS, count)
            assert isinstance(mean, MeanSpots), (count, trial)


def test_a_window_that_fills_is_warming_up_until_it_is_half_full() -> None:
    window = FrameSetWindow(TARGETS, 10, 1)
    outcomes = [window.add(frame_set(n)) for n in range(10)]
    assert [isinstance(outcome, MeanSpots) for outcome in outcomes] == [False] * 4 + [True] * 6
    assert [str(fault) for fault in outcomes[0]] == ["warming_up"]


def test_back_to_back_windows_share_no_exposure() -> None:
    window = FrameSetWindow(TARGETS, 4, 4)
    outcomes = [window.add(frame_set(n, front=(300.0 + n // 4, 200.0))) for n in range(12)]
    means = [outcome for outcome in outcomes if outcome is not None]
    assert [mean.px[0, 0] for mean in means] == [300.0, 301.0, 302.0]


@pytest.mark.parametrize("lag_ms", [-25, 25])
def test_steady_motion_between_two_cameras_that_lag_is_taken_off(lag_ms: int) -> None:
    """The beam wanders by 20 px/s over both targets; the rear camera is late."""

    def at(t_ns: int) -> tuple[float, float]:
        return 300.0 + 20e-9 * t_ns, 200.0 - 8e-9 * t_ns

    half_ns = lag_ms * 500_000
    frame_sets = [
        FrameSet(
            n,
            t_ns := n * PERIOD_NS,
            {"front": spot(*at(t_ns - half_ns)), "rear": spot(*at(t_ns + half_ns))},
            {"front": -half_ns, "rear": half_ns},
        )
        for n in range(20)
    ]
    mean = mean_of(frame_sets)
    assert mean.px == pytest.approx(np.array([at(mean.t_ns)] * 2), abs=1e-9)


def test_exposures_that_all_cameras_lost_fill_places_of_the_window() -> None:
    """Four of five are lost: what is averaged would reach back by five windows."""
    window = FrameSetWindow(TARGETS, 8, 1)
    full = [window.add(frame_set(n)) for n in range(8)]
    assert isinstance(full[-1], MeanSpots)
    thinned = [window.add(frame_set(n)) for n in range(12, 60, 5)]
    assert all(not isinstance(mean, MeanSpots) for mean in thinned[1:])
    again = [window.add(frame_set(n)) for n in range(60, 68)]
    assert again[-1].t_ns == round(63.5 * PERIOD_NS)
