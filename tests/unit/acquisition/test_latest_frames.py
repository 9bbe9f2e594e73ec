"""Slots between the threads of cameras: what is newest, what is lost, and that cameras drop alike."""

from __future__ import annotations

import asyncio
import random
import threading
from collections.abc import Callable, Iterable

import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light

from altd.acquisition.latest_frames import LatestFrames, _Slot
from altd.records import Frame
from altd.runtime.threads import call_in_thread

PIXELS = frame(light(Blob(300, 200))).pixels


def shot(camera: str, sequence: int, changing: bool = False) -> Frame:
    return Frame(camera, sequence, 1000 * sequence, PIXELS, changing=changing)


class TestOneCamera:
    def test_the_newest_frame_wins_and_the_loss_is_counted(self) -> None:
        slot = LatestFrames(["front"])
        for sequence in (1, 2, 3):
            slot.put(shot("front", sequence), wait=False)
        newest = slot.take("front")
        assert newest is not None
        assert newest.sequence == 3
        assert slot.dropped == {"front": 2}

    def test_the_mark_of_a_change_of_exposure_is_not_lost_with_its_frame(self) -> None:
        slot = LatestFrames(["front"])
        for sequence, changing in ((1, False), (2, True), (3, False), (4, False)):
            slot.put(shot("front", sequence, changing), wait=False)
        newest = slot.take("front")
        assert newest is not None
        assert (newest.sequence, newest.changing) == (4, True)
        slot.put(shot("front", 5), wait=False)
        after = slot.take("front")
        assert after is not None
        assert (after.sequence, after.changing) == (5, False)

    async def test_a_source_that_waits_loses_nothing(self) -> None:
        slot = LatestFrames(["front"])
        source = call_in_thread(
            lambda: [slot.put(shot("front", number), wait=True) for number in range(50)], "source"
        )
        numbers = []
        while len(numbers) < 50:
            frame = await asyncio.to_thread(slot.take, "front")
            assert frame is not None
            numbers.append(frame.sequence)
        await source
        assert numbers == list(range(50))
        assert slot.dropped == {"front": 0}

    def test_closed_it_gives_what_it_holds_and_then_nothing(self) -> None:
        slot = LatestFrames(["front"])
        slot.put(shot("front", 1), wait=False)
        slot.close()
        slot.put(shot("front", 2), wait=False)
        frame = slot.take("front")
        assert frame is not None
        assert (frame.sequence, slot.take("front")) == (1, None)

    async def test_closing_lets_go_who_fills_it_and_who_waits_for_a_frame(self) -> None:
        full, empty = LatestFrames(["front"]), LatestFrames(["front"])
        full.put(shot("front", 1), wait=False)
        waiting = [
            call_in_thread(lambda: full.put(shot("front", 2), wait=True), "fills"),
            call_in_thread(lambda: empty.take("front"), "takes"),
        ]
        await asyncio.sleep(0.01)
        assert not any(one.done() for one in waiting)
        full.close()
        empty.close()
        async with asyncio.timeout(60):
            assert await asyncio.gather(*waiting) == [None, None]


class GivingFrames(LatestFrames):
    """Tells the clock when it gives a thread, which rests, a frame."""

    def __init__(self, clock: FakeClock, cameras: Iterable[str]) -> None:
        super().__init__(cameras)
        self.clock = clock
        self.given = {camera: threading.Event() for camera in self._slots}

    def _give_to(self, slot: _Slot) -> None:
        super()._give_to(slot)
        self.clock.release(next(self.given[camera] for camera, of in self._slots.items() if of is slot))


async def located(
    locating_s: dict[str, float], exposures: int, period_s: float, lag_s: float = 0.0, first_of_rear: int = 0
) -> dict[str, list[int]]:
    """Which exposures the thread of each camera locates, when it takes about so long for each."""
    clock = FakeClock(threads=2)
    frames, never = GivingFrames(clock, locating_s), threading.Event()
    taken: dict[str, list[int]] = {camera: [] for camera in locating_s}

    def locate(camera: str) -> None:
        drawn = random.Random(camera)
        clock.rest(frames.given[camera])
        while (frame := frames.take(camera)) is not None:
            taken[camera].append(frame.sequence)
            clock.wait(never, locating_s[camera] * drawn.uniform(0.8, 1.2))
            clock.rest(frames.given[camera])

    threads = [threading.Thread(target=locate, args=(camera,)) for camera in locating_s]
    for thread in threads:
        thread.start()
    late = random.Random(exposures)
    for number in range(exposures):
        for camera, after_s in zip(locating_s, (0.0, lag_s), strict=True):
            late_s = late.uniform(0.0, 0.5) * period_s
            await clock.advance(max(number * period_s + after_s + late_s - clock.now_ns * 1e-9, 0.0))
            if camera == "front" or number >= first_of_rear:
                frames.put(shot(camera, number), wait=False)
    frames.close()
    clock.end()
    for thread in threads:
        thread.join()
    dropped = frames.dropped
    assert len(taken["front"]) + dropped["front"] == exposures
    assert len(taken["rear"]) + dropped["rear"] == exposures - first_of_rear
    return taken


