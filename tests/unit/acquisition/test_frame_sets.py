import threading
from typing import Self

import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light

from altd.acquisition.auto_exposure.control import MAX_MARKED_FRAMES, ExposureControl
from altd.acquisition.frame_sets import FrameSets
from altd.config import ExposureSettings, Measuring
from altd.measuring.pairing import Pair
from altd.ports import CameraEndedError, CameraError, ExposureRange
from altd.records import Frame, Origin
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

    clock: FakeClock
    start_ns = 0

    def __init__(
        self, name: str, lost: tuple[int, ...] = (), last: int = 1000, changing: tuple[int, ...] = ()
    ) -> None:
        self.name = name
        self.changing = changing
        self.lost = lost
        self.last = last
        self.number = -1
        self.closed = threading.Event()

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        self.number += 1
        while self.number in self.lost:
            self.number += 1
        if self.number > self.last:
            raise CameraEndedError("the recording is at its end")
        t_ns = self.start_ns + self.number * PERIOD_NS
        read_out_ns = t_ns + PERIOD_NS // 2
        self.clock.wait(self.closed, max(read_out_ns - self.clock.now_ns, 0) * 1e-9)
        return Frame(self.name, self.number, t_ns, PIXELS, changing=self.number in self.changing)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None: ...

    def close(self) -> None: ...


class Running:
    """Frame sets of cameras on a clock that the test drives."""

    def __init__(self, *cameras: Camera, exposure: dict[str, ExposureControl] | None = None) -> None:
        self.clock = FakeClock.of_loop()
        for camera in cameras:
            camera.clock, camera.start_ns = self.clock, self.clock.now_ns
        self._sets = FrameSets(cameras, Measuring(), Health(self.clock), exposure)

    async def __aenter__(self) -> Self:
        await self._sets.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.clock.end()
        await self._sets.__aexit__()

    async def after(self, t_ns: int, count: int) -> list[Pair[Frame]]:
        return await self.clock.run(self._sets.after(t_ns, count))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.7, 0.999])
async def test_no_exposure_that_was_under_way_is_taken(share: float) -> None:
    front, rear = Camera("front"), Camera("rear")
    async with Running(front, rear) as cameras:
        settled_ns = front.start_ns + round((7 + share) * PERIOD_NS)
        taken = await cameras.after(settled_ns, 3)
    begins_ns = [pair.t_ns - PERIOD_NS // 2 for pair in taken]
    assert begins_ns[0] >= settled_ns
    assert begins_ns[0] - settled_ns < 2 * PERIOD_NS
    assert [pair.sequence for pair in taken] == [taken[0].sequence + k for k in range(3)]


@pytest.mark.parametrize("why", ["lost", "changing"])
async def test_an_exposure_that_one_camera_lost_or_made_while_it_was_set_is_left_out(why: str) -> None:
    front, rear = Camera("front", **{why: (5,)}), Camera("rear", **{why: (7,)})
    async with Running(front, rear) as cameras:
        taken = await cameras.after(front.start_ns + round(3.9 * PERIOD_NS), 3)
    assert [pair.sequence for pair in taken] == [6, 8, 9]
    assert all(set(pair.items) == {"front", "rear"} for pair in taken)


async def test_the_exposure_is_set_when_a_camera_is_opened_and_counts_from_then_on() -> None:
    asked: list[tuple[float, float]] = []

    class Settable(Camera):
        exposure_range = ExposureRange(0.1, 10.0, 0.0, 0.0)

        def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
            asked.append((exposure_ms, gain_db))

    front, rear = Settable("front"), Camera("rear")
    exposure = {"front": ExposureControl(ExposureSettings(exposure_ms=3.0), 20.0, 20)}
    async with Running(front, rear, exposure=exposure) as cameras:
        taken = await cameras.after(front.start_ns - PERIOD_NS, 3)
    assert asked == [(3.0, 0.0)]
    assert taken[0].sequence > MAX_MARKED_FRAMES
    assert {pair.items["front"].exposure_ms for pair in taken} == {3.0}


async def test_a_camera_at_its_end_is_named() -> None:
    async with Running(Camera("front"), Camera("rear", last=3)) as cameras:
        with pytest.raises(CameraError, match="camera rear: the recording is at its end"):
            await cameras.after(0, 100)


async def test_a_silent_camera_is_named() -> None:
    class Silent(Camera):
        def next_frame(self, timeout_s: float) -> Frame:
            self.clock.wait(self.closed, 0.05)
            raise CameraError("no link")

    async with Running(Camera("front"), Silent("rear")) as cameras:
        with pytest.raises(CameraError, match=r"^camera rear: no link"):
            await cameras.after(0, 1)
