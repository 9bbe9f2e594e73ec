"""The beam's movement: interpolation in time, the weighted line, stable targets that moved; the rate."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from support.evidence import calibration, target

from altd.config import RowSettings
from altd.instruments.row.beam import at_instant, gain_at, moved_stable, powers_mw
from altd.instruments.row.displacement import Baseline, Displacement
from altd.instruments.row.places import BeamPlace
from altd.instruments.row.rate import DAY_NS, DailyTrend, alarms
from altd.instruments.row.rounds import Observation, RoundWindow
from altd.measuring.calibration import Calibration
from altd.reasons import Reason
from altd.records import NoSpot, Spot

SIGMA_MM = 0.01


def place(t_s: float, x_mm: float, y_mm: float = 0.0) -> BeamPlace:
    random = SIGMA_MM**2 * np.eye(2)
    return BeamPlace(round(t_s * 1e9), 4, np.array([x_mm, y_mm]), random, random, 0.0, 2.5, np.eye(2) * 0.3)


def test_a_parabola_in_time_is_met_exactly_between_visits() -> None:
    def beam(t_s: float) -> tuple[float, float]:
        return 0.3 + 0.02 * t_s - 0.003 * t_s**2, 1.0 - 0.01 * t_s

    visits = [place(t_s, *beam(t_s)) for t_s in (0.0, 10.0, 21.0, 30.0)]
    for t_s in (2.0, 12.5, 25.0):
        found = at_instant(visits, round(t_s * 1e9))
        assert found.mm == pytest.approx(beam(t_s), abs=1e-9)
    exact = at_instant(visits, 21 * 10**9)
    assert exact.random_mm2[0, 0] == SIGMA_MM**2


def test_a_jump_between_two_visits_is_in_sigma() -> None:
    """Jumps of 0.5 mm at an unknown moment: the errors' rms is that of the stated sigma."""
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(2000):
        jump_s, at_s = rng.uniform(20.0, 30.0), rng.uniform(20.0, 30.0)
        times = (0.0, 10.0, 20.0, 30.0)
        visits = [place(t, 0.5 * (t > jump_s) + rng.normal(0.0, SIGMA_MM)) for t in times]
        found = at_instant(visits, round(at_s * 1e9))
        ratios.append((found.mm[0] - 0.5 * (at_s > jump_s)) / np.sqrt(found.random_mm2[0, 0]))
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_the_gain_is_that_of_a_weighted_line() -> None:
    """Of two targets at 0 and 60 m a place at 15 m has 3/4 and 1/4 of their movements; of one, its own."""
    same = [np.eye(2) * 1e-4] * 2
    expected = np.array([[0.75, 0.0, 0.25, 0.0], [0.0, 0.75, 0.0, 0.25]])
    assert gain_at([0.0, 60e3], same, 15e3) == pytest.approx(expected)
    assert np.array_equal(gain_at([20e3], same[:1], 55e3), np.eye(2))
    variances = [1e-4, 4e-4, 1e-4]
    z = np.array([0.0, 30e3, 60e3])
    gain = gain_at(z.tolist(), [np.eye(2) * each for each in variances], 10e3)
    weights = 1.0 / np.array(variances)
    slope = np.polynomial.polynomial.polyfit((z - 10e3) / 1e3, np.eye(3), 1, w=np.sqrt(weights))
    assert gain[0, 0::2] == pytest.approx(slope[0])


def test_of_three_stable_targets_it_cannot_be_told_which_moved_of_four_it_can() -> None:
    z_mm = {"a": 0.0, "b": 20e3, "c": 40e3, "d": 60e3}
    covariances = {name: np.eye(2) * SIGMA_MM**2 for name in z_mm}

    def movements(moved: str, by_mm: float) -> dict[str, np.ndarray]:
        beam = {name: np.array([0.5 + 1e-5 * z, -0.2 + 2e-5 * z]) for name, z in z_mm.items()}
        return {name: mm + np.array([by_mm * (name == moved), 0.0]) for name, mm in beam.items()}

    assert moved_stable(z_mm, movements("b", 0.0), covariances) == ()
    assert moved_stable(z_mm, movements("b", 0.2), covariances) == ("b",)
    three = {name: mm for name, mm in movements("b", 0.2).items() if name != "d"}
    assert moved_stable(z_mm, three, covariances) is None
    two = {name: three[name] for name in ("a", "b")}
    assert moved_stable(z_mm, two, covariances) == ()


def displacement(day: float, x_mm: float, lasting_mm: float = 0.0) -> Displacement:
    random, lasting = SIGMA_MM**2 * np.eye(2), lasting_mm**2 * np.eye(2)
    return Displacement(round(day * DAY_NS), np.array([x_mm, 0.0]), random + lasting, random, lasting)


