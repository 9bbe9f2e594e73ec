"""The soak benchmark: its judge, and a few minutes of it."""

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.campaign.clips import SimulatedRig, rig_of
from benchmarks.process_memory import ProcessSample
from benchmarks.soak import HOUR, UNIT, Soak, lost_cameras, run

FLAT = tuple(ProcessSample(hour, 300.0 + hour % 2, 37, 10) for hour in range(1, 21))
GOOD = Soak(list(FLAT), delivered=1000, measured=1000, lost=0, valid=990)


def test_a_flat_course_has_no_fault() -> None:
    assert list(GOOD.faults()) == []


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (replace(GOOD, samples=[replace(s, memory_mb=300 + 1.2 * s.hour) for s in FLAT]), "memory grows"),
        (replace(GOOD, samples=[replace(s, descriptors=30 + int(s.hour)) for s in FLAT]), "descriptors grow"),
        (replace(GOOD, samples=[replace(s, threads=10 + int(s.hour > 15)) for s in FLAT]), "threads grow"),
        (replace(GOOD, lost=1), "1 frames lost"),
        (replace(GOOD, measured=999), "999 of 1000"),
    ],
)
def test_what_grows_or_is_lost_is_a_fault(wrong: Soak, said: str) -> None:
    (fault,) = wrong.faults()
    assert said in fault


def test_each_hour_loses_six_frames_and_ten_exposures() -> None:
    lost = [lost_cameras(k) for k in range(HOUR)]
    assert [sum(len(each) == count for each in lost) for count in (1, 2)] == [6, 10]


def test_a_quarter_of_an_hour_measures_each_exposure(tmp_path: Path) -> None:
    rig = rig_of(UNIT)
    assert isinstance(rig, SimulatedRig)
    soak = asyncio.run(run(0.25, rig, tmp_path, None))
    assert (soak.measured, soak.lost, len(soak.samples)) == (soak.delivered, 0, 1)
    assert soak.valid > 0.98 * soak.delivered
    assert (tmp_path / "history.db").exists()
