"""Acquires the frames of one check: with the LEDs off, on, and off again."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from altd.acquisition.lamps.controller import FrameLamps
from altd.acquisition.self_check.frames import LedLog, Light, MarkedFrames, Taken
from altd.ports import Clock, LampsError
from altd.selfcheck.lights import have_one_exposure

_TIMEOUT_FACTOR = 3.0
"""Maximum duration of a check, as a multiple of its exposures' duration."""
_SWITCHING_S = 2.0
"""Additional time of a check for the lamps to respond, and for a late camera."""
_FIRST_STAGE = "off, before they were lit"


class CheckFailedError(Exception):
    """A check ended without its frames; the message has the reason.

    ``has_begun``: the check reached the switching of the LEDs. If not, the cameras did not deliver.
    """

    def __init__(self, sentence: str, has_begun: bool = True) -> None:
        super().__init__(sentence)
        self.has_begun = has_begun


@dataclass(frozen=True, slots=True)
class CheckFrames:
    """Frames by camera with the LEDs off, then on, then off again."""

    before: Taken
    lit: Taken
    after: Taken

    @property
    def have_one_exposure(self) -> bool:
        """Whether no camera's exposure changed between its frames."""
        return all(
            have_one_exposure((*frames, *self.lit[camera], *self.after[camera]))
            for camera, frames in self.before.items()
        )


class CheckExposer:
    """Lights the LEDs for ``exposures`` exposures of every camera, at ``fps`` exposures per second."""

    def __init__(
        self, lamps: FrameLamps, leds: LedLog, frames: MarkedFrames, clock: Clock, exposures: int, fps: float
    ) -> None:
        self._lamps = lamps
        self._leds = leds
        self._frames = frames
        self._clock = clock
        self._exposures = exposures
        self._timeout_s = _SWITCHING_S + _TIMEOUT_FACTOR * (3 * exposures + 4) / fps

    async def expose(self) -> CheckFrames:
        """Acquire and return the frames of a check; at any end the LEDs are dark or being darkened.

        Starts over if a camera's exposure changed meanwhile, as after a start. Raises CheckFailedError.
        """
        if complaint := self._lamps.complaint:  # the LEDs are not lit, so all exposures can be measured
            raise CheckFailedError(f"the frame LEDs could not be switched: {complaint}")
        stage = _FIRST_STAGE
        try:
            async with asyncio.timeout(self._timeout_s):
                while True:
                    before = await self._take(Light.OFF)
                    stage = "on"
                    await self._switch(True)
                    try:
                        lit = await self._take(Light.ON)
                    except BaseException:
                        self._give_up()
                        raise
                    await self._switch(False)
                    stage = "off, after they were lit"
                    frames = CheckFrames(before, lit, await self._take(Light.OFF))
                    if frames.have_one_exposure:
                        return frames
        except LampsError as error:
            raise CheckFailedError(f"the frame LEDs could not be switched: {error}") from error
        except TimeoutError as error:
            raise CheckFailedError(
                f"within {self._timeout_s:.1f} s not every camera had {self._exposures} steady exposures "
                f"with the LEDs {stage}",
                has_begun=stage != _FIRST_STAGE,
            ) from error

    async def _take(self, light: Light) -> Taken:
        return await self._frames.take(light, self._exposures, self._clock.monotonic_ns())

    async def _switch(self, on: bool) -> None:
        self._leds.begin(on)
        try:
            await self._lamps.apply(on)
        except BaseException:
            self._give_up()
            raise
        self._leds.done()

    def _give_up(self) -> None:
        """Darken the LEDs without waiting: the daemon may be ending."""
        self._lamps.request(False)
        self._leds.lost()
