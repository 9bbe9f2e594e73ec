import logging
from collections.abc import AsyncIterator
from dataclasses import replace

import numpy as np
import pytest
from support.clock import settle, stop
from support.pipeline_bench import Bench

from altd.acquisition.frame_pairs import MAX_BEHIND_NS
from altd.measuring.pairing import Pair
from altd.measuring.spot_locator import Located
from altd.records import Frame, Measurement
from altd.status.health import State


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    bench = Bench()
    yield bench
    await stop(bench.task)


async def test_silence_is_said_every_0_4_s_and_ends_with_the_next_frame(bench: Bench) -> None:
    await settle()
    await bench.clock.advance(2.1)
    assert bench.board.published == 5
    assert bench.component.figures == {"skew_ms": 0.25}
    latest = bench.board.read()
    assert latest is not None
    assert [str(fault) for fault in latest.status] == ["camera_silent"]
    assert bench.component.state is State.DEGRADED
    assert bench.component.message == "front: spot_missing"
    bench.put("rear", sequence=1)
    await bench.clock.advance(0.01)
    assert bench.component.state is State.OK


async def test_what_is_seen_is_told_of_the_moment_and_a_figure_that_is_told_no_more_is_not_known(
    bench: Bench,
) -> None:
    bench.chain.shift = {"view_shift_front_px": 0.25}
    bench.put("rear", sequence=1)
    await bench.clock.advance(0.01)
    assert bench.component.figures == {"skew_ms": 0.25, "view_shift_front_px": 0.25}
    bench.chain.shift = {}
    bench.chain.spot = "ambiguous"
    assert bench.component.message == "front: ambiguous"
    bench.put("front", "rear", sequence=2)
    await bench.clock.advance(0.01)
    assert bench.component.figures == {"skew_ms": 0.25, "view_shift_front_px": None}


@pytest.mark.parametrize("moment_s", [0.0, 0.01, 0.1, 0.199, 0.2, 0.201, 0.3, 0.399])
async def test_silence_is_said_at_its_deadline_whenever_the_last_frame_came(
    bench: Bench, moment_s: float
) -> None:
    await bench.clock.advance(moment_s)
    bench.put("front", sequence=1)
    await bench.clock.advance(0.399)
    assert bench.board.published == 0
    await bench.clock.advance(0.002)
    assert bench.board.published == 1


async def test_nobody_is_woken_before_the_deadline(bench: Bench) -> None:
    slept: list[float] = []
    sleep = bench.clock.sleep

    async def counted(seconds: float) -> None:
        slept.append(seconds)
        await sleep(seconds)

    bench.clock.sleep = counted  # type: ignore[method-assign]
    for number in range(200):
        bench.put("front", sequence=number)
        await bench.clock.advance(0.05)
    assert len(slept) <= 200 * 0.05 / 0.3


async def test_frames_that_come_to_nothing_are_no_progress(bench: Bench) -> None:
    for number in range(100):
        bench.put("front", sequence=number)
        await bench.clock.advance(0.05)
    assert (bench.board.published, bench.progress) == (0, 0)


async def test_an_exposure_that_moves_on_is_progress_before_its_mean_is_due(bench: Bench) -> None:
    add = bench.chain.add

    def moves_on(pair: Pair[Located]) -> Measurement | None:
        bench.chain.frame_sets += 1
        return add(pair)

    bench.chain.add = moves_on  # type: ignore[method-assign]
    for number in range(10):
        bench.put("front", sequence=number)
        await bench.clock.advance(0.05)
    assert (bench.board.published, bench.progress) == (0, 10)


async def test_a_defect_in_the_chain_ends_the_pipeline() -> None:
    bench = Bench()
    bench.chain.broken = True
    bench.put("front", sequence=1)
    with pytest.raises(ZeroDivisionError):
        await bench.task


def shot(camera: str, number: int) -> Frame:
    return Frame(camera, number, number, np.zeros((4, 4), np.uint8))


async def test_silence_counts_from_the_last_frame_also_where_that_waits_for_its_partner(bench: Bench) -> None:
    await bench.clock.advance(0.3)
    bench.pairs.put(shot("front", 1), wait=False)
    await bench.clock.advance(0.399)
    assert bench.board.published == 0
    await bench.clock.advance(0.002)
    assert bench.board.published == 1


async def test_frames_that_nobody_took_in_time_count_as_dropped(bench: Bench) -> None:
    for t_ns in (0, 1, 2, 2 * MAX_BEHIND_NS):
        for camera in ("front", "rear"):
            bench.pairs.put(replace(shot(camera, t_ns), sequence=t_ns % 5), wait=False)
    bench.put("front", "rear", sequence=4)
    await bench.clock.advance(0.01)
    assert (bench.component.counters["dropped_front"], bench.component.counters["dropped_rear"]) == (3, 3)


async def test_what_comes_of_a_frame_is_logged_where_that_is_asked_for(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG, "altd.frames"):
        bench.put("front", sequence=1)
        bench.put("front", "rear", sequence=2)
        await bench.clock.advance(0.0)
    assert caplog.messages == ["exposure 1: no mean is due", "exposure 2: published after 0.0 ms, measuring"]


async def test_it_is_heard_of_while_nothing_comes_and_not_once_it_is_gone(bench: Bench) -> None:
    for _ in range(60):
        await bench.clock.advance(0.5)
        assert bench.component.silent_s(bench.clock.monotonic_ns()) is None
    await stop(bench.task)
    await bench.clock.advance(10)
    assert bench.component.silent_s(bench.clock.monotonic_ns()) == pytest.approx(10, abs=0.5)
