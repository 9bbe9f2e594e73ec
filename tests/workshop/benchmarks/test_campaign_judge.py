"""The judge of ``make campaign`` counts rightly: made-up measurements, truth by formula."""

import math

import numpy as np
import pytest
from support.measurements import measured as measurement_of

from altd.instruments.beam.solver import Beam
from altd.reasons import Reason
from altd.records import Fault, Measurement
from benchmarks.campaign import tally_table
from benchmarks.campaign.judge import Judgement, Outcome, Tally, Verdict, judge, truth_of

TRUTH = np.array([10.0, -5.0, 1.0, -2.0])
SIGMA = (0.004, 0.004, 0.001, 0.001)


def beam_measured(
    error: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0), sigma: tuple[float, ...] = SIGMA
) -> Measurement:
    values = [float(true + off) for true, off in zip(TRUTH, error, strict=True)]
    return measurement_of(Beam(*values, *sigma), sequence=7, t_ns=0, frames=4)


def invalid(*reasons: Reason) -> Measurement:
    return measurement_of(
        None, sequence=7, t_ns=0, frames=0, status=tuple(Fault(reason) for reason in reasons)
    )


@pytest.mark.parametrize(
    ("error", "sigma", "verdict"),
    [
        ((0, 0, 0, 0), SIGMA, Verdict.RIGHT),
        ((0.051, 0, 0, 0), SIGMA, Verdict.WRONG),
        ((0.049, 0, 0, 0), SIGMA, Verdict.RIGHT),  # 12 sigma, but below the limit
        ((0, 0, 0, 0.0101), SIGMA, Verdict.WRONG),
        ((0, 0, -0.0101, 0), SIGMA, Verdict.WRONG),
        ((0, 0, 0.0101, 0), (0.004, 0.004, 0.0021, 0.001), Verdict.RIGHT),  # above the limit, but 4.8 sigma
        ((3.0, 0, 0, 0), (1.0, 0.004, 0.001, 0.001), Verdict.RIGHT),  # it says itself how little it knows
        ((math.nan, 0, 0, 0), SIGMA, Verdict.WRONG),
        ((0, 0, 0, 0), (math.nan, 0.004, 0.001, 0.001), Verdict.WRONG),
        ((0, 0, math.inf, 0), SIGMA, Verdict.WRONG),
    ],
)
def test_wrong_is_above_five_sigmas_and_above_a_limit(
    error: tuple[float, ...], sigma: tuple[float, ...], verdict: Verdict
) -> None:
    assert judge(beam_measured(error, sigma), TRUTH).verdict is verdict


def test_any_number_is_wrong_where_no_beam_is() -> None:
    assert judge(beam_measured(), None).verdict is Verdict.WRONG
    assert judge(invalid(Reason.SPOT_MISSING), None).verdict is Verdict.INVALID


def test_the_largest_error_is_kept_of_each_kind() -> None:
    one = judge(beam_measured((0.06, -0.08, 0.004, -0.02)), TRUTH)
    assert one.error_mm == pytest.approx(0.08)
    assert one.error_deg == pytest.approx(0.02)
    assert one.sigmas == pytest.approx(20.0)


def test_an_invalid_measurement_brings_its_reasons_and_no_errors() -> None:
    one = judge(invalid(Reason.UNSTEADY, Reason.EXPOSURES_LOST), TRUTH)
    assert (one.reasons, one.warnings) == (("unsteady",), ("exposures_lost",))
    assert (one.error_mm, one.error_deg, one.sigmas) == (0.0, 0.0, 0.0)


RIGHT, REFUSED = (
    Judgement(Verdict.RIGHT, 0.01, 0.001, 1.0),
    Judgement(Verdict.INVALID, reasons=("distorted",)),
)


def wrong(sigmas: float) -> Judgement:
    return Judgement(Verdict.WRONG, 0.1 * sigmas, 0.01 * sigmas, sigmas)


def test_a_tally_counts_frames_from_the_onset_to_the_first_invalid_measurement() -> None:
    tally = Tally()
    tally.add(Outcome((RIGHT, REFUSED), (RIGHT, wrong(9.0), REFUSED, wrong(7.0), REFUSED)), "a")
    tally.add(Outcome((), (RIGHT, RIGHT)), "b")
    assert tally.noticed == [3]
    assert tally.verdicts == {Verdict.RIGHT: 3, Verdict.WRONG: 2, Verdict.INVALID: 2}
    assert (tally.episodes, tally.wrong_episodes, tally.measurements) == (2, 1, 7)
    assert (tally.clean, tally.clean_refused) == (2, {"distorted": 1})
    assert (tally.worst_mm, tally.worst_deg, tally.worst_sigmas) == (0.9, 0.09, 9.0)
    assert [note for *_, note in tally.worst] == ["a"]


def test_two_processes_sums_are_those_of_one() -> None:
    outcomes = [Outcome((RIGHT,), (wrong(6.0 + n), REFUSED), recovered_s=0.5 * n) for n in range(4)]
    together, halves = Tally(), (Tally(), Tally())
    for n, outcome in enumerate(outcomes):
        together.add(outcome, str(n))
        halves[n // 2].add(outcome, str(n))
    halves[0].merge(halves[1])
    assert halves[0] == together


def test_wrong_ones_decide_the_exit_status_unless_physics_hides_them() -> None:
    tally = Tally()
    tally.add(Outcome((), (wrong(8.0), wrong(9.0))), "a")
    assert tally_table.wrong_count({"reflection": tally}) == 2
    tally.add(Outcome((), (wrong(7.0),)), "b", "it is a shift")
    assert tally_table.wrong_count({"reflection (hidden)": tally}) == 0
    assert tally_table.invisible_count({"reflection (hidden)": tally}) == 3
    spoilt_before = Tally()
    spoilt_before.add(Outcome((wrong(8.0),), (REFUSED,)), "b")
    assert tally_table.wrong_count({"reflection": spoilt_before}) == 1


def test_the_table_says_what_was_counted() -> None:
    tally = Tally()
    tally.add(Outcome((REFUSED,), (RIGHT, wrong(8.0), REFUSED)), "a")
    lines = list(tally_table.text({"reflection": tally}))
    assert " ".join(lines[1].split()) == "reflection spots 1 3 1 1 1 0.8 0.08 8 3 / 3"
    assert "good ones rejected: distorted 1" in lines
    assert "wrong ones marked valid: 1" in lines


def test_truth_follows_the_time_of_a_measurement_whose_window_lost_exposures() -> None:
    times_ns = np.arange(4) * 50e6
    places = np.outer(np.arange(4), [1.0, 2.0, 0.0, -1.0])
    whole = measurement_of(None, sequence=7, t_ns=75_000_000, frames=4)
    late = measurement_of(None, sequence=7, t_ns=125_000_000, frames=2)
    assert truth_of(whole, places, times_ns) == pytest.approx([1.5, 3.0, 0.0, -1.5])
    assert truth_of(late, places, times_ns) == pytest.approx([2.5, 5.0, 0.0, -2.5])
