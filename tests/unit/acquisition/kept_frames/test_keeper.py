"""Files written after a fault and on request, by a clock that the test moves; the disk is a real one."""

import asyncio
import contextlib
import gc
import threading
import weakref
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from support.clock import FakeClock, stop
from support.frames import Blob, frame, light

from altd.acquisition.exposures_writer import ExposuresWriter, RecordingPlan
from altd.acquisition.kept_frames import keeper as keeper_module
from altd.acquisition.kept_frames.keeper import FrameKeeper, Source
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.kept_frames.store import RecordingStore
from altd.config import KeptFrames, Measuring
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.recording.header import UnitHeader
from altd.recording.reader import open_recording
from altd.records import Frame, Origin
from altd.status.availability import Availability
from altd.status.cause import Cause, Kind, ShownCause, StateReport, worst
from altd.status.conditions import Condition
from altd.status.health import Component, Health, State
from altd.status.services import KeptRecording, NotKeptError

PERIOD_NS = 50_000_000
CAMERAS = "front", "rear"
PIXELS = frame(light(Blob(60, 40), width=120, height=80)).pixels
SETTINGS = KeptFrames(before_s=2.0, after_s=0.5, again_after_s=60.0)
FAULT = Cause(Reason.SPOT_MISSING, "front")


class Camera:
    identity = None
    origin = Origin.SIMULATED
    playback = False


@dataclass
class Unit:
    """A keeper, the causes that it is shown, and cameras that deliver as its clock advances."""

    folder: Path
    settings: KeptFrames = SETTINGS
    clock: FakeClock = field(default_factory=lambda: FakeClock(100 * 10**9))
    causes: list[Cause] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ring = FrameRing(1 << 24, 4 * 10**9, lambda _: None)
        plan = RecordingPlan(0.0, UnitHeader(serial="ALT-7", target_distance_mm=280.0), by="altd run")
        cameras = {name: Camera() for name in CAMERAS}
        source = Source(self.ring, cameras, Measuring(), plan)  # type: ignore[arg-type]
        self.component: Component = Health(self.clock).component("kept frames")
        self.store = RecordingStore(self.folder, self.settings.disk_mb << 20)
        self.keeper = FrameKeeper(source, self.settings, self.store, self.report, self.component)

    def report(self) -> StateReport:
        now_ns = self.clock.monotonic_ns()
        shown = tuple(ShownCause(cause, now_ns, True, 1) for cause in self.causes)
        return StateReport(worst(shown), 0, now_ns, shown, Availability(0))

    async def expose(self, exposures: int, **marks: object) -> None:
        for _ in range(exposures):
            await self.clock.advance(PERIOD_NS * 1e-9)
            number = self.clock.now_ns // PERIOD_NS
            for camera in CAMERAS:
                self.ring.keep(Frame(camera, number, number * PERIOD_NS, PIXELS, **marks))  # type: ignore[arg-type]

    async def expose_watched(self, exposures: int) -> list[weakref.ref[np.ndarray]]:
        """The same, with pixels of their own, which are watched."""
        watched = []
        for _ in range(exposures):
            await self.clock.advance(PERIOD_NS * 1e-9)
            number = self.clock.now_ns // PERIOD_NS
            for camera in CAMERAS:
                pixels = PIXELS.copy()
                watched.append(weakref.ref(pixels))
                self.ring.keep(Frame(camera, number, number * PERIOD_NS, pixels))
        return watched

    async def is_idle(self) -> None:
        """The disk's thread has come back."""
        assert self.keeper._disk is not None  # noqa: SLF001
        await self.keeper._disk.call(lambda: None, within_s=20)  # noqa: SLF001

    async def written(self, count: int) -> KeptRecording:
        """The newest recording, once there are so many."""
        async with asyncio.timeout(60):
            while len(self.keeper.recordings) < count:  # noqa: ASYNC110  a real disk, not this clock
                await asyncio.sleep(0.005)
        return self.keeper.recordings[0]

    async def nothing_more(self, count: int) -> None:
        await self.expose(100)
        await asyncio.sleep(0.05)
        assert len(self.keeper.recordings) == count


