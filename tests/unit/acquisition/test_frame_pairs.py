"""From the threads of cameras to one reader: what waits, what is lost, what is marked and kept."""

import asyncio
import logging
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light

from altd.acquisition.frame_pairs import WAITING_BYTES, FramePairs
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.self_check.frames import LedLog, MarkedFrames
from altd.measuring.pairing import Pairer
from altd.reasons import Reason
from altd.records import Frame
from altd.runtime.threads import call_in_thread

PIXELS = frame(light(Blob(300, 200))).pixels
BOTH = ("front", "rear")
PERIOD_NS = 50_000_000


def shot(camera: str, sequence: int, changing: bool = False, t_ns: int | None = None) -> Frame:
    return Frame(camera, sequence, sequence * PERIOD_NS if t_ns is None else t_ns, PIXELS, changing=changing)


class Bench:
    """Frame pairs of cameras, and how often their reader was notified."""

    def __init__(self, *cameras: str) -> None:
        self.clock = FakeClock()
        self.told = 0
        pairer: Pairer[Frame] = Pairer(cameras, "sequence", 10_000_000, 30_000_000)
        self.pairs = FramePairs(pairer, self.tell, self.clock)
        self.cameras = cameras

    def tell(self) -> None:
        self.told += 1

    def put(self, *numbers: int, changing: tuple[tuple[str, int], ...] = ()) -> None:
        for number in numbers:
            for camera in self.cameras:
                self.pairs.put(shot(camera, number, (camera, number) in changing), wait=False)

    def taken(self) -> list[tuple[int, str]]:
        return [(pair.sequence, " ".join(pair.items)) for pair in self.pairs.take()]


