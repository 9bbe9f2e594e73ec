from typing import Any

import pytest

from altd.answers.history import MAX_BINS, Drawn, PlotHistory


def line(t_s: float, x_mm: float | None, *status: str, sigma_mm: float = 0.5) -> tuple[float, dict[str, Any]]:
    valid = x_mm is not None
    sigma = {"x_mm": sigma_mm if valid else None}
    return t_s, {"valid": valid, "status": list(status), "x_mm": x_mm, "sigma": sigma}


def history(*lines: tuple[float, dict[str, Any]]) -> PlotHistory:
    of = PlotHistory({"x_mm": Drawn("x, mm", "x_mm")})
    for each in lines:
        of.add(*each)
    return of


def runs(of: PlotHistory) -> list[list[float]]:
    return [[each.mean("x_mm") for each in run] for run in of.runs()]


def test_a_band_reaches_one_sigma_to_either_side() -> None:
    of = history(line(0, 1.0), line(1, 3.0, sigma_mm=0.25))
    (run,) = of.runs()
    assert [(each.low["x_mm"], each.high["x_mm"]) for each in run] == [(0.5, 1.5), (2.75, 3.25)]


def test_what_is_invalid_is_a_gap_and_named() -> None:
    lost = line(2, None, "rear_spot_missing", "simulated")
    of = history(line(0, 1.0), line(1, 2.0), lost, line(3, 4.0, "simulated"))
    assert runs(of) == [[1.0, 2.0], [4.0]]
    assert of.codes() == ["rear_spot_missing", "simulated"]
    assert of.spans_s(None) == [(-0.5, 1.5), (2.5, 3.5)]
    assert of.spans_s("rear_spot_missing") == [(1.5, 2.5)]
    assert of.spans_s("simulated") == [(1.5, 3.5)]


def test_where_nothing_was_recorded_there_is_a_gap() -> None:
    assert runs(history(*(line(t_s, t_s) for t_s in (0, 1, 2, 60, 61)))) == [[0, 1, 2], [60, 61]]


@pytest.mark.parametrize("count", [1, 2, MAX_BINS, MAX_BINS + 1, 10 * MAX_BINS + 7])
def test_however_many_there_are_none_is_lost_and_few_are_kept(count: int) -> None:
    of = history(*(line(t_s, float(t_s)) for t_s in range(count)))
    assert len(of.bins) <= MAX_BINS
    assert sum(each.count for each in of.bins) == sum(each.valid for each in of.bins) == count
    assert sum(each.total["x_mm"] for each in of.bins) == count * (count - 1) / 2
    (run,) = of.runs()
    for each in run:
        assert (each.low["x_mm"], each.high["x_mm"]) == (each.first_s - 0.5, each.last_s + 0.5)


def test_a_single_bad_one_among_many_still_shows() -> None:
    count = 8 * MAX_BINS
    lines = (line(t, None, "unsteady") if t == 5000 else line(t, 100.0 * (t == 9000)) for t in range(count))
    of = history(*lines)
    ((start_s, end_s),) = of.spans_s("unsteady")
    assert start_s <= 5000 <= end_s
    assert end_s - start_s < 40
    assert max(each.high["x_mm"] for each in of.bins) == 100.5


def test_nothing() -> None:
    of = history()
    assert (runs(of), of.codes(), of.spans_s(None)) == ([], [], [])
