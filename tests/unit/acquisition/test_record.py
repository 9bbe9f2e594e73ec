from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light

from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.record import record
from altd.config import Measuring
from altd.ports import CameraBusyError, CameraEndedError, CameraError, LampsError
from altd.recording.header import Kind, TargetHeader, UnitHeader
from altd.recording.reader import open_recording
from altd.records import CameraIdentity, Frame, Origin
from altd.status.health import Health

PIXELS = frame(light(Blob(300, 200))).pixels
FOLLOW_NS = 30_000_000
"""Delay from the lamps' line to their light."""
UNIT = UnitHeader(serial="A", target_distance_mm=280.0)


class Source:
    """Delivers a number of frames and then fails, or is at its end."""

    origin = Origin.CAMERA
    playback = False
    identity: CameraIdentity | None = None
    waits = True
    clock: FakeClock

    def __init__(self, name: str, frames: int, end: Exception) -> None:
        self.name = name
        self.left = frames
        self.end = end

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        if not self.left:
            raise self.end
        self.left -= 1
        self.clock.wait(threading.Event(), 0.05)
        return Frame(self.name, 100 - self.left, (100 - self.left) * 50_000_000, PIXELS)

    def close(self) -> None: ...


async def recorded(sources: Sequence[Source], path: Path, plan: RecordingPlan) -> int:
    clock = FakeClock.of_loop()
    for source in sources:
        source.clock = clock
    return await clock.run(record(FrameSets(sources, Measuring(), Health(clock)), path, plan))


async def kept(path: Path, end: Exception, kind: Kind = "measurement") -> int:
    sources = [Source(name, 5, end) for name in ("front", "rear")]
    return await recorded(sources, path, RecordingPlan(60.0, UNIT, kind=kind))


async def test_a_recording_says_which_targets_its_cameras_look_at(tmp_path: Path) -> None:
    targets = (TargetHeader(name="exit", z_mm=10.0, camera="left"),)
    sources = [Source(name, 2, CameraEndedError("the end")) for name in ("left", "spare")]
    plan = RecordingPlan(60.0, UnitHeader(serial="A"), targets)
    await recorded(sources, tmp_path / "rec", plan)
    assert open_recording(tmp_path / "rec").header.targets == targets