class TestTheReader:
    def test_is_told_once_a_frame_set_whichever_camera_comes_first(self) -> None:
        bench = Bench(*BOTH)
        for number, order in enumerate((BOTH, BOTH[::-1], BOTH)):
            bench.pairs.put(shot(order[0], number), wait=False)
            assert bench.told == number
            assert bench.taken() == []
            bench.pairs.put(shot(order[1], number), wait=False)
            assert bench.told == number + 1
            assert bench.taken() == [(number, "front rear")]
        assert bench.pairs.dropped == {"front": 0, "rear": 0}

    def test_gets_all_exposures_after_a_stall_of_a_second(self) -> None:
        bench = Bench(*BOTH)
        bench.put(*range(21))
        assert [pair.sequence for _ in range(21) for pair in bench.pairs.take(1)] == list(range(21))
        assert bench.pairs.take(1) == []
        assert bench.pairs.dropped == {"front": 0, "rear": 0}

    def test_gets_pairs_also_where_all_frames_of_one_camera_are_delivered_before_those_of_the_other(
        self,
    ) -> None:
        """As after a stall, whichever thread runs first."""
        bench = Bench(*BOTH)
        for camera in BOTH:
            for number in range(20):
                bench.pairs.put(shot(camera, number), wait=False)
                bench.clock.now_ns += 1_000_000
        assert bench.taken() == [(number, "front rear") for number in range(20)]
        for number in range(20, 60):  # one is silent since then
            bench.clock.now_ns += PERIOD_NS
            bench.pairs.put(shot("rear", number), wait=False)
        assert bench.taken()[-1] == (55, "rear")

    def test_gets_the_newest_until_it_has_caught_up_after_more_and_the_loss_is_counted(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        bench = Bench(*BOTH)
        with caplog.at_level(logging.DEBUG, "altd.frames"):
            bench.put(*range(22))
        assert "exposure 20: dropped, the reader is behind" in caplog.messages
        assert [pair.sequence for pair in bench.pairs.take(1)] == [21]
        bench.put(22, 23)
        assert [pair.sequence for pair in bench.pairs.take(1)] == [23]
        assert bench.pairs.dropped == {"front": 22, "rear": 22}
        assert bench.pairs.take(1) == []
        bench.put(24, 25)
        assert bench.taken() == [(24, "front rear"), (25, "front rear")]

    def test_gets_as_many_large_exposures_as_there_is_memory_for(self) -> None:
        bench, large = Bench(*BOTH), np.broadcast_to(np.uint8(0), (3000, 4000))
        for number in range(9):
            for camera in BOTH:
                bench.pairs.put(replace(shot(camera, number), pixels=large), wait=False)
        room = WAITING_BYTES // (2 * large.nbytes)
        assert [pair.sequence for pair in bench.pairs.take()] == list(range(9 - room, 9))
        assert bench.pairs.dropped == {"front": 9 - room, "rear": 9 - room}

    def test_gets_frame_sets_that_lack_a_camera_by_the_same_rule(self) -> None:
        bench = Bench(*BOTH)
        for number in range(20):
            bench.clock.now_ns = number * PERIOD_NS
            bench.pairs.put(shot("rear", number), wait=False)
        assert bench.taken() == [(number, "rear") for number in range(16)]
        for number in range(20, 43):
            bench.clock.now_ns = number * PERIOD_NS
            bench.pairs.put(shot("rear", number), wait=False)
        assert bench.taken() == [(38, "rear")]
        assert bench.pairs.dropped == {"front": 0, "rear": 22}

    def test_gets_frames_that_are_out_of_step_but_not_as_a_pair(self) -> None:
        bench = Bench(*BOTH)
        bench.pairs.put(shot("front", 1), wait=False)
        bench.pairs.put(shot("rear", 1, t_ns=PERIOD_NS + 20_000_000), wait=False)
        (pair,) = bench.pairs.take()
        assert not pair.items
        assert {one.camera for one in pair.unpaired} == set(BOTH)
        assert set(pair.missing.values()) == {Reason.OUT_OF_STEP}

    def test_loses_no_mark_of_a_change_of_exposure(self) -> None:
        for marked in range(5):
            bench = Bench(*BOTH)
            bench.put(*range(23), changing=(("front", marked),))
            (newest,) = bench.pairs.take()
            assert (newest.items["front"].changing, newest.items["rear"].changing) == (True, False)
            bench.put(24)
            (after,) = bench.pairs.take()
            assert not after.items["front"].changing

    def test_gets_a_frame_that_came_too_late_with_the_next_pair(self) -> None:
        bench = Bench(*BOTH)
        bench.put(7)
        assert bench.taken() == [(7, "front rear")]
        bench.pairs.put(shot("front", 6, changing=True), wait=False)
        bench.put(8)
        (pair,) = bench.pairs.take()
        assert [(one.camera, one.sequence, one.changing) for one in pair.all_items] == [
            ("front", 6, True),
            ("front", 8, False),
            ("rear", 8, False),
        ]

    def test_knows_when_a_camera_delivered_and_when_nothing_follows(self) -> None:
        bench = Bench(*BOTH)
        assert bench.pairs.delivered_ns == 0
        bench.clock.now_ns = 5
        bench.pairs.put(shot("front", 1), wait=False)
        assert bench.pairs.delivered_ns == 5
        bench.pairs.end("front")
        assert not bench.pairs.is_at_end
        told = bench.told
        bench.pairs.end("rear")
        assert bench.pairs.is_at_end
        assert bench.told > told

    async def test_loses_only_what_is_counted_of_threads_that_are_as_fast_as_they_can_be(self) -> None:
        """Nothing comes twice, and nothing older after the newer."""
        bench = Bench(*BOTH)
        ends, counts = time.monotonic() + 0.3, dict.fromkeys(BOTH, 0)

        def fill(camera: str) -> None:
            while time.monotonic() < ends:
                bench.pairs.put(shot(camera, counts[camera]), wait=False)
                counts[camera] += 1

        sources = [call_in_thread(lambda camera=camera: fill(camera), camera) for camera in BOTH]  # type: ignore[misc]
        numbers: dict[str, list[int]] = {camera: [] for camera in BOTH}
        late = dict.fromkeys(BOTH, 0)
        is_over = False
        while not is_over:
            if is_over := all(source.done() for source in sources):
                for camera in BOTH:  # settles those that wait for a partner
                    bench.pairs.put(shot(camera, max(counts.values())), wait=False)
            for pair in bench.pairs.take():
                for one in pair.items.values():
                    numbers[one.camera].append(one.sequence)
                for one in pair.unpaired:
                    late[one.camera] += 1
            await asyncio.sleep(0.001)
        for camera in BOTH:
            assert numbers[camera] == sorted(set(numbers[camera]))
            assert counts[camera] + 1 == len(numbers[camera]) + late[camera] + bench.pairs.dropped[camera]


class TestSourcesThatWait:
    @pytest.mark.parametrize("cameras", [("front",), BOTH])
    async def test_lose_nothing(self, cameras: tuple[str, ...]) -> None:
        bench = Bench(*cameras)
        turns = [threading.Semaphore(1), threading.Semaphore(0)]

        def fill(place: int) -> None:
            for number in range(50):
                turns[place].acquire()  # as a recording is played: one exposure after the other
                bench.pairs.put(shot(cameras[place], number), wait=True)
                turns[(place + 1) % len(cameras)].release()

        sources = [call_in_thread(lambda place=place: fill(place), "source") for place in range(len(cameras))]  # type: ignore[misc]
        taken: list[tuple[int, str]] = []
        async with asyncio.timeout(60):
            while len(taken) < 50:
                taken += bench.taken()
                await asyncio.sleep(0)
            await asyncio.gather(*sources)
        assert taken == [(number, " ".join(cameras)) for number in range(50)]
        assert set(bench.pairs.dropped.values()) == {0}

    async def test_go_on_although_their_partner_has_ended(self) -> None:
        bench = Bench(*BOTH)
        source = call_in_thread(
            lambda: [bench.pairs.put(shot("front", number), wait=True) for number in range(20)], "front"
        )
        taken: list[tuple[int, str]] = []
        async with asyncio.timeout(60):
            while not source.done() or not bench.pairs.is_empty:
                taken += bench.taken()
                await asyncio.sleep(0)
        assert taken == [(number, "front") for number in range(16)]

    async def test_are_let_go_when_it_is_closed_and_what_they_bring_is_not_kept(self) -> None:
        bench = Bench("front")
        source = call_in_thread(
            lambda: [bench.pairs.put(shot("front", number), wait=True) for number in range(5)], "front"
        )
        async with asyncio.timeout(60):
            await asyncio.sleep(0.05)
            assert not source.done()
            bench.pairs.close()
            await source
        assert bench.pairs.is_at_end
        assert bench.taken() == [(0, "front")]


async def test_frames_are_marked_and_then_kept_and_the_same_frames_go_on() -> None:
    clock = FakeClock(PERIOD_NS)
    leds = LedLog(clock, dict.fromkeys(BOTH, PERIOD_NS))
    leds.begin(True)
    leds.done()
    marks, ring = MarkedFrames(leds, BOTH), FrameRing(1 << 24, 10**9, lambda _: None)
    pairer: Pairer[Frame] = Pairer(BOTH, "sequence", 10_000_000, 30_000_000)
    pairs = FramePairs(pairer, lambda: None, clock, [marks], ring)
    for camera in BOTH:
        pairs.put(shot(camera, 5), wait=False)
    (pair,) = pairs.take()
    kept = list(ring.between(0, 10**10))
    assert [frame.leds_on for frame in kept] == [True, True]
    assert list(pair.items.values()) == kept
