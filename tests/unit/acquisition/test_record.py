from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from support.frames import Blob, frame, light

from altd.acquisition.auto_exposure.control import MARKED_FRAMES, ExposureControl
from altd.acquisition.record import record
from altd.config import ExposureSettings, Measuring
from altd.ports import CameraEndedError, ExposureRange
from altd.recording.header import Kind, TargetHeader, UnitHeader
from altd.recording.reader import open_recording
from altd.records import CameraIdentity, Frame, Origin
from altd.runtime.clock import SystemClock
from altd.status.health import Health

PIXELS = frame(light(Blob(300, 200))).pixels


class Source:
    """Delivers a number of frames and then fails, or is at its end."""

    origin = Origin.CAMERA
    playback = False
    identity: CameraIdentity | None = None
    waits = True

    def __init__(self, name: str, frames: int, end: Exception) -> None:
        self.name = name
        self.left = frames
        self.end = end

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        if not self.left:
            raise self.end
        self.left -= 1
        time.sleep(0.001)
        return Frame(self.name, 100 - self.left, (100 - self.left) * 50_000_000, PIXELS)

    def close(self) -> None: ...


async def kept(path: Path, end: Exception, kind: Kind = "measurement") -> int:
    sources = [Source(name, 5, end) for name in ("front", "rear")]
    clock = SystemClock()
    unit = UnitHeader(serial="A", target_distance_mm=280.0)
    return await record(sources, path, unit, Measuring(), Health(clock), clock.utc, 60.0, kind)


async def test_a_recording_says_which_targets_its_cameras_look_at(tmp_path: Path) -> None:
    targets = (TargetHeader(name="exit", z_mm=10.0, camera="left"),)
    clock = SystemClock()
    sources = [Source(name, 2, CameraEndedError("the end")) for name in ("left", "spare")]
    await record(
        sources,
        tmp_path / "rec",
        UnitHeader(serial="A"),
        Measuring(),
        Health(clock),
        clock.utc,
        60.0,
        targets=targets,
    )
    assert open_recording(tmp_path / "rec").header.targets == targets


async def test_a_recording_ends_with_its_sources(tmp_path: Path) -> None:
    assert await kept(tmp_path / "rec", CameraEndedError("the end")) == 5
    opened = open_recording(tmp_path / "rec")
    assert [row.sequence for row in opened.rows if row.camera == "rear"] == [0, 1, 2, 3, 4]


async def test_a_recording_says_which_cameras_it_is_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Source, "identity", CameraIdentity("F-1", "mini", "aravis"))
    await kept(tmp_path / "rec", CameraEndedError("the end"))
    assert open_recording(tmp_path / "rec").header.cameras["rear"].identity == Source.identity


@pytest.mark.parametrize("kind", ["measurement", "flat", "self-check"])
async def test_a_recording_says_of_what_kind_it_is(kind: Kind, tmp_path: Path) -> None:
    await kept(tmp_path / "rec", CameraEndedError("the end"), kind)
    assert open_recording(tmp_path / "rec").header.kind == kind


class SettableSource(Source):
    """A source with an exposure to set."""

    def __init__(self, name: str, frames: int, end: Exception) -> None:
        super().__init__(name, frames, end)
        self.exposure_range = ExposureRange(0.1, 10.0, 0.0, 0.0)
        self.asked: list[float] = []

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        self.asked.append(exposure_ms)


async def test_exposure_is_set_once_and_what_was_exposed_meanwhile_is_not_kept(tmp_path: Path) -> None:
    sources = [SettableSource(name, 12, CameraEndedError("the end")) for name in ("front", "rear")]
    clock = SystemClock()
    unit = UnitHeader(serial="A", target_distance_mm=280.0)
    exposure = {"front": ExposureControl(ExposureSettings(exposure_ms=3.0), 20.0, 20)}
    health = Health(clock)
    kept = await record(
        sources, tmp_path / "rec", unit, Measuring(), health, clock.utc, 60.0, exposure=exposure
    )
    assert [source.asked for source in sources] == [[3.0], []]
    assert kept == 12 - MARKED_FRAMES


async def test_a_defect_in_a_driver_is_not_taken_for_the_end(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        await kept(tmp_path / "rec", ZeroDivisionError())
    assert len(open_recording(tmp_path / "rec").rows) > 0  # what was written until then is whole


class LyingSource(Source):
    """One frame's number is 900 ahead, and one comes with the time of long ago."""

    def next_frame(self, timeout_s: float) -> Frame:
        frame = super().next_frame(timeout_s)
        if self.left == 12:
            return replace(frame, sequence=frame.sequence + 900)
        return replace(frame, t_ns=0) if self.left == 6 else frame


async def test_numbers_and_times_that_lie_do_not_make_it_unreadable(tmp_path: Path) -> None:
    sources = [LyingSource(name, 20, CameraEndedError("the end")) for name in ("front", "rear")]
    clock = SystemClock()
    unit = UnitHeader(serial="A", target_distance_mm=280.0)
    exposures = await record(sources, tmp_path / "rec", unit, Measuring(), Health(clock), clock.utc, 60.0)
    recording = open_recording(tmp_path / "rec")
    assert len({row.sequence for row in recording.rows}) == exposures > 10
