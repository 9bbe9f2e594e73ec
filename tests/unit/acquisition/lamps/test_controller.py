"""Lamps that are lost, hang, and come back; with a driver in a real thread and a real clock."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable

import pytest
from support.clock import FakeClock, stop

from altd.acquisition.lamps import controller
from altd.acquisition.lamps.frame_leds import FrameLamps
from altd.ports import LampsError
from altd.runtime.clock import SystemClock
from altd.status.health import Component, Health, State


class Leds:
    """LEDs that fail with ``complaint`` while they have one and hang while ``passable`` is not set."""

    def __init__(self) -> None:
        self.lit: bool | None = None
        self.complaint: str | Exception = ""
        self.passable = threading.Event()
        self.passable.set()
        self.opened = 0
        self.threads: set[str] = set()

    def open(self) -> None:
        self._pass()
        self.opened += 1
        self.lit = False

    def switch(self, on: bool) -> None:
        self._pass()
        self.lit = on

    def close(self) -> None:
        self.passable.wait(10)
        self.lit = None

    def _pass(self) -> None:
        self.threads.add(threading.current_thread().name)
        self.passable.wait(10)
        if isinstance(self.complaint, Exception):
            raise self.complaint
        if self.complaint:
            raise LampsError(self.complaint)


@pytest.fixture
def leds() -> Leds:
    return Leds()


@pytest.fixture
def component() -> Component:
    return Health(SystemClock()).component("lamps")


@pytest.fixture
async def lamps(
    leds: Leds, component: Component, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[FrameLamps]:
    monkeypatch.setattr(controller, "REFRESH_INTERVAL_S", 0.05)
    monkeypatch.setattr(controller, "MIN_BACKOFF_S", 0.01)
    monkeypatch.setattr(controller, "CALL_TIMEOUT_S", 0.2)
    lamps = FrameLamps(leds, component, SystemClock())
    task = asyncio.create_task(lamps.run())
    yield lamps
    leds.passable.set()
    if not task.done():
        await stop(task)
    assert leds.lit is None


async def becomes(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(5):
        while not true():  # noqa: ASYNC110  nothing tells of it
            await asyncio.sleep(0.005)


async def test_lamps_are_at_hand_dark_and_switch(lamps: FrameLamps, leds: Leds, component: Component) -> None:
    await becomes(lambda: component.state is State.OK)
    assert leds.lit is False
    await lamps.switch(True)
    assert leds.lit
    await lamps.switch(False)
    assert leds.lit is False


async def test_all_calls_come_from_one_thread(lamps: FrameLamps, leds: Leds, component: Component) -> None:
    await becomes(lambda: component.state is State.OK)
    await lamps.switch(True)
    assert leds.threads == {"lamps"}


async def test_lamps_that_cannot_be_had_are_tried_again_and_come_back(
    lamps: FrameLamps, leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    leds.complaint = "line 'LED' is taken by 'blinker'"
    await becomes(lambda: component.counters.get("failures", 0) >= 3)
    assert (component.state, component.message) == (
        State.FAILED,
        "line 'LED' is taken by 'blinker'; trying again",
    )
    assert [record.getMessage() for record in caplog.records] == [f"lamps: {component.message}"]
    leds.complaint = ""
    await becomes(lambda: component.state is State.OK)
    assert component.message == ""


async def test_switching_lamps_that_are_not_at_hand_says_why(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    with pytest.raises(LampsError, match="not open yet"):
        await lamps.switch(True)
    leds.complaint = "gone"
    await becomes(lambda: component.state is State.FAILED)
    with pytest.raises(LampsError, match="gone"):
        await lamps.switch(True)


async def test_a_loss_is_noticed_while_nothing_is_switched(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await becomes(lambda: component.state is State.OK)
    leds.complaint = "gone"
    await becomes(lambda: component.state is State.FAILED)


async def test_lamps_lost_while_lit_come_back_dark(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await becomes(lambda: component.state is State.OK)
    await lamps.switch(True)
    leds.complaint = "gone"
    await becomes(lambda: component.state is State.FAILED)
    leds.complaint = ""
    opened = leds.opened
    await becomes(lambda: component.state is State.OK and leds.opened > opened)
    await asyncio.sleep(0.1)
    assert leds.lit is False


async def test_a_switch_that_fails_is_an_error(lamps: FrameLamps, leds: Leds, component: Component) -> None:
    await becomes(lambda: component.state is State.OK)
    leds.complaint = "gone"
    with pytest.raises(LampsError, match="gone"):
        await asyncio.wait_for(lamps.switch(True), 5)


async def test_a_defect_of_the_driver_ends_nothing(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    leds.complaint = ZeroDivisionError("oh")
    await becomes(lambda: component.state is State.FAILED)
    assert component.message == "ZeroDivisionError: oh; trying again"
    leds.complaint = ""
    await becomes(lambda: component.state is State.OK)


async def test_a_driver_that_hangs_does_not_hold_the_loop_and_is_used_again_once_it_is_back(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await becomes(lambda: component.state is State.OK)
    leds.passable.clear()
    switching = asyncio.create_task(lamps.switch(True))
    late_s = []
    async with asyncio.timeout(5):
        while component.state is not State.FAILED:
            before_s = time.monotonic()
            await asyncio.sleep(0.001)
            late_s.append(time.monotonic() - before_s)
        with pytest.raises(LampsError, match=r"does not answer within 0\.2 s"):
            await switching
    assert max(late_s) < 0.15
    leds.passable.set()
    await becomes(lambda: component.state is State.OK)
    await lamps.switch(True)
    assert leds.lit


async def test_lamps_on_cameras_are_opened_after_each_of_them_has_delivered_or_failed(
    leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    clock = FakeClock()
    front, rear = Component("camera front", clock), Component("camera rear", clock)
    lamps = FrameLamps(leds, component, clock)
    task = asyncio.create_task(lamps.run([front, rear]))
    await clock.advance(30)
    front.set_state(State.OK)
    await clock.advance(30)
    assert (leds.opened, component.state, lamps.is_starting) == (0, State.STARTING, True)
    rear.set_state(State.FAILED)
    await clock.advance(1)
    await becomes(lambda: component.state is State.OK)
    assert (leds.opened, lamps.is_starting) == (1, False)
    assert not caplog.records
    await stop(task)


async def test_a_driver_that_hangs_does_not_hold_the_end(
    leds: Leds, component: Component, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(controller, "CALL_TIMEOUT_S", 0.1)
    lamps = FrameLamps(leds, component, SystemClock())
    task = asyncio.create_task(lamps.run())
    await becomes(lambda: component.state is State.OK)
    leds.passable.clear()
    await becomes(lambda: component.state is State.FAILED)
    before_s = time.monotonic()
    await stop(task)
    assert time.monotonic() - before_s < 2
    assert "may stay lit" in caplog.text
    leds.passable.set()
    await becomes(lambda: leds.lit is None)


async def test_who_waits_for_lamps_at_the_end_hears_of_no_failure(leds: Leds, component: Component) -> None:
    lamps = FrameLamps(leds, component, SystemClock())
    task = asyncio.create_task(lamps.run())
    await becomes(lambda: component.state is State.OK)
    leds.passable.clear()
    switching = asyncio.create_task(lamps.switch(True))
    await asyncio.sleep(0.02)
    task.cancel()
    await asyncio.wait([switching], timeout=5)
    assert switching.cancelled()
    leds.passable.set()
    await asyncio.wait([task], timeout=5)
    assert leds.lit is None
