"""Lamps of any kind kept at hand and as they are wanted; got back when they are lost."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from altd.ports import Clock, LampsError
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

log = logging.getLogger("altd")

Look = TypeVar("Look")

ANSWER_S = 1.0
"""A driver's call takes microseconds on a chip, milliseconds in a camera; after this long it hangs."""

LOOK_AGAIN_S = 1.0
"""What is wanted is set again after this long: so a chip that went away is noticed while nothing changes."""

FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 5.0


class Openable(Protocol):
    """What lamps of all kinds have."""

    def open(self) -> None:
        """Get hold of them, dark; raises LampsError."""

    def close(self) -> None:
        """Darken them and let go."""


class Keeper(Generic[Look]):
    """Keeps one driver's lamps. ``show`` brings them to a look; ``dark`` is the look that they open with.

    Whatever the driver does, it ends nothing else: a failure is said in health, the lamps are closed and
    opened again, more and more rarely, for ever. A look that was wanted is forgotten with the lamps.
    """

    def __init__(
        self, driver: Openable, show: Callable[[Look], None], dark: Look, component: Component, clock: Clock
    ) -> None:
        self._driver = driver
        self._show = show
        self._dark = self._wanted = dark
        self._component = component
        self._clock = clock
        self._changed = asyncio.Event()
        self._waiting: list[asyncio.Future[None]] = []
        self._retry_s = FIRST_RETRY_S

    def want(self, look: Look) -> None:
        """Show this from now on; health says when it cannot be done."""
        if look != self._wanted:
            self._wanted = look
            self._changed.set()

    async def bring_about(self, look: Look) -> None:
        """Show this from now on; returns once it is shown, raises LampsError when it cannot be."""
        if self._component.state is not State.OK:
            raise LampsError(self._component.message or "the lamps are not open yet")
        self._wanted = look
        self._changed.set()
        shown = asyncio.get_running_loop().create_future()
        self._waiting.append(shown)
        await shown

    async def run(self) -> None:
        """Keep the lamps until cancelled; then they are dark."""
        thread = DeviceThread(self._component.name)
        try:
            while True:
                try:
                    await thread.call(self._driver.open, within_s=ANSWER_S)
                    await self._follow(thread)
                except Exception as error:
                    self._fail(_in_words(error))
                with contextlib.suppress(Exception):
                    await thread.call(self._driver.close, within_s=ANSWER_S)
                await self._clock.sleep(self._retry_s)
                self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
        finally:
            self._refuse_waiting("the daemon ends")
            if not await thread.end(self._driver.close, ANSWER_S):
                log.warning("%s: the driver does not come back; they may stay lit", self._component.name)

    async def _follow(self, thread: DeviceThread) -> None:
        """Show what is wanted, whenever that changes, until that fails."""
        while True:
            self._changed.clear()
            count = len(self._waiting)
            await thread.call(self._show, self._wanted, within_s=ANSWER_S)
            self._retry_s = FIRST_RETRY_S
            self._component.say(State.OK)
            for shown in self._waiting[:count]:
                if not shown.done():
                    shown.set_result(None)
            del self._waiting[:count]
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_AGAIN_S):
                    await self._changed.wait()

    def _fail(self, complaint: str) -> None:
        if self._component.message != (message := f"{complaint}; trying again"):
            log.warning("%s: %s", self._component.name, message)
        self._component.say(State.FAILED, message)
        self._component.count("failures")
        self._wanted = self._dark
        self._refuse_waiting(complaint)

    def _refuse_waiting(self, complaint: str) -> None:
        for shown in self._waiting:
            if not shown.done():
                shown.set_exception(LampsError(complaint))
        self._waiting.clear()


def _in_words(error: Exception) -> str:
    match error:
        case LampsError():
            return str(error)
        case TimeoutError():
            return f"the driver does not answer within {ANSWER_S:g} s"
    return f"{type(error).__name__}: {error}"
