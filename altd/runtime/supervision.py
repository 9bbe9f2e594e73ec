"""Supervision of publishers: a failed one is restarted at growing intervals; the others continue."""

from __future__ import annotations

import asyncio
import errno
import logging
from collections.abc import Callable, Coroutine
from typing import Protocol

from altd.errors import BadInputError
from altd.ports import Clock
from altd.status.health import Component, Message, State

log = logging.getLogger("altd")

MIN_BACKOFF_S = 0.5
MAX_BACKOFF_S = 30.0
MAX_DEVICE_BACKOFF_S = 1.0
"""Maximum back-off for a device: a person who plugs in a cable waits, and opening a device costs little."""

MIN_STEADY_S = 10.0
"""Minimum time of serving after which a failure is logged again and the back-off starts from its minimum."""

_REFUSED = {errno.EADDRINUSE, errno.EACCES}
"""Errors for which a reload refuses a new interface; a missing address (EADDRNOTAVAIL) may still appear."""


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
    backoff_s = MIN_BACKOFF_S
    first, is_logged = True, False
    serving_since_ns: int | None = None

    def ready() -> None:
        nonlocal first, serving_since_ns
        component.set_state(State.OK)
        serving_since_ns = clock.monotonic_ns()
        if first:
            first = False
            up()

    while True:
        try:
            await _run(publisher, ready)
            failure = "ended unexpectedly"
            max_backoff_s = MAX_BACKOFF_S
        except Exception as error:
            device = isinstance(error, OSError) and error.filename is not None
            refusable = refuses and first and not device
            if refusable and isinstance(error, OSError) and error.errno in _REFUSED:
                raise BadInputError(place, _failure_text(error, place)) from error
            failure = _failure_text(error, place)
            max_backoff_s = MAX_DEVICE_BACKOFF_S if device else MAX_BACKOFF_S
        if serving_since_ns is not None and clock.monotonic_ns() - serving_since_ns >= MIN_STEADY_S * 1e9:
            is_logged, backoff_s = False, MIN_BACKOFF_S
        if first or serving_since_ns is not None:
            component.count("failures")
        serving_since_ns = None
        if first:
            first = False
            up()
        if not is_logged:
            is_logged = True
            log.warning("%s: %s; trying again", place, failure)
        backoff_s = min(backoff_s, max_backoff_s)
        component.set_state(
            State.FAILED, _retry_message(failure, clock.monotonic_ns() + round(backoff_s * 1e9))
        )
        await clock.sleep(backoff_s)
        backoff_s *= 2
