"""``make campaign`` runs, says what it promises, and its exit status is that of its table.

The ways that disturb times and numbers are held against arithmetic.
"""

import math
import os
import subprocess
import sys
import time
from collections import Counter
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
from support.places import ROOT

from altd.errors import BadInputError
from benchmarks.campaign import __main__ as campaign
from benchmarks.campaign.good import Count
from benchmarks.campaign.runner import Plan, workers
from benchmarks.campaign.units import RECORDINGS, SIMULATED
from benchmarks.campaign.way import CAMERAS, MS, Draw, Way
from benchmarks.campaign.ways import numbers, times
from benchmarks.campaign.ways.numbers import Misnumbered
from benchmarks.campaign.ways.times import Delivery, Mistimed

pytestmark = pytest.mark.timeout(1200)  # minutes of work where other programs keep the cores busy


def run(cache: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "benchmarks.campaign", *arguments],
        cwd=ROOT,
        env={**os.environ, "ALTD_CAMPAIGN_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.skipif(not RECORDINGS.exists(), reason="../shared/data/unit-a is not here")
def test_a_run_on_the_recorded_unit_is_the_same_twice_and_writes_its_page(tmp_path: Path) -> None:
    """A calibration of unit-a and forty of its measurements: some twenty seconds."""
    ways = "clean,clean_times,deflected_laser"
    arguments = ["--units", "unit-a", "--ways", ways, "--measurements", "8", "--processes", "1"]
    first = run(tmp_path, *arguments, "--page", str(tmp_path / "page.md"))
    again = run(tmp_path, *arguments)
    assert first.returncode == 0, first.stderr
    assert first.stdout.splitlines()[:-1] == again.stdout.splitlines()[:-1]
    rows = {row[0]: row for line in first.stdout.splitlines() if (row := line.split())}
    for way, kind in (("clean", "good"), ("clean_times", "times")):  # of frames, and through the board
        _, found, _, measured, _, right, *_ = rows[way]
        assert found == kind
        assert measured == right
        assert int(right) > 0
    page = (tmp_path / "page.md").read_text()
    assert "0 wrong ones were marked valid" in page
    assert "- deflected_laser: the laser is deflected before the window" in page


def test_what_is_not_known_ends_it_with_one_line(tmp_path: Path) -> None:
    for arguments in (("--ways", "gremlins"), ("--units", "unit-z")):
        done = run(tmp_path, *arguments)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1


def test_what_needs_photographs_and_recordings_says_so_where_there_are_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = Path("/nowhere")
    monkeypatch.setattr(campaign, "RECORDINGS", nowhere)
    monkeypatch.setattr(campaign, "BEAMS", nowhere)
    with pytest.raises(BadInputError, match="--ways: photographed_beam needs the photographs in "):
        campaign.main(["--ways", "photographed_beam"])
    with pytest.raises(BadInputError, match="--units: unit-a needs the recordings in /nowhere"):
        campaign.main(["--units", "unit-a"])
    planned: list[tuple[str, ...]] = []

    def run_nothing(plan: Plan, *_: object) -> tuple[dict[str, object], float]:
        planned.append(plan.units)
        return {}, 1.0

    monkeypatch.setattr(campaign, "run", run_nothing)
    assert campaign.main([]) == 0
    assert planned == [tuple(SIMULATED)]
    assert capsys.readouterr().err.splitlines() == [
        "campaign: without unit-a: /nowhere is not there",
        "campaign: without photographed_beam: /nowhere is not there",
    ]


def test_hours_of_good_measuring_add_up_and_survive_their_file() -> None:
    hour = Count(
        10, 8, 1, 400, Counter(unsteady=2), Counter(), Counter(front_distorted=3), [8.0, 2.0, 0.0, 32.0], 4.0
    )
    day = Count()
    for _ in range(24):
        day.merge(Count.of_json(hour.as_json()))
    assert (day.measurements, day.valid, day.wrong, day.frames) == (240, 192, 24, 9600)
    assert day.invalid == {"unsteady": 48}
    assert day.frames_refused == {"front_distorted": 72}
    assert day.rms == pytest.approx([1.0, 0.5, 0.0, 2.0])
    assert day.largest_sigmas == 4.0
    assert all(math.isnan(value) for value in Count().rms)


def test_workers_end_with_the_benchmark_although_they_have_work() -> None:
    with workers(1) as pool:
        pool.submit(time.sleep, 0.0).result()
        pool.submit(time.sleep, 3600.0)
    assert not active_children()


DELIVERIES = [
    Delivery(camera, k * 50 * MS, k, k * 50 * MS, k * 50 * MS + 5 * MS)
    for k in range(40)
    for camera in CAMERAS
]


@pytest.mark.parametrize("way", times.WAYS.ways, ids=lambda way: way.name)
def test_a_way_of_times_touches_nothing_before_its_onset(way: Way) -> None:
    changed = way.name == "clean_times"
    for seed in range(6):
        mistimed = way.make(Draw(np.random.default_rng(seed)))
        assert isinstance(mistimed, Mistimed)
        after = mistimed.change(DELIVERIES, 500 * MS)
        assert [one for one in after if one.true_ns < 500 * MS] == DELIVERIES[
            :20
        ] or mistimed.note.startswith("of ")
        changed |= sorted(after, key=str) != sorted(DELIVERIES, key=str)
    assert changed


def test_a_held_process_gets_what_the_drivers_kept_and_then_new_frames() -> None:
    for seed in range(6):
        mistimed = times.process_held(Draw(np.random.default_rng(seed)))
        after = mistimed.change(DELIVERIES, 500 * MS)
        during = [one for one in after if 0 <= one.true_ns - 500 * MS < mistimed.held_ns]
        assert all(one.arrives_ns == 500 * MS + mistimed.held_ns for one in during)
        assert len(during) <= 2 * int(mistimed.note.split()[2])


def test_numbers_that_are_none_are_drawn_for_config_and_calibration() -> None:
    drawn = [way.make(Draw(np.random.default_rng(seed))) for way in numbers.WAYS.ways for seed in range(20)]
    assert all(isinstance(one, Misnumbered) for one in drawn)
    assert {one.is_none for one in drawn if isinstance(one, Misnumbered)} == {True, False}
