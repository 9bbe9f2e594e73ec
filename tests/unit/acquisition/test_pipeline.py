from __future__ import annotations

import asyncio
import threading
from dataclasses import replace

import pytest
from support.clock import settle, stop
from support.pipeline_bench import Bench, shot

from altd.acquisition.inbox import Inbox
from altd.records import Frame, Measurement
from altd.status.health import State


async def test_silence_is_said_every_0_4_s_and_ends_with_the_next_frame() -> None:
    bench = Bench()
    await settle()
    await bench.clock.advance(2.1)
    assert bench.board.published == 5
    assert bench.component.figures == {"skew_ms": 0.25}
    latest = bench.board.read()
    assert latest is not None
    assert [str(fault) for fault in latest.status] == ["camera_silent"]
    assert bench.component.state is State.DEGRADED
    assert bench.component.message == "front: spot_missing"
    bench.inbox.put(shot("rear", 1), wait=False)
    await bench.clock.advance(0.01)
    assert bench.component.state is State.OK
    await stop(bench.task)


async def test_what_is_seen_is_told_of_the_moment_and_a_figure_that_is_told_no_more_is_not_known() -> None:
    bench = Bench()
    bench.chain.shift = {"view_shift_front_px": 0.25}
    bench.inbox.put(shot("rear", 1), wait=False)
    await bench.clock.advance(0.01)
    assert bench.component.figures == {"skew_ms": 0.25, "view_shift_front_px": 0.25}
    bench.chain.shift = {}
    bench.chain.spot = "ambiguous"
    assert bench.component.message == "front: ambiguous"
    bench.inbox.put(shot("rear", 2), wait=False)
    await bench.clock.advance(0.01)
    assert bench.component.figures == {"skew_ms": 0.25, "view_shift_front_px": None}
    await stop(bench.task)


@pytest.mark.parametrize("moment_s", [0.0, 0.01, 0.1, 0.199, 0.2, 0.201, 0.3, 0.399])
async def test_silence_is_said_at_its_deadline_whenever_the_last_frame_came(moment_s: float) -> None:
    bench = Bench()
    await bench.clock.advance(moment_s)
    bench.inbox.put(shot("front", 1), wait=False)
    await bench.clock.advance(0.399)
    assert bench.board.published == 0
    await bench.clock.advance(0.002)
    assert bench.board.published == 1
    await stop(bench.task)


async def test_nobody_is_woken_before_the_deadline() -> None:
    bench = Bench()
    slept: list[float] = []
    sleep = bench.clock.sleep

    async def counted(seconds: float) -> None:
        slept.append(seconds)
        await sleep(seconds)

    bench.clock.sleep = counted  # type: ignore[method-assign]
    for number in range(200):
        bench.inbox.put(shot("front", number), wait=False)
        await bench.clock.advance(0.05)
    assert len(slept) <= 200 * 0.05 / 0.3
    await stop(bench.task)


async def test_the_mark_of_a_change_of_exposure_is_not_lost_with_its_frame() -> None:
    inbox = Inbox(("front",))
    for sequence, changing in ((1, False), (2, True), (3, False), (4, False)):
        inbox.put(replace(shot("front", sequence), changing=changing), wait=False)
    assert [(f.sequence, f.changing) for f in await inbox.take()] == [(4, True)]
    inbox.put(shot("front", 5), wait=False)
    assert [(f.sequence, f.changing) for f in await inbox.take()] == [(5, False)]


async def test_frames_that_come_to_nothing_are_no_progress() -> None:
    bench = Bench()
    for number in range(100):
        bench.inbox.put(shot("front", number, bench.clock.monotonic_ns()), wait=False)
        await bench.clock.advance(0.05)
    assert (bench.board.published, bench.progress) == (0, 0)
    await stop(bench.task)


async def test_an_exposure_that_moves_on_is_progress_before_its_mean_is_due() -> None:
    bench = Bench()
    push = bench.chain.push

    def paired(frame: Frame) -> list[Measurement]:
        bench.chain.exposures += 1
        return push(frame)

    bench.chain.push = paired  # type: ignore[method-assign]
    for number in range(10):
        bench.inbox.put(shot("front", number, bench.clock.monotonic_ns()), wait=False)
        await bench.clock.advance(0.05)
    assert (bench.board.published, bench.progress) == (0, 10)
    await stop(bench.task)


async def test_a_defect_in_the_chain_ends_the_pipeline() -> None:
    bench = Bench()
    bench.chain.broken = True
    bench.inbox.put(shot("front", 1), wait=False)
    with pytest.raises(ZeroDivisionError):
        await bench.task


async def test_the_newest_frame_wins_the_slot_and_the_loss_is_counted() -> None:
    inbox = Inbox(("front", "rear"))
    for sequence in (1, 2, 3):
        inbox.put(shot("front", sequence, sequence), wait=False)
    inbox.put(shot("rear", 1, 1), wait=False)
    assert [(f.camera, f.sequence) for f in await inbox.take()] == [("rear", 1), ("front", 3)]
    assert inbox.dropped == {"front": 2, "rear": 0}


async def test_a_source_that_waits_loses_nothing() -> None:
    inbox = Inbox(("front",))
    source = threading.Thread(target=lambda: [inbox.put(shot("front", n), wait=True) for n in range(50)])
    source.start()
    taken = []
    while len(taken) < 50:
        taken += [f.sequence for f in await inbox.take()]
    source.join()
    assert taken == list(range(50))
    assert inbox.dropped == {"front": 0}


async def test_closing_the_inbox_lets_a_waiting_thread_go() -> None:
    inbox = Inbox(("front",))
    source = threading.Thread(target=lambda: [inbox.put(shot("front", n), wait=True) for n in range(5)])
    source.start()
    await asyncio.sleep(0.01)
    inbox.close()
    source.join(1.0)
    assert not source.is_alive()
