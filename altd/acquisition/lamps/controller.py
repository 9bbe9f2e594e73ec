"""Controller that keeps lamps of any kind open and at their setpoint, and reopens them; the frame LEDs."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from altd.ports import Clock, Device, Lamps, LampsError
from altd.runtime.supervision import Limits, Works, complaint_of, keep_device
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

Setpoint = TypeVar("Setpoint")

CALL_TIMEOUT_S = 1.0
"""Maximum time of a driver's call, which takes microseconds on a chip and milliseconds in a camera."""

REFRESH_INTERVAL_S = 1.0
"""Interval at which an unchanged setpoint is reapplied, so that the loss of a chip is detected."""

_LIMITS = Limits(0.2, 5.0, open_s=CALL_TIMEOUT_S, close_s=CALL_TIMEOUT_S)
_HEARTBEAT_S = _LIMITS.longest_s + 5 * CALL_TIMEOUT_S
"""Maximum silence of live lamps: they report after each attempt, of at most three calls, and each pause."""

_CAMERAS_POLL_INTERVAL_S = 0.05


class LampController(Generic[Setpoint]):
    """Controls one driver's lamps. ``show`` applies a setpoint; ``dark`` is the setpoint of opened lamps.

    A failing driver affects nothing else: the failure is reported in health, and the lamps are closed and
    reopened, at growing intervals, indefinitely. After a failure or a cancelled ``apply`` the setpoint is
    ``dark`` again.
    """

    def __init__(
        self,
        driver: Device,
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
        await keep_device(self._driver, self._use, self._fail, _LIMITS, self._component)

    async def _use(self, thread: DeviceThread, works: Works) -> None:
        try:
            await self._apply_setpoints(thread, works)
        except asyncio.CancelledError:
            for _, applied in self._waiting:
                applied.cancel()
            raise

    async def _apply_setpoints(self, thread: DeviceThread, works: Works) -> None:
        """Apply the setpoint at each change and at intervals, until that fails."""
        while True:
            self._changed.clear()
            setpoint, count = self._setpoint, len(self._waiting)
            # a call that comes back too late was reported as failed
            await thread.call(
                self._show, setpoint, within_s=CALL_TIMEOUT_S, undo=lambda _: self._driver.close()
            )
            works()
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

    def _fail(self, error: Exception, _: int) -> str:
        late = f"the driver does not answer within {CALL_TIMEOUT_S:g} s"
        self.last_failure = complaint = complaint_of(error, LampsError, late)
        self._component.set_state(State.FAILED, f"{complaint}; trying again")
        self._component.count("failures")
        self._setpoint = self._dark
        for _wanted, applied in self._waiting:
            if not applied.done():
                applied.set_exception(LampsError(complaint))
        self._waiting.clear()
        return complaint


class FrameLamps(LampController[bool]):
    """The daemon's frame LEDs, all lit or all dark. If they are lost while lit, they are reopened dark."""

    def __init__(self, lamps: Lamps, component: Component, clock: Clock) -> None:
        super().__init__(lamps, lamps.switch, False, component, clock)

    @property
    def is_starting(self) -> bool:
        """Whether the LEDs have been neither opened nor reported as failed."""
        return self._component.state is State.STARTING
