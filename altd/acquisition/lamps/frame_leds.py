"""The frame LEDs in the daemon: open and dark until something switches them."""

from __future__ import annotations

from collections.abc import Iterable

from altd.acquisition.lamps.controller import LampController
from altd.ports import Clock, Lamps
from altd.status.health import Component, State

_CAMERAS_POLL_INTERVAL_S = 0.05


class FrameLamps:
    """The daemon's frame LEDs. When they are lost while lit, they come back dark."""

    def __init__(self, lamps: Lamps, component: Component, clock: Clock) -> None:
        self._controller: LampController[bool] = LampController(lamps, lamps.switch, False, component, clock)
        self._component = component
        self._clock = clock

    async def run(self, cameras: Iterable[Component] = ()) -> None:
        """Control the lamps until cancelled; then they are dark.

        ``cameras`` are those whose outputs switch them: they are opened once each has delivered or failed.
        """
        for camera in cameras:
            while camera.state is State.STARTING:
                await self._clock.sleep(_CAMERAS_POLL_INTERVAL_S)
        await self._controller.run()

    async def switch(self, on: bool) -> None:
        """Light or darken all of them; returns once that is done.

        Raises LampsError when they are not open or fail.
        """
        await self._controller.apply(on)

    def darken(self) -> None:
        """Darken them without waiting for it."""
        self._controller.request(False)

    @property
    def is_starting(self) -> bool:
        """Whether they were not opened yet, nor has that failed."""
        return self._component.state is State.STARTING

    @property
    def complaint(self) -> str:
        """Why they are not at hand; empty: they are."""
        return self._controller.complaint