@pytest.mark.long
def test_the_rate_is_that_of_the_last_day_with_its_sigma() -> None:
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(60):
        trend = DailyTrend()
        for day in np.arange(0.0, 1.5, 0.002):
            rate = trend.add(displacement(day, 0.05 * day + rng.normal(0.0, SIGMA_MM)))
        errors.append((rate.mm_per_day[0] - 0.05) / rate.sigma[0])
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.3
    assert rate.sigma[0] < 0.002


def test_alarms_need_the_limit_and_significance() -> None:
    assert alarms(displacement(0.0, 0.5), None, 0.4, None) == ("alarm_displacement",)
    assert alarms(displacement(0.0, 0.3), None, 0.4, None) == ()
    assert alarms(displacement(0.0, 0.5, lasting_mm=0.3), None, 0.4, None) == ()
    assert alarms(displacement(0.0, 0.5), None, None, 0.1) == ()
    trend = DailyTrend()
    for day in np.arange(0.0, 1.0, 0.01):
        rate = trend.add(displacement(day, 0.2 * day))
    assert alarms(displacement(1.0, 0.2), rate, None, 0.1) == ("alarm_rate",)
    assert alarms(displacement(1.0, 0.2), rate, None, 0.3) == ()


def test_powers_are_those_of_transmission_to_the_n() -> None:
    assert powers_mw(RowSettings(laser_mw=2.0), 3) == pytest.approx((2.0, 1.46, 1.0658))


def observations(order: str, start: int = 0) -> list[Observation]:
    spot = Spot(100.0, 100.0, 0.01, 35.0, 150.0)
    return [Observation(name, name, start + n, (start + n) * 10**8, spot) for n, name in enumerate(order)]


@pytest.mark.parametrize(
    ("order", "rounds"),
    [
        ("abcabc", ["abc", "abc"]),
        ("bcabca", ["abc", "abc"]),  # begins anywhere
        ("aabbccaabbcc", ["abc", "abc"]),
        ("cabcab", ["abc", "abc"]),
        ("abcacabc", ["abc", "ac", "abc"]),  # b is not visited once
        ("acacabc", ["ac", "abc"]),  # the first, partial one is none
        ("abcab", ["abc"]),  # nor is the last
    ],
)
def test_a_round_is_one_visit_of_all_targets(order: str, rounds: list[str]) -> None:
    window = RoundWindow(("a", "b", "c"))
    found = [window.add(observation) for observation in observations(order)]
    ended = [round_ for round_ in [*found, window.flush()] if round_ is not None]
    assert ["".join(sorted(round_.visits)) for round_ in ended] == rounds


def test_a_visits_last_exposures_count_and_unbelievable_light_is_not_known() -> None:
    window = RoundWindow(("a", "b"))
    for observation in observations("aaaaaaabbb"):
        window.add(observation)
    visit = window.flush()
    assert [observation.sequence for observation in visit.visits["a"].own(4)] == [3, 4, 5, 6]
    assert visit.visits["a"].brightness("a", 4) == [150.0 * 35.0**2] * 4
    assert visit.visits["a"].brightness("b", 4) is None
    for reason, light in ((Reason.SPOT_MISSING, [0.0]), (Reason.SATURATED, None)):
        one = RoundWindow(("a",))
        one.add(Observation("a", "a", 0, 0, NoSpot(reason)))
        only = one.flush()
        assert only.visits["a"].brightness("a", 4) == light


ROW_Z_MM = {"t1": 0.0, "t2": 30e3, "t3": 60e3, "t4": 45e3}


def row_calibration() -> Calibration:
    """Targets whose maps agree with the truth: what is left of a displacement's error is random."""
    targets = (
        replace(target("rear", pattern_px=0.0, shift_px=0.0), name=name, z_mm=z_mm)
        for name, z_mm in ROW_Z_MM.items()
    )
    return calibration(*targets)


def visits(rng: np.random.Generator, round_number: int, sigmas_mm: dict[str, float]) -> dict[str, BeamPlace]:
    """A round at rest: each place off by its own sigma, all at one instant."""
    found = {}
    for name, sigma_mm in sigmas_mm.items():
        random = sigma_mm**2 * np.eye(2)
        mm = rng.normal(0.0, sigma_mm, 2)
        found[name] = BeamPlace(round_number * 10**9, 4, mm, random, random, 0.0, 2.5, np.eye(2) * 0.25)
    return found


