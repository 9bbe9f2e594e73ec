"""The page of ``make bench-peers``, from figures: the peers' packages are not needed for it."""

from __future__ import annotations

import math
import re

import pytest

from benchmarks.peers_frames import CLEAN, KINDS, PLATE, WINDOW, make_samples
from benchmarks.peers_page import Cell, Figures, MapFigures, Scatter, SpotFigures, page
from hw_sim.unit import CAMERAS


def spot(
    name: str, us: float, mapped_px: float, *, failed: int = 0, raw_px: float = 0.1, altd: bool = False
) -> SpotFigures:
    return SpotFigures(
        name, altd, "frame", f"how {name} was used", us, {"plate": Scatter(raw_px, mapped_px, 9, failed)}
    )


def mapping(name: str, point_us: float, mean_mm: float, failed: int = 0) -> MapFigures:
    return MapFigures(
        name,
        f"how {name} was used",
        100.0,
        point_us,
        1.0,
        {(8.0, (6, 5)): Cell(mean_mm, 2 * mean_mm, failed)},
    )


def written(spots: list[SpotFigures], maps: list[MapFigures]) -> list[str]:
    spots = [spot("altd", 500.0, 0.0200, altd=True), *spots]
    maps = [mapping("altd map", 20.0, 0.0060), *maps]
    return list(page(Figures(spots, maps, 1, 9, 1, {"altd": "1.2.3", "other": "4.5"})))


def row(lines: list[str], name: str, table: int = 0) -> list[str]:
    rows = [line for line in lines if line.startswith("|") and line.split("|")[1].strip() == name]
    return [cell.strip() for cell in rows[table].split("|")[2:-1]]


def behind(lines: list[str]) -> list[list[str]]:
    """What stands in each of the lists of where altd is behind."""
    starts = [number for number, line in enumerate(lines) if line.startswith("Where altd is behind")]
    lists = []
    for start in starts:
        rest = lines[start + 2 :]
        lists.append(rest[: rest.index("")] if not lines[start].endswith("nowhere.") else [])
    return lists


def test_a_peer_with_a_smaller_error_stands_out_and_is_listed() -> None:
    lines = written([spot("better", 1000.0, 0.0100)], [])
    assert row(lines, "better") == ["frame", "2.0 ×", "**0.0100**", "0"]
    assert behind(lines) == [
        ["- better (given: frame), in 2.0 × of altd's time: smaller error: plate (0.50)."],
        [],
    ]


def test_so_does_a_faster_peer_with_an_equal_error_but_no_slower_one() -> None:
    lines = written([spot("fast", 50.0, 0.0201), spot("slow", 600.0, 0.0201)], [])
    assert row(lines, "fast") == ["frame", "**0.10 ×**", "0.0201", "0"]
    assert row(lines, "slow") == ["frame", "1.2 ×", "0.0201", "0"]
    assert behind(lines)[0] == ["- fast (given: frame), in 0.10 × of altd's time: equal error: plate (1.00)."]


def test_a_peer_that_failed_or_is_worse_is_not_ahead_by_being_fast() -> None:
    lines = written([spot("fails", 5.0, 0.0100, failed=3), spot("worse", 5.0, 0.0300)], [])
    assert behind(lines) == [[], []]
    assert row(lines, "fails")[-1] == "3"
    assert row(lines, "worse") == ["frame", "0.010 ×", "0.0300", "0"]


def test_maps_are_compared_alike() -> None:
    lines = written([], [mapping("better map", 5.0, 0.0050), mapping("worse map", 5.0, 0.0070)])
    assert row(lines, "better map") == ["1.0 ×", "**0.25 ×**", "1.0 ×", "**0.0050**", "0"]
    assert row(lines, "better map", table=1) == ["**0.010**"]
    assert behind(lines)[1] == [
        "- better map, in 1.0 × of altd's time a fit and 0.25 × a point: smaller error: f = 8, 6 × 5 (0.83)."
    ]


def test_says_versions_and_how_each_was_used_and_no_number_where_there_is_none() -> None:
    lines = written([spot("none", 5.0, math.nan, failed=9, raw_px=math.nan)], [])
    assert "altd 1.2.3, other 4.5" in lines
    assert "- none (frame): how none was used." in lines
    assert row(lines, "none") == ["frame", "0.010 ×", "–", "9"]
    assert not re.search(r"\bnan\b|\binf\b", "\n".join(lines))


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_lies_in_the_region_that_is_given(kind: str) -> None:
    samples = [sample for sample in make_samples(1, 2) if sample.kind == kind]
    assert {sample.frame.camera for sample in samples} == {
        WINDOW: {CAMERAS[0]},
        PLATE: {CAMERAS[1]},
        CLEAN: set(CAMERAS),
    }[kind]
    for sample in samples:
        rows, columns = sample.excess.shape
        u, v = sample.truth_px[0] - sample.left, sample.truth_px[1] - sample.top
        assert columns / 4 < u < columns * 3 / 4
        assert rows / 4 < v < rows * 3 / 4
        assert abs(float(sample.excess[0].mean())) < 2
        assert sample.excess[round(v), round(u)] > 30 or kind == WINDOW
