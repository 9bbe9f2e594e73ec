"""Slots between the cameras' threads and the loop: what is newest, what is lost, when the loop is woken."""

from __future__ import annotations

import asyncio
import threading
import time
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light
from support.located import located

from altd.acquisition.latest_frames import keep_mark
from altd.acquisition.latest_of_each import LatestOfEach
from altd.measuring.spot_locator import Located
from altd.records import Frame
from altd.runtime.threads import call_in_thread

PIXELS = frame(light(Blob(300, 200))).pixels
BOTH = ("front", "rear")


def shot(camera: str, sequence: int, changing: bool = False) -> Frame:
    return Frame(camera, sequence, sequence, PIXELS, changing=changing)


def slots(*cameras: str) -> LatestOfEach[Frame]:
    return LatestOfEach(cameras, FakeClock(), keep_mark)


async def taken(slots: LatestOfEach[Frame], wake_for_each: bool = False) -> list[tuple[str, int]]:
    """What the loop is woken for; nothing when it is not."""
    try:
        async with asyncio.timeout(0.02):
            return [(one.camera, one.sequence) for one in await slots.take(wake_for_each)]
    except TimeoutError:
        return []


class TestWhenTheLoopIsWoken:
    async def test_once_a_frame_set_whichever_camera_comes_first(self) -> None:
        both = slots(*BOTH)
        for number, order in enumerate((BOTH, BOTH[::-1], BOTH)):
            first, second = order
            both.put(shot(first, number), wait=False)
            assert await taken(both) == []
            both.put(shot(second, number), wait=False)
            assert sorted(await taken(both)) == [("front", number), ("rear", number)]
        assert both.dropped == {"front": 0, "rear": 0}

    async def test_of_three_cameras_by_the_last(self) -> None:
        three = slots("a", "b", "c")
        three.put(shot("b", 1), wait=False)
        three.put(shot("c", 1), wait=False)
        assert await taken(three) == []
        three.put(shot("a", 1), wait=False)
        assert sorted(await taken(three)) == [("a", 1), ("b", 1), ("c", 1)]

    async def test_by_the_next_frame_of_a_camera_whose_partner_is_late_and_none_is_lost(self) -> None:
        both = slots(*BOTH)
        both.put(shot("front", 1), wait=False)
        assert await taken(both) == []
        both.put(shot("front", 2), wait=False)
        assert await taken(both) == [("front", 1), ("front", 2)]
        assert both.dropped == {"front": 0, "rear": 0}

    async def test_by_each_while_something_waits_for_a_partner(self) -> None:
        both = slots(*BOTH)
        for number, camera in enumerate(("front", "front", "rear", "front")):
            both.put(shot(camera, number), wait=False)
            assert await taken(both, wake_for_each=True) == [(camera, number)]

    async def test_at_once_for_what_came_while_the_loop_did_not_know_that_something_waits(self) -> None:
        both = slots(*BOTH)
        both.put(shot("rear", 7), wait=False)
        assert await taken(both, wake_for_each=True) == [("rear", 7)]

    async def test_by_itself_whatever_there_is(self) -> None:
        both = slots(*BOTH)
        both.put(shot("front", 1), wait=False)
        both.wake()
        assert await taken(both) == [("front", 1)]
        both.wake()
        assert await taken(both) == []

    async def test_no_more_often_than_there_are_sets(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Counted where threads wake a loop: each call writes a byte into its pipe."""
        both = slots(*BOTH)
        loop, wakes = asyncio.get_running_loop(), []
        schedule = loop.call_soon_threadsafe

        def counted(*call: object) -> object:
            wakes.append(call)
            return schedule(*call)  # type: ignore[arg-type]

        monkeypatch.setattr(loop, "call_soon_threadsafe", counted)
        for number in range(100):
            for camera in BOTH:
                both.put(shot(camera, number), wait=False)
            assert len(await taken(both)) == 2
        assert len(wakes) == 100


class TestOfEachCamera:
    async def test_what_a_woken_loop_did_not_take_in_time_is_replaced_and_counted(self) -> None:
        both = slots(*BOTH)
        for number in range(1, 6):
            both.put(shot("front", number), wait=False)
        both.put(shot("rear", 5), wait=False)
        assert sorted(await taken(both)) == [("front", 5), ("rear", 5)]
        assert both.dropped == {"front": 4, "rear": 0}

    async def test_a_loop_that_comes_late_finds_as_many_as_there_is_room_for(self) -> None:
        both: LatestOfEach[Frame] = LatestOfEach(BOTH, FakeClock(), keep_mark, room=3)
        for number in range(6):
            both.put(shot("front", number, changing=number == 1), wait=False)
        both.put(shot("rear", 5), wait=False)
        given = await both.take(wake_for_each=False)
        assert [(one.camera, one.sequence, one.changing) for one in given] == [
            ("front", 3, True),
            ("front", 4, False),
            ("front", 5, False),
            ("rear", 5, False),
        ]
        assert both.dropped == {"front": 3, "rear": 0}

    async def test_the_mark_of_a_change_goes_to_the_newer_frame_from_whichever_was_dropped(self) -> None:
        for marked in range(4):
            both = slots(*BOTH)
            for number in range(5):
                both.put(shot("front", number, changing=number == marked), wait=False)
            (newest,) = await both.take(wake_for_each=False)
            assert (newest.sequence, newest.changing) == (4, True)

    async def test_breaks_are_not_lost_with_what_told_of_them(self) -> None:
        """They count up from the start: a window sees that there was one, whoever told first."""
        both: LatestOfEach[Located] = LatestOfEach(BOTH, FakeClock())
        for number, breaks in enumerate((0, 1, 2, 2, 2)):
            both.put(located("front", number, breaks=breaks), wait=False)
        (newest,) = await both.take(wake_for_each=False)
        assert (newest.sequence, newest.breaks) == (4, 2)

    async def test_the_oldest_is_given_first(self) -> None:
        both = slots(*BOTH)
        both.put(replace(shot("front", 8), t_ns=8), wait=False)
        both.put(replace(shot("rear", 7), t_ns=7), wait=False)
        assert await taken(both) == [("rear", 7), ("front", 8)]

    async def test_when_a_camera_delivered_is_known_although_the_loop_sleeps(self) -> None:
        clock = FakeClock(5)
        both: LatestOfEach[Frame] = LatestOfEach(BOTH, clock)
        assert both.delivered_ns is None
        both.put(shot("front", 1), wait=False)
        assert both.delivered_ns == 5
        clock.now_ns = 9
        both.put(shot("front", 2), wait=False)
        assert both.delivered_ns == 9

    @pytest.mark.parametrize("cameras", [("front",), BOTH])
    async def test_sources_that_wait_lose_nothing(self, cameras: tuple[str, ...]) -> None:
        each = slots(*cameras)

        def fill(camera: str) -> None:
            for number in range(50):
                each.put(shot(camera, number), wait=True)

        sources = [call_in_thread(lambda camera=camera: fill(camera), camera) for camera in cameras]  # type: ignore[misc]
        for source in sources:
            source.add_done_callback(lambda _: each.wake())  # a frame whose partner never comes
        given: list[tuple[str, int]] = []
        async with asyncio.timeout(60):
            while len(given) < 50 * len(cameras):
                given += await taken(each)
        await asyncio.gather(*sources)
        for camera in cameras:
            assert [number for name, number in given if name == camera] == list(range(50))
        assert set(each.dropped.values()) == {0}

    async def test_a_source_that_waits_goes_on_although_its_partner_has_ended(self) -> None:
        both = slots(*BOTH)
        source = call_in_thread(
            lambda: [both.put(shot("front", number), wait=True) for number in range(20)], "front"
        )
        given: list[tuple[str, int]] = []
        async with asyncio.timeout(60):
            while len(given) < 19:
                given += await taken(both)
            await source
        both.wake()
        given += await taken(both)
        assert given == [("front", number) for number in range(20)]

    async def test_closing_lets_waiting_threads_go_and_keeps_nothing_more(self) -> None:
        both = slots(*BOTH)
        source = threading.Thread(
            target=lambda: [both.put(shot("front", number), wait=True) for number in range(5)]
        )
        source.start()
        await asyncio.sleep(0.01)
        both.close()
        source.join(60)
        assert not source.is_alive()
        assert await taken(both) == [("front", 0)]

    async def test_two_threads_as_fast_as_they_can_lose_only_what_is_counted(self) -> None:
        """With the loop busy now and then; nothing comes twice, and nothing older after the newer."""
        both = slots(*BOTH)
        ends = time.monotonic() + 0.5
        counts = dict.fromkeys(BOTH, 0)

        def fill(camera: str) -> None:
            while time.monotonic() < ends:
                both.put(shot(camera, counts[camera]), wait=False)
                counts[camera] += 1

        sources = [call_in_thread(lambda camera=camera: fill(camera), camera) for camera in BOTH]  # type: ignore[misc]
        given: list[tuple[str, int]] = []
        while not all(source.done() for source in sources):
            given += await taken(both)
            time.sleep(0.001)  # noqa: ASYNC251  a busy loop
        both.wake()
        given += await taken(both)
        for camera in BOTH:
            numbers = [number for name, number in given if name == camera]
            assert numbers == sorted(set(numbers))
            assert len(numbers) + both.dropped[camera] == counts[camera]
            assert numbers[-1] == counts[camera] - 1
