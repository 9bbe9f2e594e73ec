import asyncio
import errno
import itertools
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from support.clock import FakeClock, settle, stop

from altd.errors import BadInputError
from altd.runtime.supervision import keep_running
from altd.status.health import Component, Health, State


class Flaky:
    """Serves after a number of failed starts, then dies when told."""

    def __init__(self, failures: int = 0, error: Exception | None = None) -> None:
        self.failures = failures
        self.error = error or RuntimeError("no such thing")
        self.starts: list[float] = []
        self.die = asyncio.Event()

    async def run(self, ready: Callable[[], None]) -> None:
        self.starts.append(0)
        if len(self.starts) <= self.failures:
            raise self.error
        ready()
        await self.die.wait()
        self.die.clear()
        raise OSError(errno.EIO, "the port is gone", "/dev/ttyUSB0")


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@asynccontextmanager
async def supervised(publisher: object, clock: FakeClock, **options: bool) -> AsyncIterator[Component]:
    component = Health(clock).component("face")
    task = asyncio.create_task(keep_running("face", publisher, component, clock, **options))
    yield component
    await stop(task)


async def test_a_dead_publisher_is_started_again_more_and_more_rarely(
    clock: FakeClock, caplog: pytest.LogCaptureFixture
) -> None:
    publisher = Flaky(failures=8)
    async with supervised(publisher, clock) as component:
        starts_at = []
        with caplog.at_level(logging.WARNING, "altd"):
            for second in range(130):
                await clock.advance(1.0)
                if len(publisher.starts) > len(starts_at):
                    starts_at += [second] * (len(publisher.starts) - len(starts_at))
        assert component.state is State.OK
        assert component.counters["failures"] == 1  # one outage, however often it was tried
        gaps = [later - earlier for earlier, later in itertools.pairwise(starts_at)]
        assert gaps[-1] == 30
        assert gaps == sorted(gaps)
        assert len(caplog.records) == 1  # one line, not one a try
        publisher.die.set()
        await settle()
        assert component.state is State.FAILED
        assert "the port is gone" in component.message
        await clock.advance(0.5)
        assert component.state is State.OK


async def test_a_new_interface_is_refused_for_an_address_in_use(clock: FakeClock) -> None:
    taken, component = OSError(errno.EADDRINUSE, "Address already in use"), Health(clock).component("http")
    with pytest.raises(BadInputError, match=r"http 127\.0\.0\.1:80: Address already in use"):
        await keep_running("http 127.0.0.1:80", Flaky(1, taken), component, clock, refuses=True)


@pytest.mark.parametrize(
    ("error", "refuses"),
    [
        pytest.param(
            OSError(errno.EADDRINUSE, "Address already in use"), False, id="address of another program"
        ),
        pytest.param(
            OSError(errno.EACCES, "Permission denied"), False, id="address that this user may not use"
        ),
        pytest.param(
            OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address"),
            True,
            id="address that the computer does not have yet",
        ),
        # while the computer boots, a new device belongs to root until udev has given it to its group
        pytest.param(
            OSError(errno.EACCES, "Permission denied", "/dev/ttyUSB0"), True, id="device not handed over yet"
        ),
    ],
)
async def test_what_may_yet_come_is_waited_for(clock: FakeClock, error: OSError, refuses: bool) -> None:
    async with supervised(Flaky(2, error), clock, refuses=refuses) as component:
        await settle()
        assert component.state is State.FAILED
        await clock.advance(2)
        assert component.state is State.OK


async def test_a_device_that_is_missing_is_looked_for_every_second(clock: FakeClock) -> None:
    publisher = Flaky(1000, OSError(errno.ENOENT, "there is no such port now", "/dev/ttyUSB0"))
    async with supervised(publisher, clock) as component:
        await clock.advance(600.0)
        assert component.message == "there is no such port now; next try in 0.5 s"
        publisher.failures = 0
        await clock.advance(0.3)
        assert component.message == "there is no such port now; next try in 0.2 s"
        await clock.advance(0.2)
        assert component.state is State.OK


async def test_what_dies_again_and_again_does_not_fill_the_log(
    clock: FakeClock, caplog: pytest.LogCaptureFixture
) -> None:
    publisher = Flaky()
    async with supervised(publisher, clock) as component:
        await settle()
        with caplog.at_level(logging.WARNING, "altd"):
            for _ in range(100):
                publisher.die.set()
                await clock.advance(2.0)
                assert component.state is State.OK
            assert component.counters["failures"] == 100
            assert len(caplog.records) == 1
            await clock.advance(60.0)
            publisher.die.set()
            await clock.advance(0.1)
            assert len(caplog.records) == 2  # it had served for long: that is news


async def test_different_failures_are_logged_once_each_and_not_without_end(
    clock: FakeClock, caplog: pytest.LogCaptureFixture
) -> None:
    class Varied(Flaky):
        async def run(self, ready: Callable[[], None]) -> None:
            self.error = RuntimeError(f"no {len(self.starts) // 2}")
            await super().run(ready)

    async with supervised(Varied(failures=100), clock):
        await clock.advance(2000.0)
    assert caplog.messages == [f"face: RuntimeError: no {n}; trying again" for n in range(8)]


class Grouped:
    """Fails in a task of a group."""

    def __init__(self) -> None:
        self.fails = asyncio.Event()

    async def run(self, ready: Callable[[], None]) -> None:
        async def fail() -> None:
            await self.fails.wait()
            raise OSError("lost")

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fail())
            tasks.create_task(asyncio.sleep(3600))
            ready()


async def test_a_failure_that_comes_with_the_end_does_not_prevent_it(clock: FakeClock) -> None:
    """A TaskGroup of Python 3.11 raises the failure and drops the cancellation."""
    publisher = Grouped()
    task = asyncio.create_task(keep_running("grouped", publisher, Health(clock).component("grouped"), clock))
    await settle()
    publisher.fails.set()
    task.cancel()
    await settle()
    assert task.cancelled()


async def test_a_failure_in_a_group_of_tasks_is_none_of_the_end(clock: FakeClock) -> None:
    """A TaskGroup of Python 3.11 that fails leaves its task as if it were cancelled."""
    publisher = Grouped()
    async with supervised(publisher, clock) as component:
        for _ in range(3):
            await settle()
            assert component.state is State.OK
            publisher.fails.set()
            await settle()
            assert component.state is State.FAILED
            publisher.fails.clear()
            await clock.advance(30.0)