@pytest.mark.parametrize("busy", [("rear",), ("front", "rear")])
async def test_a_camera_that_another_program_has_ends_the_recording_and_says_what_to_do(
    busy: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise CameraBusyError("another program uses it")

    sources = [Source(name, 100_000, CameraEndedError("the end")) for name in ("front", "rear")]
    for source in sources:
        if source.name in busy:
            monkeypatch.setattr(source, "open", refuse)
    with pytest.raises(CameraError, match="camera rear: busy: another program uses it; ") as error:
        await recorded(sources, tmp_path / "rec", RecordingPlan(60.0, UNIT))
    assert "systemctl stop altd" in str(error.value)
    assert "keep its last seconds" in str(error.value)
    assert not (tmp_path / "rec" / "front").exists()


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


@pytest.mark.parametrize("kind", ["measurement", "flat", "plate", "self-check"])
async def test_a_recording_says_of_what_kind_it_is(kind: Kind, tmp_path: Path) -> None:
    await kept(tmp_path / "rec", CameraEndedError("the end"), kind)
    assert open_recording(tmp_path / "rec").header.kind == kind


async def test_a_defect_in_a_driver_is_not_taken_for_the_end(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        await kept(tmp_path / "rec", ZeroDivisionError())
    assert len(open_recording(tmp_path / "rec").rows) > 0  # the part written until then is complete


class LyingSource(Source):
    """One frame's number is 900 ahead, and one comes with the time of long ago."""

    def next_frame(self, timeout_s: float) -> Frame:
        frame = super().next_frame(timeout_s)
        if self.left == 12:
            return replace(frame, sequence=frame.sequence + 900)
        return replace(frame, t_ns=0) if self.left == 6 else frame


async def test_numbers_and_times_that_lie_do_not_make_it_unreadable(tmp_path: Path) -> None:
    sources = [LyingSource(name, 20, CameraEndedError("the end")) for name in ("front", "rear")]
    exposures = await recorded(sources, tmp_path / "rec", RecordingPlan(60.0, UNIT))
    recording = open_recording(tmp_path / "rec")
    assert len({row.sequence for row in recording.rows}) == exposures > 10


class LitSource:
    """A camera that exposes every 10 ms; each frame shows whether the lamps were lit while it was exposed."""

    origin = Origin.CAMERA
    playback = False
    identity: CameraIdentity | None = None
    waits = False

    def __init__(self, name: str, lamps: ListedLamps, clock: FakeClock, frames: int = 10_000) -> None:
        self.name = name
        self._lamps = lamps
        self._clock = clock
        self._closed = threading.Event()
        self._number = 0
        self._frames = frames
        self._start_ns = clock.now_ns

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        self._number += 1
        if self._number > self._frames:
            raise CameraEndedError("the end")
        t_ns = self._start_ns + self._number * 10_000_000
        # the exposure takes 8 ms
        self._clock.wait(self._closed, (t_ns + 4_000_000 - self._clock.now_ns) * 1e-9)
        pixels = np.full((24, 32), self._lamps.level(t_ns - 4_000_000, t_ns + 4_000_000), np.uint8)
        return Frame(self.name, self._number, t_ns, pixels)

    def close(self) -> None: ...


class ListedLamps:
    """Lamps that remember when they were switched, and fail at the given switching."""

    def __init__(self, clock: FakeClock, fails_at: int | None = None) -> None:
        self._clock = clock
        self.switched: list[tuple[int, bool]] = [(0, False)]
        self.is_open = False
        self._fails_at = fails_at

    def open(self) -> None:
        self.is_open = True

    def switch(self, on: bool) -> None:
        if len(self.switched) == self._fails_at:
            raise LampsError("line 3 is taken away")
        self.switched.append((self._clock.now_ns + FOLLOW_NS, on))

    def close(self) -> None:
        self.switched.append((self._clock.now_ns, False))
        self.is_open = False

    def level(self, begin_ns: int, end_ns: int) -> int:
        """0 dark throughout, 200 lit throughout, 100 switched meanwhile."""
        before = [on for t_ns, on in self.switched if t_ns <= begin_ns][-1]
        if any(begin_ns < t_ns < end_ns and on is not before for t_ns, on in self.switched):
            return 100
        return 200 if before else 0


async def switched(path: Path, clock: FakeClock, lamps: ListedLamps, frames: int = 10_000) -> int:
    sources = [LitSource(name, lamps, clock, frames) for name in ("front", "rear")]
    sets = FrameSets(sources, Measuring(), Health(clock))
    plan = RecordingPlan(1.0, UNIT, kind="self-check")
    return await clock.run(record(sets, path, plan, lamps=lamps))


async def test_a_self_check_keeps_dark_and_lit_frames_in_turn_and_none_between(
    tmp_path: Path, clock: FakeClock
) -> None:
    lamps = ListedLamps(clock)
    exposures = await switched(tmp_path / "rec", clock, lamps)
    opened = open_recording(tmp_path / "rec")
    levels = [(row.leds_on, int(opened.frame(row).pixels.min())) for row in opened.rows.of("rear")]
    assert len(levels) == exposures >= 4
    assert levels == [(bool(index % 2), 200 * (index % 2)) for index in range(exposures)]
    assert not lamps.is_open
    assert not lamps.switched[-1][1]


async def test_a_self_check_whose_lamps_are_lost_says_so_and_keeps_what_it_has(
    tmp_path: Path, clock: FakeClock
) -> None:
    lamps = ListedLamps(clock, fails_at=4)
    with pytest.raises(LampsError, match="line 3 is taken away"):
        await switched(tmp_path / "rec", clock, lamps)
    assert not lamps.is_open
    assert len(open_recording(tmp_path / "rec").rows) == 6


async def test_a_self_check_whose_camera_ends_says_so(tmp_path: Path, clock: FakeClock) -> None:
    lamps = ListedLamps(clock)
    with pytest.raises(CameraError):
        await switched(tmp_path / "rec", clock, lamps, frames=30)
    assert not lamps.is_open
    assert not lamps.switched[-1][1]
