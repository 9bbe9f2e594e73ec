"""Controller that keeps lamps of any kind open and at their setpoint, and reopens them; the frame LEDs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable
from typing import Generic, Protocol, TypeVar

from altd.ports import Clock, Lamps, LampsError
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

log = logging.getLogger("altd")

Setpoint = TypeVar("Setpoint")

CALL_TIMEOUT_S = 1.0
"""Maximum time of a driver's call, which takes microseconds on a chip and milliseconds in a camera."""

REFRESH_INTERVAL_S = 1.0
"""Interval at which an unchanged setpoint is reapplied, so that the loss of a chip is detected."""

MIN_BACKOFF_S = 0.2
MAX_BACKOFF_S = 5.0
_HEARTBEAT_S = MAX_BACKOFF_S + 5 * CALL_TIMEOUT_S
"""Maximum silence of live lamps: they report after each attempt, of at most three calls, and each pause."""


_CAMERAS_POLL_INTERVAL_S = 0.05


class Openable(Protocol):
    """Methods common to lamps of all kinds."""

    def open(self) -> None:
        """Open the lamps, dark; raises LampsError."""

    def close(self) -> None:
        """Darken and release the lamps."""


class LampController(Generic[Setpoint]):
    """Controls one driver's lamps. ``show`` applies a setpoint; ``dark`` is the setpoint of opened lamps.

    A failing driver affects nothing else: the failure is reported in health, and the lamps are closed and
    reopened, at growing intervals, indefinitely. After a failure or a cancelled ``apply`` the setpoint is
    ``dark`` again.
    """

    def __init__(
        self,
        driver: Openable,
        show: Callable[[Setpoint], None],
        dark: Setpoint,
        component: Component,
        clock: Clock,
    ) -> None:
        self._driver = driver
        self._show = show
        self._dark = self._setpoint = dark
        self._component = component
        self._clock = clock
        self._changed = asyncio.Event()
        self._waiting: list[tuple[Setpoint, asyncio.Future[None]]] = []
        self._newest: asyncio.Future[None] | None = None
        """The call of ``apply`` that changed the setpoint last; None: it was ``request``."""
        self._backoff_s = MIN_BACKOFF_S
        self.last_failure = ""
        """Latest failure since the start, even if a later attempt succeeded; empty: none."""

    def request(self, setpoint: Setpoint) -> None:
        """Change the setpoint; health reports if it cannot be applied."""
        self._newest = None
        if setpoint != self._setpoint:
            self._setpoint = setpoint
            self._changed.set()

    @property
    def complaint(self) -> str:
        """Reason why the lamps cannot be switched now; empty: they can."""
        if self._component.state is State.OK:
            return ""
        return self._component.message or "the lamps are not open yet"

    async def apply(self, setpoint: Setpoint) -> None:
        """Change the setpoint; return once it is applied, raise LampsError if it cannot be.

        It cannot be if another setpoint is requested before. When the daemon ends, waiting calls are
        cancelled: no lamp has failed.
        """
        if complaint := self.complaint:
            raise LampsError(complaint)
        self._setpoint = setpoint
        self._changed.set()
        self._newest = applied = asyncio.get_running_loop().create_future()
        self._waiting.append((setpoint, applied))
        try:
            await applied
        except asyncio.CancelledError:
            if self._newest is applied:
                self.request(self._dark)
            raise

    async def run(self, cameras: Iterable[Component] = ()) -> None:
        """Control the lamps until cancelled; then darken them.

        ``cameras`` are the cameras whose outputs switch the lamps; the lamps are opened once each camera has
        delivered or failed.
        """
        for camera in cameras:
            while camera.state is State.STARTING:
                await self._clock.sleep(_CAMERAS_POLL_INTERVAL_S)
        self._component.expect(_HEARTBEAT_S)
        thread = DeviceThread(self._component.name)
        try:
            while True:
                try:
                    await thread.call(self._driver.open, within_s=CALL_TIMEOUT_S, undo=self._close_late)
                    await self._apply_setpoints(thread)
                except Exception as error:
                    self._fail(_complaint_of(error))
                with contextlib.suppress(Exception):
                    await thread.call(self._driver.close, within_s=CALL_TIMEOUT_S)
                await self._clock.sleep(self._backoff_s)
                self._backoff_s = min(2 * self._backoff_s, MAX_BACKOFF_S)
        finally:
            for _, applied in self._waiting:
                applied.cancel()
            if not await thread.end(self._driver.close, CALL_TIMEOUT_S):
                log.warning("%s: the driver does not come back; they may stay lit", self._component.name)

    async def _apply_setpoints(self, thread: DeviceThread) -> None:
        """Apply the setpoint at each change and at intervals, until that fails."""
        while True:
            self._changed.clear()
            setpoint, count = self._setpoint, len(self._waiting)
            await thread.call(self._show, setpoint, within_s=CALL_TIMEOUT_S, undo=self._close_late)
            self._backoff_s = MIN_BACKOFF_S
            self._component.set_state(State.OK)
            for wanted, applied in self._waiting[:count]:
                if applied.done():
                    continue
                if wanted == setpoint:
                    applied.set_result(None)
                else:
                    applied.set_exception(LampsError("another request came before they were switched"))
            del self._waiting[:count]
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(REFRESH_INTERVAL_S):
                    await self._changed.wait()

    def _close_late(self, _: None) -> None:
        """Close the lamps after a call that came back too late: it was reported as failed."""
        self._driver.close()

    def _fail(self, complaint: str) -> None:
        if self._component.message != (message := f"{complaint}; trying again"):
            log.warning("%s: %s", self._component.name, message)
        self._component.set_state(State.FAILED, message)
        self._component.count("failures")
        self.last_failure = complaint
        self._setpoint = self._dark
        self._refuse_waiting(complaint)

    def _refuse_waiting(self, complaint: str) -> None:
        for _, applied in self._waiting:
            if not applied.done():
                applied.set_exception(LampsError(complaint))
        self._waiting.clear()


def _complaint_of(error: Exception) -> str:
    match error:
        case LampsError():
            return str(error)
        case TimeoutError():
            return f"the driver does not answer within {CALL_TIMEOUT_S:g} s"
    return f"{type(error).__name__}: {error}"


class FrameLamps(LampController[bool]):
    """The daemon's frame LEDs, all lit or all dark. If they are lost while lit, they are reopened dark."""

    def __init__(self, lamps: Lamps, component: Component, clock: Clock) -> None:
        super().__init__(lamps, lamps.switch, False, component, clock)

    @property
    def is_starting(self) -> bool:
        """Whether the LEDs have been neither opened nor reported as failed."""
        return self._component.state is State.STARTING