@pytest.mark.parametrize("baseline_rounds", [1, 4])
def test_a_displacements_covariance_is_that_of_monte_carlo_with_few_rounds_in_the_baseline(
    baseline_rounds: int,
) -> None:
    """The middle of a row against its ends: s² + (s₁² + s₃²)/4, now and, over n, in the baseline."""
    sigmas_mm = {"t1": 0.02, "t2": 0.01, "t3": 0.03}
    now_mm2 = 0.01**2 + (0.02**2 + 0.03**2) / 4
    rng = np.random.default_rng(7)
    row, squares = row_calibration(), []
    for _ in range(100):
        baseline = Baseline(row, ("t1", "t3"), baseline_rounds)
        history: dict[str, list[BeamPlace]] = {name: [] for name in sigmas_mm}
        for number in range(baseline_rounds + 1):
            taken = visits(rng, number, sigmas_mm)
            for name, place_ in taken.items():
                history[name].append(place_)
            if not baseline.is_complete:
                baseline.collect(taken, history)
        one = baseline.displaced(taken, history).places["t2"]
        squares.append(one.significance**2)
    assert one.covariance_mm2 == pytest.approx(now_mm2 * (1 + 1 / baseline_rounds) * np.eye(2), rel=1e-9)
    assert one.random_mm2 == pytest.approx(now_mm2 * np.eye(2), rel=1e-9)
    assert np.mean(squares) == pytest.approx(2.0, rel=0.25)


@dataclass
class Row:
    """Rounds of a row as its baseline takes them; a place creeps by ``creep_mm`` a round along x."""

    rng: np.random.Generator
    sigmas_mm: dict[str, float]
    creep_mm: float = 0.0
    history: dict[str, list[BeamPlace]] = field(default_factory=dict)
    rounds: int = 0

    def taken(self, baseline: Baseline) -> dict[str, BeamPlace]:
        """One more round, with t2 where its creep has brought it."""
        found = visits(self.rng, self.rounds, self.sigmas_mm)
        found["t2"].mm[0] -= self.rounds * self.creep_mm
        self.rounds += 1
        for name, place_ in found.items():
            self.history.setdefault(name, []).append(place_)
        if not baseline.is_complete:
            baseline.collect(found, self.history)
        return found


@pytest.mark.parametrize(
    ("stable", "beam", "of_beam_mm2"),
    [(("t1", "t4", "t3"), "line", (0.02**2 + 0.03**2) / 4), (("t4", "t1"), "offset", None)],
)
def test_a_stable_target_that_is_never_measured_is_left_out_of_the_baseline(
    stable: tuple[str, ...], beam: str, of_beam_mm2: float | None
) -> None:
    """t4 is refused in all rounds; sigma is that of a beam known by the others alone."""
    baseline = Baseline(row_calibration(), stable, 4)
    row = Row(np.random.default_rng(3), {"t1": 0.02, "t2": 0.01, "t3": 0.03})
    for _ in range(11):
        row.taken(baseline)
        assert not baseline.is_complete
    row.taken(baseline)
    assert baseline.is_complete
    assert [name for name in ROW_Z_MM if not baseline.has(name)] == ["t4"]
    row.sigmas_mm["t4"] = 0.01  # when it is measured again, it has no displacement, and shows no beam
    found = baseline.displaced(row.taken(baseline), row.history)
    assert (found.beam, found.places.keys()) == (beam, {"t1", "t2", "t3"})
    if of_beam_mm2 is not None:
        expected_mm2 = (0.01**2 + of_beam_mm2) * (1 + 1 / 4)
        assert found.places["t2"].covariance_mm2 == pytest.approx(expected_mm2 * np.eye(2), rel=1e-9)


def test_a_seldom_measured_stable_target_is_waited_for() -> None:
    """Measured in every second round it is in the baseline, at the first rounds that show it."""
    baseline = Baseline(row_calibration(), ("t1", "t3"), 4)
    row = Row(np.random.default_rng(3), {"t1": 0.02, "t2": 0.01})
    for number in range(8):
        assert not baseline.is_complete
        row.sigmas_mm = row.sigmas_mm | {"t3": 0.03} if number % 2 else {"t1": 0.02, "t2": 0.01}
        row.taken(baseline)
    assert baseline.has("t3")


@pytest.mark.parametrize(("creep_mm", "most"), [(0.004, 1.7), (0.02, 1.25), (0.1, 1.25)])
def test_motion_within_the_baseline_is_in_sigma(creep_mm: float, most: float) -> None:
    """The displacement counts from the start, the middle or the end of the baseline's five rounds alike."""
    rng, squares, worst = np.random.default_rng(11), list[float](), 0.0
    for _ in range(60):
        baseline = Baseline(row_calibration(), ("t1", "t3"), 5)
        row = Row(rng, {"t1": 0.004, "t2": 0.004, "t3": 0.004}, creep_mm)
        for _ in range(8):
            now = row.taken(baseline)
        one = baseline.displaced(now, row.history).places["t2"]
        errors_mm = one.mm[0] - creep_mm * (row.rounds - 1 - np.array([-0.5, 2.0, 4.5]))
        ratios = errors_mm / np.sqrt(one.covariance_mm2[0, 0])
        squares += np.square(ratios).tolist()
        worst = max(worst, float(np.abs(ratios).max()))
    assert 0.8 < np.sqrt(np.mean(squares)) < most  # the slowest is within the scatter of the visits
    assert worst < 5.0