class Disk:
    """Takes an exposure, and answers once it may."""

    def __init__(self, patch: pytest.MonkeyPatch, is_full: bool = False) -> None:
        self.is_written, self.goes_on = threading.Event(), threading.Event()
        write = ExposuresWriter.write

        def held(writer: ExposuresWriter, pair: Pair[Frame]) -> None:
            self.is_written.set()
            assert self.goes_on.wait(60)
            if is_full:
                raise OSError(28, "No space left on device")
            write(writer, pair)

        patch.setattr(ExposuresWriter, "write", held)


ENDS = {
    "refused": NotKeptError,
    "failed": NotKeptError,
    "timed out": NotKeptError,
    "cancelled": asyncio.CancelledError,
    "kept": KeptRecording,
}


@contextlib.contextmanager
def no_garbage_collector() -> Iterator[None]:
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextlib.asynccontextmanager
async def running(unit: Unit) -> AsyncIterator[Unit]:
    task = asyncio.create_task(unit.keeper.run())
    try:
        async with asyncio.timeout(60):
            while unit.component.state is State.STARTING:  # noqa: ASYNC110  a real disk, not this clock
                await asyncio.sleep(0.001)
        yield unit
    finally:
        await stop(task)


@pytest.fixture
async def unit(tmp_path: Path) -> AsyncIterator[Unit]:
    async with running(Unit(tmp_path)) as unit:
        yield unit


def times_s(unit: Unit, kept: KeptRecording) -> list[float]:
    return [row.t_s for row in open_recording(unit.store.folder_of(kept.name)).rows if row.camera == "front"]


async def test_after_a_fault_the_seconds_before_and_after_it_are_written(unit: Unit) -> None:
    await unit.expose(100)
    unit.causes.append(FAULT)
    await unit.expose(40)
    kept = await unit.written(1)
    assert kept.why == "spot_missing front"
    assert kept.name == "20261120T080143Z-spot_missing-front"  # 2 s before 105 s
    assert (kept.start or "").startswith("2026-11-20T08:01:43.")
    at_s = times_s(unit, kept)
    assert at_s[-1] - at_s[0] == pytest.approx(2.5, abs=0.06)
    assert kept.exposures == len(at_s) == round(kept.seconds * 20)
    recording = open_recording(unit.store.folder_of(kept.name))
    assert recording.header.kind == "measurement"
    assert recording.header.unit.serial == "ALT-7"
    assert recording.header.note == "altd run, simulated"
    assert recording.header.cameras["front"].origin is Origin.SIMULATED
    assert (recording.frame(next(iter(recording.rows))).pixels == PIXELS).all()


async def test_a_fault_that_stays_is_written_once_and_again_when_it_comes_back_much_later(unit: Unit) -> None:
    await unit.expose(60)
    unit.causes.append(FAULT)
    await unit.expose(20)
    await unit.written(1)
    await unit.nothing_more(1)
    unit.causes.clear()
    await unit.expose(20)
    unit.causes.append(FAULT)
    await unit.nothing_more(1)
    unit.causes.clear()
    await unit.expose(round(20 * SETTINGS.again_after_s))
    unit.causes.append(FAULT)
    await unit.expose(20)
    assert (await unit.written(2)).why == "spot_missing front"


@pytest.mark.parametrize(
    "kind",
    [Condition.STARTING, Condition.CALIBRATION_DUE, Reason.SIMULATED, Reason.PLAYBACK, Reason.NOT_LIVE],
)
async def test_what_is_no_fault_is_not_written(unit: Unit, kind: Kind) -> None:
    await unit.expose(60)
    unit.causes.append(Cause(kind))
    await unit.nothing_more(0)


async def test_a_fault_of_a_simulated_unit_is_written_and_another_one_too(unit: Unit) -> None:
    """*Check function* from the start is the worse signal; the fault beside it counts alone."""
    unit.causes.append(Cause(Reason.SIMULATED))
    await unit.expose(60)
    await unit.nothing_more(0)
    unit.causes.append(FAULT)
    await unit.expose(20)
    assert (await unit.written(1)).why == "spot_missing front"
    unit.causes.append(Cause(Reason.CAMERA_SILENT, "rear"))
    await unit.expose(20)
    assert (await unit.written(2)).why == "camera_silent rear"


