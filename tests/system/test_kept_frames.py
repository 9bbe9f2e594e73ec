"""A fault at night: the daemon keeps the frames around it, and their replay shows what it measured."""

import asyncio
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from support.cli import altd_here
from support.led_unit import LedUnit, config, led_unit

from altd.config import KeptFrames
from altd.measuring.calibration import Calibration
from altd.records import Frame, Measurement
from altd.status.services import KeptRecording

pytestmark = pytest.mark.alone  # beside other tests it has once compared nothing, for a cause not yet found

WINDOW = 4
NUMBERS = "x_mm", "y_mm", "yaw_deg", "pitch_deg"


async def kept(running: LedUnit, why: str) -> KeptRecording:
    async with asyncio.timeout(30):
        while True:
            for recording in running.daemon.unit.recordings.recordings:
                if recording.why.startswith(why):
                    return recording
            await asyncio.sleep(0.05)


def dark(frame: Frame) -> Frame:
    """The laser is covered; the rest of the picture stays."""
    return replace(frame, pixels=np.minimum(frame.pixels, 12))


async def test_the_frames_of_a_fault_are_replayed_as_they_were_measured(
    calibration_of_unit_3: Calibration, unit_3: Path, tmp_path: Path
) -> None:
    settings = config(measuring={"window": WINDOW}).model_copy(
        update={"kept_frames": KeptFrames(before_s=2.0, after_s=1.0, folder=tmp_path / "recordings")}
    )
    live: dict[datetime, Measurement] = {}
    async with led_unit(calibration_of_unit_3, settings) as running:
        for _ in range(40):
            await running.measured(valid=True)
        running.seen.alter = dark
        recording = await kept(running, "spot_missing")
        for poll in running.polls:
            if (measurement := poll.measurement) is not None and measurement.time is not None:
                live[measurement.time] = measurement
        folder = tmp_path / "recordings" / recording.name
        assert (await running.daemon.unit.recordings.provider.keep("asked")).exposures > 20
    assert 2.5 < recording.seconds < 3.3

    replayed = altd_here("replay", folder, "--calibration", unit_3 / "cal.json", "--window", WINDOW)
    assert replayed.status == 0, replayed.err
    lines = replayed.objects
    assert len(lines) == recording.exposures
    valid = [line for line in lines if line["valid"]]
    assert len(valid) > 20
    assert not lines[-1]["valid"]
    assert {"front_spot_missing", "rear_spot_missing"} & set(lines[-1]["status"])
    compared = 0
    for line in valid[WINDOW:]:
        at = datetime.fromisoformat(line["time"])
        then = min(live, key=lambda utc: abs(utc - at))
        # The start of the recording and the time of a line are cut to milliseconds.
        if abs((then - at).total_seconds()) < 0.003 and live[then].valid:
            compared += 1
            for key in NUMBERS:
                assert line[key] == pytest.approx(live[then].number(key), abs=2e-4)
    assert compared > 15
