"""Calls in real threads: one that is held comes back when the test lets it; use of the interpreter."""

import asyncio
import contextlib
import gc
import random
import sys
import threading
import time
import weakref
from functools import partial

import pytest

from altd.runtime.threads import DeviceThread, SingleCall, call_in_thread, real_time_interpreter

LONG_S = 60.0  # only a hang takes that long


def raise_it() -> None:
    raise ZeroDivisionError("a defect")


class Gate:
    """A call that comes back once it may."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.may_end = threading.Event()

    def __call__(self) -> str:
        self.entered.set()
        self.may_end.wait(LONG_S)
        return "through"


class Hand:
    """The object that a call holds: it is heavy."""


@pytest.mark.parametrize("end", ["returns", "raises", "times out", "is cancelled"])
@pytest.mark.parametrize("by", ["device", "call", "single"])
async def test_what_a_call_has_in_hand_is_let_go_without_the_garbage_collector(by: str, end: str) -> None:
    thread, gate, watched = DeviceThread("device"), Gate(), weakref.WeakSet[Hand]()
    single = SingleCall("worker")
    if end in ("returns", "raises"):
        gate.may_end.set()

    def work(_: Hand) -> None:
        gate()
        if end != "returns":
            try:
                raise_it()
            except ZeroDivisionError as error:
                raise LookupError from error

    async def ask() -> None:
        hand = Hand()
        watched.add(hand)
        within_s = 0.05 if end == "times out" else LONG_S
        with contextlib.suppress(LookupError, TimeoutError):
            if by == "device":
                await thread.call(work, hand, within_s=within_s)
            elif by == "single":
                await single.call(partial(work, hand), within_s)
            else:
                async with asyncio.timeout(within_s):
                    await call_in_thread(partial(work, hand), "worker")

    gc.disable()
    try:
        asked = asyncio.create_task(ask())
        if end == "is cancelled":
            assert await asyncio.to_thread(gate.entered.wait, LONG_S)
            asked.cancel()
        await asyncio.wait({asked})
        del asked
        gate.may_end.set()
        assert await thread.end(lambda: None, LONG_S)
        for worker in [each for each in threading.enumerate() if each.name == "worker"]:
            await asyncio.to_thread(worker.join, LONG_S)
        await asyncio.sleep(0)  # let the loop run the thread's calls
        assert not watched
    finally:
        gc.enable()


async def test_a_call_in_a_thread_gives_its_result_or_what_it_raises() -> None:
    assert await call_in_thread(lambda: threading.current_thread().name, "worker") == "worker"
    with pytest.raises(ZeroDivisionError):
        await call_in_thread(raise_it, "worker")


async def test_the_loop_goes_on_while_a_call_is_held_and_who_left_is_told_nothing() -> None:
    gate = Gate()
    waiting = asyncio.ensure_future(call_in_thread(gate, "worker"))
    assert await asyncio.to_thread(gate.entered.wait, LONG_S)
    waiting.cancel()
    gate.may_end.set()
    with pytest.raises(asyncio.CancelledError):
        await waiting


def test_a_call_that_outlives_its_loop_ends_its_thread_silently(capsys: pytest.CaptureFixture[str]) -> None:
    gate = Gate()

    async def leave() -> None:
        call_in_thread(gate, "worker")

    asyncio.run(leave())
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "worker"]
    gate.may_end.set()
    thread.join(LONG_S)
    assert not thread.is_alive()
    assert capsys.readouterr() == ("", "")


async def test_a_device_s_calls_come_one_after_the_other_in_one_thread() -> None:
    thread = DeviceThread("device")
    names = await asyncio.gather(
        *(thread.call(lambda: threading.current_thread().name, within_s=LONG_S) for _ in range(5))
    )
    assert names == ["device"] * 5
    with pytest.raises(ZeroDivisionError):
        await thread.call(raise_it, within_s=LONG_S)
    assert await thread.call(pow, 2, 5, within_s=LONG_S) == 32
    assert await thread.end(lambda: None, LONG_S)


async def test_what_a_call_raises_after_who_asked_has_left_is_told_nobody(
    caplog: pytest.LogCaptureFixture,
) -> None:
    told: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    thread, gate = DeviceThread("device"), Gate()

    def fail() -> None:
        gate()
        raise_it()

    asked = asyncio.create_task(thread.call(fail, within_s=LONG_S))
    assert await asyncio.to_thread(gate.entered.wait, LONG_S)
    asked.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asked
    del asked
    gate.may_end.set()
    assert await thread.call(pow, 2, 5, within_s=LONG_S) == 32
    gc.collect()
    assert (told, caplog.records) == ([], [])
    assert await thread.end(lambda: None, LONG_S)


async def test_a_call_that_takes_too_long_times_out_and_so_does_the_next_until_it_is_back() -> None:
    thread, gate = DeviceThread("device"), Gate()
    for _ in range(2):
        with pytest.raises(TimeoutError):
            await thread.call(gate, within_s=0.05)
    gate.may_end.set()
    assert await thread.call(pow, 2, 5, within_s=LONG_S) == 32
    assert await thread.end(lambda: None, LONG_S)


async def test_while_a_single_call_hangs_no_second_one_begins() -> None:
    calls, gate, made = SingleCall("single"), Gate(), []

    def make() -> str:
        made.append(threading.current_thread().name)
        return gate()

    for _ in range(3):
        with pytest.raises(TimeoutError):
            await calls.call(make, 0.05)
    assert made == ["single"]
    waiting = [asyncio.create_task(calls.call(make, LONG_S)) for _ in range(2)]
    gate.may_end.set()
    assert await asyncio.gather(*waiting) == ["through"] * 2
    with pytest.raises(ZeroDivisionError):
        await calls.call(raise_it)
    assert await calls.call(lambda: "next") == "next"
    assert len(made) == 3


@pytest.mark.parametrize("end", ["times out", "is cancelled"])
async def test_a_call_that_had_not_begun_when_its_caller_left_is_never_made(end: str) -> None:
    """Three calls wait for a thread: the first comes back, and the second keeps the third waiting."""
    thread, first, second, made = DeviceThread("device"), Gate(), Gate(), threading.Event()
    before = [asyncio.create_task(thread.call(gate, within_s=LONG_S)) for gate in (first, second)]
    third = asyncio.create_task(thread.call(made.set, within_s=0.05 if end == "times out" else LONG_S))
    assert await asyncio.to_thread(first.entered.wait, LONG_S)
    first.may_end.set()
    assert await asyncio.to_thread(second.entered.wait, LONG_S)
    if end == "is cancelled":
        third.cancel()
    with pytest.raises((TimeoutError, asyncio.CancelledError)):
        await third
    second.may_end.set()
    assert await asyncio.gather(*before) == ["through"] * 2
    assert await thread.end(lambda: None, LONG_S)
    assert not made.is_set()


@pytest.mark.parametrize("end", ["times out", "is cancelled"])
async def test_a_call_that_comes_back_after_its_caller_left_is_undone_before_the_next(end: str) -> None:
    thread, gate, done = DeviceThread("device"), Gate(), list[str]()

    def work() -> str:
        done.append(gate())
        return done[-1]

    within_s = 0.05 if end == "times out" else LONG_S
    asked = asyncio.create_task(thread.call(work, within_s=within_s, undo=done.remove))
    assert await asyncio.to_thread(gate.entered.wait, LONG_S)
    following = asyncio.create_task(thread.call(done.copy, within_s=LONG_S))
    if end == "is cancelled":
        asked.cancel()
    with pytest.raises((TimeoutError, asyncio.CancelledError)):
        await asked
    gate.may_end.set()
    assert await following == []
    assert await thread.end(lambda: None, LONG_S)


async def test_a_call_that_cannot_be_undone_or_a_last_one_that_fails_is_logged_and_the_thread_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    thread, gate = DeviceThread("device"), Gate()
    with pytest.raises(TimeoutError):
        await thread.call(gate, within_s=0.01, undo=lambda _: raise_it())
    gate.may_end.set()
    assert await thread.call(pow, 2, 5, within_s=LONG_S) == 32
    assert caplog.messages == ["device: a defect"]
    assert await thread.end(raise_it, LONG_S)
    assert caplog.messages == ["device: a defect"] * 2


async def test_of_many_calls_that_are_cancelled_at_any_time_what_was_told_is_what_happened() -> None:
    thread, chance, there = DeviceThread("device"), random.Random(1), set[int]()

    def add(number: int) -> int:
        time.sleep(chance.random() * 1e-3)
        there.add(number)
        return number

    asked = [
        asyncio.create_task(thread.call(add, number, within_s=LONG_S, undo=there.remove))
        for number in range(200)
    ]
    for _ in range(100):
        asked[chance.randrange(200)].cancel()
        await asyncio.sleep(chance.random() * 1e-3)
    told = await asyncio.gather(*asked, return_exceptions=True)
    assert await thread.end(lambda: None, LONG_S)
    successes = {number for number in told if isinstance(number, int)}
    assert 100 <= len(successes) < 200
    assert there == successes


async def test_the_end_of_a_thread_that_is_held_is_not_waited_for() -> None:
    thread, gate, closed = DeviceThread("device"), Gate(), threading.Event()
    with pytest.raises(TimeoutError):
        await thread.call(gate, within_s=0.01)
    assert not await thread.end(closed.set, 0.05)
    assert not closed.is_set()
    gate.may_end.set()
    assert await asyncio.to_thread(closed.wait, LONG_S)


def test_a_device_thread_whose_loop_is_gone_ends() -> None:
    gate = Gate()

    async def leave() -> None:
        with pytest.raises(TimeoutError):
            await DeviceThread("device").call(gate, within_s=0.01)

    asyncio.run(leave())
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "device"]
    gate.may_end.set()
    thread.join(LONG_S)
    assert not thread.is_alive()


def test_within_threads_give_way_fifty_times_sooner_and_after_as_they_did() -> None:
    interval_s = sys.getswitchinterval()
    with real_time_interpreter():
        assert sys.getswitchinterval() == pytest.approx(interval_s / 50)
    assert sys.getswitchinterval() == interval_s


def test_a_collection_goes_through_what_is_new_and_all_is_as_it_was_after() -> None:
    frozen = gc.get_freeze_count()
    gc.disable()  # as `altd run` starts
    with real_time_interpreter():
        assert gc.isenabled()
        assert gc.get_freeze_count() > 10_000  # modules alone
        assert len(gc.get_objects()) < 1_000
        cycle: list[object] = []
        cycle.append(cycle)
        del cycle
        assert gc.collect() >= 1
    assert gc.get_freeze_count() == frozen
    assert len(gc.get_objects()) > 10_000


def test_a_failure_within_leaves_the_interpreter_as_it_was() -> None:
    interval_s = sys.getswitchinterval()
    with pytest.raises(ZeroDivisionError), real_time_interpreter():
        _ = 1 / 0
    assert (sys.getswitchinterval(), gc.get_freeze_count()) == (interval_s, 0)