async def test_by_its_settings_it_writes_only_when_asked(tmp_path: Path) -> None:
    async with running(Unit(tmp_path, SETTINGS.model_copy(update={"on_fault": False}))) as unit:
        await unit.expose(60)
        unit.causes.append(FAULT)
        await unit.nothing_more(0)
        kept = await unit.keeper.keep("asked by http 10.0.0.7")
        assert kept.why == "asked by http 10.0.0.7"
        assert kept.name.endswith("-asked-by-http-10-0-0-7")
        assert 1.9 < kept.seconds <= 2.1
        assert unit.keeper.recordings == (kept,)
        assert unit.component.state is State.OK
        assert unit.component.message == "1 recording, 0 of 2000 MB"


async def test_exposures_of_a_change_are_left_out_and_lit_ones_say_so(unit: Unit) -> None:
    await unit.expose(10)
    await unit.expose(5, changing=True)
    await unit.expose(3, leds_on=True)
    kept = await unit.keeper.keep("asked")
    rows = open_recording(unit.store.folder_of(kept.name)).rows
    assert [row.leds_on for row in rows if row.camera == "rear"] == [False] * 10 + [True] * 3


async def test_without_a_frame_there_is_nothing_to_keep_and_it_is_said(unit: Unit) -> None:
    with pytest.raises(NotKeptError, match="no frames in the last seconds"):
        await unit.keeper.keep("asked")
    assert unit.component.counters == {"not_kept": 1}
    assert unit.component.state is State.OK, "the cameras fail, and say so: this does what it should"
    await unit.expose(3)
    await unit.keeper.keep("asked")
    assert (unit.component.state, unit.component.counters) == (State.OK, {"not_kept": 1, "kept": 1})


async def test_one_camera_alone_makes_no_exposure(unit: Unit) -> None:
    for number in range(10):
        unit.ring.keep(Frame("front", number, unit.clock.now_ns - number, PIXELS))
    with pytest.raises(NotKeptError, match="no exposure of all cameras"):
        await unit.keeper.keep("asked")


async def test_a_flood_of_requests_is_refused(unit: Unit) -> None:
    await unit.expose(40)
    answers = await asyncio.gather(
        *(unit.keeper.keep(f"asked {n}") for n in range(50)), return_exceptions=True
    )
    refused = [answer for answer in answers if isinstance(answer, NotKeptError)]
    assert len(refused) == 46
    assert str(refused[0]) == "4 recordings are being written already"
    assert len(unit.keeper.recordings) == 4


