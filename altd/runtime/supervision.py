"""The one loop that keeps devices and interfaces in use: a failed one is tried again, the others continue."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import NoReturn, Protocol

from altd.errors import BadInputError
from altd.ports import Clock, Device
from altd.runtime.threads import NO_LIMIT_S, DeviceThread
from altd.status.health import Component, Message, State

log = logging.getLogger("altd")

MIN_BACKOFF_S = 0.5
MAX_BACKOFF_S = 30.0
MAX_DEVICE_BACKOFF_S = 1.0
"""Maximum back-off for a device: a person who plugs in a cable waits, and opening a device costs little."""

MIN_STEADY_S = 10.0
"""Minimum time of working after which a failure that was logged before is logged again."""

_MAX_LOGGED = 8
"""Maximum number of different failures in the log until then: some texts contain numbers that change."""

Works = Callable[[], None]
"""Reports, from any thread, that what is kept works."""

Failed = Callable[[Exception, int], str]
"""Reports a failure with the monotonic time of the next attempt, ns; returns the sentence for the log.

Empty: it has been logged. An error that it raises ends the loop.
"""


@dataclass(frozen=True, slots=True)
class Limits:
    """Waits between attempts, s: each is twice the one before, from ``shortest_s`` to ``longest_s``.

    After ``steady_s`` of working they begin with the shortest again. ``open_s`` and ``close_s`` are the
    maximum times of opening and closing a device.
    """

    shortest_s: float
    longest_s: float
    steady_s: float = 0.0
    open_s: float = NO_LIMIT_S
    close_s: float = 1.0


async def keep(
    name: str,
    use: Callable[[Works], Awaitable[object]],
    failed: Failed,
    limits: Limits,
    clock: Clock,
    close: Callable[[], Awaitable[object]] | None = None,
) -> NoReturn:
    """Use something until cancelled: each time that ``use`` fails, report, ``close``, wait and try again.

    A failure is logged once by its sentence, and again after ``MIN_STEADY_S`` of working.
    """
    wait_s, logged, since_ns = limits.shortest_s, set[str](), list[int]()

    def works() -> None:
        if not since_ns:
            since_ns.append(clock.monotonic_ns())

    while True:
        try:
            await use(works)
            raise OSError("ended unexpectedly")
        except Exception as error:
            now_ns = clock.monotonic_ns()
            worked_s = (now_ns - since_ns[0]) * 1e-9 if since_ns else -1.0
            if worked_s >= limits.steady_s:
                wait_s = limits.shortest_s
            if worked_s >= MIN_STEADY_S:
                logged.clear()
            if _is_of_device(error):
                wait_s = min(wait_s, MAX_DEVICE_BACKOFF_S)
            sentence = failed(error, now_ns + round(wait_s * 1e9))
            if sentence and sentence not in logged and len(logged) < _MAX_LOGGED:
                logged.add(sentence)
                log.warning("%s: %s; trying again", name, sentence)
        if close is not None:
            await close()
        await clock.sleep(wait_s)
        wait_s = min(2 * wait_s, limits.longest_s)
        since_ns.clear()


async def keep_device(
    device: Device,
    use: Callable[[DeviceThread, Works], Awaitable[object]],
    failed: Failed,
    limits: Limits,
    component: Component,
) -> NoReturn:
    """Keep a device open and in use, in a thread of its own, until cancelled; then close it."""
    thread = DeviceThread(component.name)

    async def open_and_use(works: Works) -> None:
        await thread.call(device.open, within_s=limits.open_s, undo=lambda _: device.close())
        await use(thread, works)

    async def close() -> None:
        with contextlib.suppress(Exception):
            await thread.call(device.close, within_s=limits.close_s)

    try:
        await keep(component.name, open_and_use, failed, limits, component.clock, close)
    finally:
        if not await thread.end(device.close, limits.close_s):
            log.warning("%s: the driver does not return; the device may stay on", component.name)


def complaint_of(error: Exception, own: type[Exception], late: str) -> str:
    """Return a device's failure as text: ``own`` errors are sentences; ``late``: its call takes too long."""
    if isinstance(error, own):
        return str(error)
    return late if isinstance(error, TimeoutError) else f"{type(error).__name__}: {error}"


_REFUSED = {errno.EADDRINUSE, errno.EACCES}
"""Errors for which a reload refuses a new interface; a missing address (EADDRNOTAVAIL) may still appear."""


def _is_of_device(error: Exception) -> bool:
    """Whether it is an error of a device: it has the name of its file."""
    return isinstance(error, OSError) and error.filename is not None


def _failure_text(error: Exception, place: str) -> str:
    """Return the failure as text, without the address of ``place``, with which some errors begin."""
    if isinstance(error, OSError):
        return (error.strerror or str(error)).removeprefix(f"{place.partition(' ')[2]}: ")
    return f"{type(error).__name__}: {error}"


def _retry_message(failure: str, due_ns: int) -> Message:
    return lambda now_ns: f"{failure}; next try in {max(due_ns - now_ns, 0) * 1e-9:.1f} s"


async def _run(publisher: Publisher, ready: Callable[[], None]) -> None:
    """Run a publisher once, in a separate task.

    In Python 3.11 a failing TaskGroup drops a simultaneous cancellation. It also leaves ``cancelling()`` of
    its task above zero, so only another task can detect that it was cancelled.
    """
    try:
        await asyncio.create_task(publisher.run(ready))
    finally:
        task = asyncio.current_task()
        if task is not None and task.cancelling():
            raise asyncio.CancelledError


class Publisher(Protocol):
    """An external interface."""

    def run(self, ready: Callable[[], None]) -> Coroutine[object, object, None]:
        """Serve until cancelled; call ``ready`` once serving; raise if the interface fails."""


async def keep_running(
    place: str,
    publisher: Publisher,
    component: Component,
    clock: Clock,
    up: Callable[[], None] = lambda: None,
    *,
    refuses: bool = False,
) -> None:
    """Run a publisher indefinitely; one that cannot open, or fails, is started again.

    ``refuses``: an address in use or forbidden at the first attempt raises BadInputError that names
    ``place``, so that the settings of a reload can be refused. A device (an OSError with the name of its
    file) may be missing or still forbidden then, as udev sets the rights of a new device a moment after it
    appears: the start is retried. ``up`` is called once, after the first attempt. The component counts a
    failure each time the publisher stops serving, and if the first attempt fails.
    """
    first = counts = True

    def serve(works: Works) -> Awaitable[None]:
        def ready() -> None:
            nonlocal counts
            counts = True
            component.set_state(State.OK)
            works()
            tried()

        return _run(publisher, ready)

    def failed(error: Exception, due_ns: int) -> str:
        nonlocal counts
        sentence = _failure_text(error, place)
        if refuses and first and not _is_of_device(error) and getattr(error, "errno", None) in _REFUSED:
            raise BadInputError(place, sentence) from error
        if counts:
            component.count("failures")
        counts = False
        tried()
        component.set_state(State.FAILED, _retry_message(sentence, due_ns))
        return sentence

    def tried() -> None:
        nonlocal first
        if first:
            first = False
            up()

    await keep(place, serve, failed, Limits(MIN_BACKOFF_S, MAX_BACKOFF_S, MIN_STEADY_S), clock)
