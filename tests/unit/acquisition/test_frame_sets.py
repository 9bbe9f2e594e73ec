from __future__ import annotations

import threading
import time

import pytest
from support.frames import Blob, frame, light

from altd.acquisition import frame_sets
from altd.acquisition.auto_exposure.control import MAX_MARKED_FRAMES, ExposureControl
from altd.acquisition.frame_sets import FrameSets
from altd.config import ExposureSettings, Measuring
from altd.ports import CameraEndedError, CameraError, ExposureRange
from altd.records import Frame, Origin
from altd.runtime.clock import SystemClock
from altd.status.health import Health

PIXELS = frame(light(Blob(300, 200))).pixels
PERIOD_NS = 20_000_000


class Camera:
    """Exposures of a whole period, back to back: number k lasts from k - 1/2 to k + 1/2 periods."""

    origin = Origin.CAMERA
    playback = False
    waits = True
    exposure_range = None
    identity = None

    start_ns = 0

    def __init__(
        self, name: str, lost: tuple[int, ...] = (), last: int = 1000, changing: tuple[int, ...] = ()
    ) -> None:
        self.name = name
        self.changing = changing
        self.lost = lost
        self.last = last
        self.number = -1

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        self.number += 1
        while self.number in self.lost:
            self.number += 1
        if self.number > self.last:
            raise CameraEndedError("the recording is at its end")
        t_ns = self.start_ns + self.number * PERIOD_NS
        time.sleep(max(t_ns + PERIOD_NS // 2 - time.monotonic_ns(), 0) * 1e-9)  # it is read out at its end
        return Frame(self.name, self.number, t_ns, PIXELS, changing=self.number in self.changing)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None: ...

    def close(self) -> None: ...


def of(*cameras: Camera) -> FrameSets:
    start_ns = time.monotonic_ns()
    for camera in cameras:
        camera.start_ns = start_ns
    return FrameSets(cameras, Measuring(), Health(SystemClock()))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.7, 0.999])
async def test_no_exposure_that_was_under_way_is_taken(share: float) -> None:
    front, rear = Camera("front"), Camera("rear")
    async with of(front, rear) as cameras:
        settled_ns = front.start_ns + round((7 + share) * PERIOD_NS)
        taken = await cameras.after(settled_ns, 3)
    begins_ns = [pair.t_ns - PERIOD_NS // 2 for pair in taken]
    assert begins_ns[0] >= settled_ns
    assert begins_ns[0] - settled_ns < 2 * PERIOD_NS
    assert [pair.sequence for pair in taken] == [taken[0].sequence + k for k in range(3)]


async def test_an_exposure_that_one_camera_lost_is_left_out() -> None:
    front, rear = Camera("front", lost=(5,)), Camera("rear", lost=(7,))
    async with of(front, rear) as cameras:
        taken = await cameras.after(front.start_ns + round(3.9 * PERIOD_NS), 3)
    assert [pair.sequence for pair in taken] == [6, 8, 9]
    assert all(set(pair.items) == {"front", "rear"} for pair in taken)


async def test_an_exposure_during_which_a_camera_was_being_set_is_left_out() -> None:
    front, rear = Camera("front", changing=(5,)), Camera("rear", changing=(7,))
    async with of(front, rear) as cameras:
        taken = await cameras.after(front.start_ns + round(3.9 * PERIOD_NS), 3)
    assert [pair.sequence for pair in taken] == [6, 8, 9]


async def test_the_exposure_is_set_when_a_camera_is_opened_and_counts_from_then_on() -> None:
    asked: list[tuple[float, float]] = []

    class Settable(Camera):
        exposure_range = ExposureRange(0.1, 10.0, 0.0, 0.0)

        def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
            asked.append((exposure_ms, gain_db))

    front, rear = Settable("front"), Camera("rear")
    front.start_ns = rear.start_ns = time.monotonic_ns()
    exposure = {"front": ExposureControl(ExposureSettings(exposure_ms=3.0), 20.0, 20)}
    async with FrameSets((front, rear), Measuring(), Health(SystemClock()), exposure) as cameras:
        taken = await cameras.after(front.start_ns - PERIOD_NS, 3)
    assert asked == [(3.0, 0.0)]
    assert taken[0].sequence > MAX_MARKED_FRAMES
    assert {pair.items["front"].exposure_ms for pair in taken} == {3.0}


async def test_a_camera_at_its_end_is_named() -> None:
    async with of(Camera("front"), Camera("rear", last=3)) as cameras:
        with pytest.raises(CameraError, match="camera rear: the recording is at its end"):
            await cameras.after(0, 100)


async def test_a_silent_camera_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_sets, "FRAME_SET_TIMEOUT_S", 0.3)
    silence = threading.Event()

    class Silent(Camera):
        def next_frame(self, timeout_s: float) -> Frame:
            silence.wait(0.05)
            raise CameraError("no link")

    async with of(Camera("front"), Silent("rear")) as cameras:
        with pytest.raises(CameraError, match=r"^camera rear: no link"):
            await cameras.after(0, 1)