def share_in_pairs(taken: dict[str, list[int]], since: int = 5) -> float:
    """Of the exposures that any camera located, how many both did."""
    front, rear = ({number for number in of if number >= since} for of in taken.values())
    return len(front & rear) / len(front | rear)


class TestCamerasThatAreLocatedSlowerThanTheyDeliver:
    """What one camera drops, the other drops too: a frame without its partner is no measurement."""

    async def test_both(self) -> None:
        taken = await located({"front": 0.025, "rear": 0.025}, 100, 0.010)
        assert share_in_pairs(taken) > 0.95
        assert 20 < len(taken["front"]) < 50

    async def test_only_one(self) -> None:
        taken = await located({"front": 0.001, "rear": 0.027}, 100, 0.010)
        assert share_in_pairs(taken) > 0.95

    async def test_by_a_little(self) -> None:
        taken = await located({"front": 0.001, "rear": 0.012}, 150, 0.010)
        assert share_in_pairs(taken) > 0.95

    async def test_both_although_one_began_in_the_middle_of_the_other_s(self) -> None:
        taken = await located({"front": 0.033, "rear": 0.033}, 100, 0.010, first_of_rear=2)
        assert share_in_pairs(taken, since=12) > 0.95


async def test_two_that_run_half_a_period_apart_do_not_wait_for_each_other_while_each_is_in_time() -> None:
    """Together they take longer than a period; one after the other they would lose a third."""
    taken = await located({"front": 0.030, "rear": 0.030}, 40, 0.050, lag_s=0.025)
    assert len(taken["front"]) >= 36
    assert len(taken["rear"]) >= 36


def held(frames: LatestFrames, camera: str) -> asyncio.Future[Frame | None]:
    """A thread that takes the next frame of a camera."""
    return call_in_thread(lambda: frames.take(camera), camera)


async def has_come_true(condition: Callable[[], bool]) -> bool:
    """Whether something comes true soon."""
    for _ in range(20):
        if condition():
            return True
        await asyncio.sleep(0.005)
    return False


async def test_who_waits_for_one_that_is_behind_takes_what_is_newest_when_that_one_goes_on() -> None:
    frames = LatestFrames(("front", "rear"))
    for camera in ("front", "rear"):
        frames.put(shot(camera, 1), wait=False)
        assert (await held(frames, camera)) is not None
    front = held(frames, "front")  # the rear one goes on locating
    frames.put(shot("rear", 2), wait=False)
    frames.put(shot("front", 2), wait=False)
    assert not await has_come_true(front.done)
    for camera in ("front", "rear"):
        frames.put(shot(camera, 3), wait=False)
    rear = await held(frames, "rear")
    of_front = await front
    assert rear is not None
    assert of_front is not None
    assert (of_front.sequence, rear.sequence) == (3, 3)
    assert frames.dropped == {"front": 1, "rear": 1}


@pytest.mark.parametrize("ended", [False, True])
async def test_a_camera_that_is_silent_or_at_its_end_is_not_waited_for(ended: bool) -> None:
    frames = LatestFrames(("front", "rear"))
    for number in range(3):
        frames.put(shot("rear", number), wait=False)
        assert (await held(frames, "rear")) is not None
    last = held(frames, "rear")
    if ended:
        frames.end("rear")
        assert await last is None
    for number in range(3, 6):
        frames.put(shot("front", number), wait=False)
        of_front = await held(frames, "front")
        assert of_front is not None
        assert of_front.sequence == number
    frames.close()
    assert await last is None


async def test_closed_it_lets_a_thread_go_that_waits_for_one_that_is_behind() -> None:
    frames = LatestFrames(["front", "rear"])
    of_front, of_rear = held(frames, "front"), held(frames, "rear")
    for camera in ("front", "rear"):
        frames.put(shot(camera, 0), wait=False)
    assert (await of_front, await of_rear) != (None, None)
    waiting = held(frames, "front")  # rear has its frame in hand, and its thread ends with it
    for number in (1, 2):
        for camera in ("rear", "front"):
            frames.put(shot(camera, number), wait=False)
    frames.close()
    assert await asyncio.wait_for(waiting, 60) is not None
