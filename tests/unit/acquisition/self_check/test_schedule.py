"""When checks are due, on the test's clock."""

import asyncio

from support.clock import FakeClock, settle

from altd.acquisition.self_check.schedule import FIRST_REPEAT_S, REST_S, Cause, Schedule


async def due_after(clock: FakeClock, schedule: Schedule, limit_s: float) -> tuple[Cause, float] | None:
    """The next cause and after how many seconds, to a tenth; None: none within ``limit_s``."""
    begun_ns = clock.monotonic_ns()
    task = asyncio.create_task(schedule.next())
    try:
        await settle()
        while not task.done():
            if clock.monotonic_ns() - begun_ns > limit_s * 1e9:
                return None
            await clock.advance(0.1)
        return task.result(), round((clock.monotonic_ns() - begun_ns) * 1e-9, 1)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_the_first_is_due_at_once_and_the_others_at_the_interval() -> None:
    clock = FakeClock()
    schedule = Schedule(clock, 60.0, automatic=True)
    assert await due_after(clock, schedule, 1.0) == (Cause.START, 0.0)
    for _ in range(2):
        schedule.ended(is_good=True)
        assert await due_after(clock, schedule, 100.0) == (Cause.SCHEDULE, 60.0)


async def test_a_request_and_a_shock_come_first_but_leave_a_rest() -> None:
    clock = FakeClock()
    schedule = Schedule(clock, 60.0, automatic=True)
    await schedule.next()
    schedule.ended(is_good=True)
    schedule.ask(Cause.SHOCK)
    assert await due_after(clock, schedule, 100.0) == (Cause.SHOCK, REST_S)
    schedule.ended(is_good=True)
    await clock.advance(REST_S + 1)
    schedule.ask(Cause.REQUEST)
    assert await due_after(clock, schedule, 100.0) == (Cause.REQUEST, 0.0)


async def test_a_flood_of_requests_wakes_the_schedule_once() -> None:
    class CountingClock(FakeClock):
        sleeps = 0

        async def sleep(self, seconds: float) -> None:
            self.sleeps += 1
            await super().sleep(seconds)

    clock = CountingClock()
    schedule = Schedule(clock, 60.0, automatic=True)
    await schedule.next()
    schedule.ended(is_good=True)
    task = asyncio.create_task(schedule.next())
    for _ in range(1000):
        schedule.ask(Cause.REQUEST)
        schedule.ask(Cause.SHOCK)
        await settle()
    assert clock.sleeps <= 3
    await clock.advance(REST_S)
    assert await task is Cause.REQUEST


async def test_a_request_that_comes_during_the_wait_ends_it() -> None:
    clock = FakeClock()
    schedule = Schedule(clock, 60.0, automatic=True)
    await schedule.next()
    schedule.ended(is_good=True)
    task = asyncio.create_task(schedule.next())
    await clock.advance(20.0)
    schedule.ask(Cause.REQUEST)
    await settle()
    assert task.result() is Cause.REQUEST


async def test_what_is_not_good_is_repeated_more_and_more_rarely() -> None:
    clock = FakeClock()
    schedule = Schedule(clock, 60.0, automatic=True)
    await schedule.next()
    waits = []
    for _ in range(5):
        schedule.ended(is_good=False)
        waits.append(await due_after(clock, schedule, 100.0))
    assert waits == [(Cause.REPEAT, seconds) for seconds in (FIRST_REPEAT_S, 20.0, 40.0, 60.0, 60.0)]
    schedule.ended(is_good=True)
    assert await due_after(clock, schedule, 100.0) == (Cause.SCHEDULE, 60.0)


async def test_what_is_not_automatic_is_made_on_request_only() -> None:
    clock = FakeClock()
    schedule = Schedule(clock, 60.0, automatic=False)
    schedule.ask(Cause.SHOCK)
    assert await due_after(clock, schedule, 100.0) is None
    schedule.ask(Cause.REQUEST)
    assert await due_after(clock, schedule, 1.0) == (Cause.REQUEST, 0.0)
    schedule.ended(is_good=False)
    assert await due_after(clock, schedule, 100.0) is None
