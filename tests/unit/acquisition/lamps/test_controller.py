"""Lamps that are lost, hang, and come back; with a driver in a real thread."""

import asyncio
import threading
from collections.abc import AsyncIterator

import pytest
from support.clock import FakeClock

from altd.acquisition.lamps.controller import FrameLamps
from altd.ports import LampsError
from altd.status.health import Component, Health, State


class Leds:
    """LEDs that fail with ``complaint`` while they have one and hang while ``passable`` is not set."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
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
        self._wait()
        self.lit = None

    def _wait(self) -> None:
        if not self.passable.is_set():
            self.clock.hold(self.passable)

    def _pass(self) -> None:
        self.threads.add(threading.current_thread().name)
        self._wait()
        if isinstance(self.complaint, Exception):
            raise self.complaint
        if self.complaint:
            raise LampsError(self.complaint)


@pytest.fixture
def leds(clock: FakeClock) -> Leds:
    return Leds(clock)


@pytest.fixture
def component(clock: FakeClock) -> Component:
    return Health(clock).component("lamps")


@pytest.fixture
async def lamps(leds: Leds, component: Component, clock: FakeClock) -> AsyncIterator[FrameLamps]:
    lamps = FrameLamps(leds, component, clock)
    task = asyncio.create_task(lamps.run())
    yield lamps
    clock.release(leds.passable)
    await clock.stop(task)
    assert leds.lit is None


async def test_lamps_are_at_hand_dark_and_switch(lamps: FrameLamps, leds: Leds, component: Component) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    assert leds.lit is False
    await lamps.apply(True)
    assert leds.lit
    await lamps.apply(False)
    assert leds.lit is False
    assert leds.threads == {"lamps"}


async def test_lamps_that_cannot_be_had_are_tried_again_and_come_back(
    lamps: FrameLamps, leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    leds.complaint = "line 'LED' is taken by 'blinker'"
    await leds.clock.until(lambda: component.counters.get("failures", 0) >= 3)
    assert (component.state, component.message) == (
        State.FAILED,
        "line 'LED' is taken by 'blinker'; trying again",
    )
    assert [record.getMessage() for record in caplog.records] == [f"lamps: {component.message}"]
    leds.complaint = ""
    await leds.clock.until(lambda: component.state is State.OK)
    assert component.message == ""


async def test_lamps_that_are_lost_again_and_again_do_not_fill_the_log(
    lamps: FrameLamps, leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(3):
        await leds.clock.until(lambda: component.state is State.OK)
        leds.complaint = "gone"
        await leds.clock.until(lambda: component.state is State.FAILED)
        leds.complaint = ""
    assert caplog.messages == ["lamps: gone; trying again"]


async def test_switching_lamps_that_are_not_at_hand_says_why(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    with pytest.raises(LampsError, match="not open yet"):
        await lamps.apply(True)
    leds.complaint = "gone"
    await leds.clock.until(lambda: component.state is State.FAILED)
    with pytest.raises(LampsError, match="gone"):
        await lamps.apply(True)


async def test_lamps_lost_while_lit_come_back_dark(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    await lamps.apply(True)
    leds.complaint = "gone"
    await leds.clock.until(lambda: component.state is State.FAILED)
    leds.complaint = ""
    opened = leds.opened
    await leds.clock.until(lambda: component.state is State.OK and leds.opened > opened)
    await leds.clock.advance(0.1)
    assert leds.lit is False


async def test_a_switch_that_fails_is_an_error(lamps: FrameLamps, leds: Leds, component: Component) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    leds.complaint = "gone"
    with pytest.raises(LampsError, match="gone"):
        await leds.clock.run(lamps.apply(True))


@pytest.mark.parametrize("is_begun", [False, True])
async def test_of_requests_at_once_the_last_is_applied_and_the_others_are_told_so(
    lamps: FrameLamps, leds: Leds, component: Component, is_begun: bool
) -> None:
    """``is_begun``: the first one is being applied when the others come; it was applied."""
    await leds.clock.until(lambda: component.state is State.OK)
    requests = [asyncio.create_task(lamps.apply(True))]
    if is_begun:
        leds.passable.clear()
        await leds.clock.settle()
    requests += [asyncio.create_task(lamps.apply(on)) for on in (True, False, True, False)]
    await asyncio.sleep(0)
    leds.clock.release(leds.passable)
    told = await asyncio.gather(*requests, return_exceptions=True)
    assert leds.lit is False
    refused = [str(each) for each in told if isinstance(each, LampsError)]
    assert [type(each) for each in told] == (
        [type(None) if is_begun else LampsError, LampsError, type(None), LampsError, type(None)]
    )
    assert set(refused) == {"another request came before they were switched"}
    assert component.state is State.OK


@pytest.mark.parametrize("is_begun", [False, True])
async def test_a_request_that_is_cancelled_leaves_the_lamps_dark(
    lamps: FrameLamps, leds: Leds, component: Component, is_begun: bool
) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    request = asyncio.create_task(lamps.apply(True))
    if is_begun:
        leds.passable.clear()
        await leds.clock.settle()
    else:
        await asyncio.sleep(0)
    request.cancel()
    await asyncio.wait([request])
    leds.clock.release(leds.passable)
    await leds.clock.advance(0.1)
    assert request.cancelled()
    assert leds.lit is False


async def test_a_request_that_is_cancelled_does_not_undo_a_later_one(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    first, second = (asyncio.create_task(lamps.apply(True)) for _ in range(2))
    await asyncio.sleep(0)
    first.cancel()
    await second
    assert leds.lit


async def test_lamps_that_are_switched_after_it_was_reported_as_failed_are_closed_at_once(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    leds.passable.clear()
    switching = asyncio.create_task(lamps.apply(True))
    await leds.clock.until(switching.done)
    assert isinstance(switching.exception(), LampsError)
    await leds.clock.advance(6.0)  # within the third pause, of 0.8 s
    leds.clock.release(leds.passable)
    while leds.lit is not None:  # noqa: ASYNC110  no time passes
        await asyncio.sleep(0)


async def test_a_defect_of_the_driver_ends_nothing(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    leds.complaint = ZeroDivisionError("oh")
    await leds.clock.until(lambda: component.state is State.FAILED)
    assert component.message == "ZeroDivisionError: oh; trying again"
    leds.complaint = ""
    await leds.clock.until(lambda: component.state is State.OK)


async def test_a_driver_that_hangs_does_not_hold_the_loop_and_is_used_again_once_it_is_back(
    lamps: FrameLamps, leds: Leds, component: Component
) -> None:
    await leds.clock.until(lambda: component.state is State.OK)
    leds.passable.clear()
    switching = asyncio.create_task(lamps.apply(True))
    await leds.clock.until(lambda: component.state is State.FAILED, within_s=1.1)
    with pytest.raises(LampsError, match=r"does not answer within 1 s"):
        await switching
    leds.clock.release(leds.passable)
    await leds.clock.until(lambda: component.state is State.OK)
    await lamps.apply(True)
    assert leds.lit


async def test_lamps_on_cameras_are_opened_after_each_of_them_has_delivered_or_failed(
    leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    clock = leds.clock
    front, rear = Component("camera front", clock), Component("camera rear", clock)
    lamps = FrameLamps(leds, component, clock)
    task = asyncio.create_task(lamps.run([front, rear]))
    await clock.advance(30)
    front.set_state(State.OK)
    await clock.advance(30)
    assert (leds.opened, component.state, lamps.is_starting) == (0, State.STARTING, True)
    rear.set_state(State.FAILED)
    await clock.until(lambda: component.state is State.OK, within_s=1.1)
    assert (leds.opened, lamps.is_starting) == (1, False)
    assert not caplog.records
    await clock.stop(task)


async def test_a_driver_that_hangs_does_not_hold_the_end(
    leds: Leds, component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    lamps = FrameLamps(leds, component, leds.clock)
    task = asyncio.create_task(lamps.run())
    await leds.clock.until(lambda: component.state is State.OK)
    leds.passable.clear()
    await leds.clock.until(lambda: component.state is State.FAILED)
    await leds.clock.stop(task)
    assert "may stay on" in caplog.text
    leds.clock.release(leds.passable)
    await leds.clock.until(lambda: leds.lit is None)


async def test_who_waits_for_lamps_at_the_end_hears_of_no_failure(leds: Leds, component: Component) -> None:
    lamps = FrameLamps(leds, component, leds.clock)
    task = asyncio.create_task(lamps.run())
    await leds.clock.until(lambda: component.state is State.OK)
    leds.passable.clear()
    switching = asyncio.create_task(lamps.apply(True))
    await leds.clock.settle()
    task.cancel()
    await asyncio.wait([switching])
    assert switching.cancelled()
    leds.clock.release(leds.passable)
    await asyncio.wait([task])
    assert leds.lit is None
