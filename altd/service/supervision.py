"""Publishers run alone: one that dies is started again, more and more rarely, and troubles nobody else."""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Awaitable, Callable
from typing import Protocol

from altd.errors import BadInputError
from altd.ports import Clock
from altd.service.health import Component, State

log = logging.getLogger("altd")

FIRST_RETRY_S = 0.5
LONGEST_RETRY_S = 30.0

_FATAL_AT_START = {errno.EADDRINUSE, errno.EACCES}
"""An address that the computer does not have yet (EADDRNOTAVAIL) may come while it boots."""


def _in_words(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"{type(error).__name__}: {error}"


class Publisher(Protocol):
    """A face to the outside."""

    def run(self, ready: Callable[[], None]) -> Awaitable[None]:
        """Serve until cancelled; call ``ready`` once serving; raise when the face is dead."""


async def keep_running(
    place: str,
    publisher: Publisher,
    component: Component,
    clock: Clock,
    up: Callable[[], None] = lambda: None,
) -> None:
    """Run a publisher for ever.

    An address that is taken or forbidden at the first start is a mistake in the config: BadInputError that
    names ``place``. ``up`` is called once, when the first start was tried.
    """
    retry_s = FIRST_RETRY_S
    first = True

    def ready() -> None:
        nonlocal retry_s, first
        component.say(State.OK)
        retry_s = FIRST_RETRY_S
        if first:
            first = False
            up()

    while True:
        try:
            await publisher.run(ready)
            failure = "ended by itself"
        except Exception as error:
            if first and isinstance(error, OSError) and error.errno in _FATAL_AT_START:
                raise BadInputError(place, os.strerror(error.errno)) from error
            failure = _in_words(error)
        if first:
            first = False
            up()
        if component.state is not State.FAILED:
            log.warning("%s: %s; trying again", place, failure)
        component.say(State.FAILED, f"{failure}; next try in {retry_s:g} s")
        component.count("failures")
        await clock.sleep(retry_s)
        retry_s = min(2 * retry_s, LONGEST_RETRY_S)