async def test_a_folder_that_cannot_be_had_is_told_and_nothing_else_happens(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    async with running(Unit(tmp_path / "file" / "recordings")) as unit:
        await unit.expose(60)
        assert unit.component.state is State.DEGRADED
        assert "recordings cannot be kept" in unit.component.message
        unit.causes.append(FAULT)
        await unit.expose(20)
        async with asyncio.timeout(60):
            while not unit.component.counters:  # noqa: ASYNC110  a real disk, not this clock
                await asyncio.sleep(0.005)
        assert unit.component.message.startswith("spot_missing front was not recorded: ")


async def test_a_disk_that_hangs_while_a_recording_is_read_holds_nothing(
    unit: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs = threading.Event()
    await unit.expose(40)
    kept = await unit.keeper.keep("asked")
    assert (await unit.keeper.files(kept.name))[-1] == "recording.json"
    monkeypatch.setattr(keeper_module, "_READ_TIMEOUT_S", 0.05)
    monkeypatch.setattr(unit.store, "content", lambda *_: hangs.wait(60))
    try:
        with pytest.raises(NotKeptError, match="does not answer"):
            await unit.keeper.content(kept.name, "recording.json")
        (held,) = [each for each in threading.enumerate() if each.name == "kept-frames read"]
        assert held.daemon, "the end of the process would wait for it"
    finally:
        hangs.set()
        held.join()


@pytest.mark.parametrize("how", ["timed out", "cancelled"])
async def test_a_recording_that_was_refused_is_not_there_when_the_disk_comes_back(
    unit: Unit, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    await unit.expose(40)
    before = await unit.keeper.keep("before")
    with monkeypatch.context() as slow:
        disk = Disk(slow)
        if how == "timed out":
            slow.setattr(keeper_module, "_DISK_TIMEOUT_S", 0.05)
        asked = asyncio.create_task(unit.keeper.keep("asked"))
        assert await asyncio.to_thread(disk.is_written.wait, 60)
        if how == "cancelled":
            asked.cancel()
        (end,) = await asyncio.gather(asked, return_exceptions=True)
        assert isinstance(end, ENDS[how]), end
        disk.goes_on.set()
        await unit.is_idle()
    assert unit.keeper.recordings == unit.store.recordings() == (before,)
    later = await unit.keeper.keep("later")
    assert unit.keeper.recordings == unit.store.recordings() == (later, before)


async def test_a_recording_that_is_there_is_not_refused_because_the_others_cannot_be_listed(
    unit: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    await unit.expose(40)
    before = await unit.keeper.keep("before")
    add = unit.store.add

    def add_and_fail(*arguments: Any) -> KeptRecording:
        kept = add(*arguments)
        monkeypatch.setattr(unit.store, "recordings", Mock(side_effect=OSError(5, "Input/output error")))
        return kept

    monkeypatch.setattr(unit.store, "add", add_and_fail)
    kept = await unit.keeper.keep("asked")
    assert unit.keeper.recordings == (kept, before)


async def test_a_mark_that_was_refused_is_not_there_when_the_disk_comes_back(
    unit: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    await unit.expose(40)
    kept = await unit.keeper.keep("asked")
    goes_on, mark = threading.Event(), unit.store.mark
    with monkeypatch.context() as slow:
        slow.setattr(keeper_module, "_DISK_TIMEOUT_S", 0.05)
        slow.setattr(unit.store, "mark", lambda *of: goes_on.wait(60) and mark(*of))
        with pytest.raises(NotKeptError, match="does not answer"):
            await unit.keeper.mark(kept.name, True)
        goes_on.set()
        await unit.is_idle()
    assert unit.keeper.recordings == unit.store.recordings() == (kept,)
    assert (await unit.keeper.mark(kept.name, True)).marked


@pytest.mark.parametrize(
    ("error", "said"),
    [(MemoryError("no room"), "a defect: MemoryError: no room"), (OSError(5, "Input/output error"), "Input")],
)
async def test_whatever_fails_is_said_and_the_next_is_kept(
    unit: Unit, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    def fail(*_: object) -> None:
        raise error

    await unit.expose(40)
    with monkeypatch.context() as broken:
        broken.setattr(unit.store, "add", fail)
        with pytest.raises(NotKeptError, match=said):
            await unit.keeper.keep("asked")
    assert (unit.component.state, unit.component.counters) == (State.DEGRADED, {"not_kept": 1})
    assert (await unit.keeper.keep("asked")).exposures > 0


@pytest.mark.parametrize("how", ["refused", "failed", "timed out", "cancelled", "kept"])
async def test_frames_are_let_go_without_the_garbage_collector_however_a_recording_ends(
    unit: Unit, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    disk = Disk(monkeypatch, is_full=how == "failed")
    if how == "refused":
        monkeypatch.setattr(unit.store, "_max_bytes", 1)
    if how == "timed out":
        monkeypatch.setattr(keeper_module, "_DISK_TIMEOUT_S", 0.05)
    if how in ("refused", "failed", "kept"):
        disk.goes_on.set()
    with no_garbage_collector():
        frames = await unit.expose_watched(20)
        asked = asyncio.create_task(unit.keeper.keep("asked"))
        if how == "cancelled":
            assert await asyncio.to_thread(disk.is_written.wait, 60)
            asked.cancel()
        (end,) = await asyncio.gather(asked, return_exceptions=True)
        assert isinstance(end, ENDS[how]), end
        del end, asked
        disk.goes_on.set()
        await unit.is_idle()
        await unit.expose(100)
        assert not [each for each in frames if each() is not None]


async def test_recordings_that_wait_for_one_another_hold_no_frames(
    unit: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    with no_garbage_collector():
        await unit.expose(20)
        first = asyncio.create_task(unit.keeper.keep("first"))
        assert await asyncio.to_thread(disk.is_written.wait, 60)
        frames = await unit.expose_watched(20)
        second = asyncio.create_task(unit.keeper.keep("second"))
        await unit.expose(60)
        third = asyncio.create_task(unit.keeper.keep("third"))
        await unit.expose(60)
        assert not [each for each in frames if each() is not None]
    disk.goes_on.set()
    assert (await first).exposures == 20
    with pytest.raises(NotKeptError, match="the disk was too slow"):
        await second
    assert (await third).exposures == 21, "the second that the memory still holds of its two"
