"""The frame LEDs in the daemon: at hand and dark until something switches them."""

from __future__ import annotations

from altd.acquisition.lamps.keeper import Keeper
from altd.ports import Clock, Lamps
from altd.status.health import Component


class FrameLamps:
    """The daemon's frame LEDs. When they are lost while lit, they come back dark."""

    def __init__(self, lamps: Lamps, component: Component, clock: Clock) -> None:
        self._keeper: Keeper[bool] = Keeper(lamps, lamps.switch, False, component, clock)

    async def run(self) -> None:
        """Keep the lamps at hand until cancelled; then they are dark."""
        await self._keeper.run()

    async def switch(self, on: bool) -> None:
        """Light or darken all of them; returns once that is done.

        Raises LampsError when they are not at hand or do not do it.
        """
        await self._keeper.bring_about(on)
