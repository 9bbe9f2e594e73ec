"""Exposures on demand: paired frames of all cameras that were exposed after a given instant."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Self

from altd.acquisition.auto_exposure.control import ExposureSetter
from altd.acquisition.grabbing import grab
from altd.acquisition.inbox import Inbox
from altd.config import Measuring
from altd.measuring.pairing import Pair, Pairer
from altd.ports import Camera, CameraError
from altd.records import Frame
from altd.status.health import Health, State

PATIENCE_S = 5.0
"""Without an exposure of all cameras for so long, something is wrong with one."""


class Exposures:
    """``async with``: the cameras deliver; what nobody asks for is dropped.

    Their exposure is set by ``setters`` when they are opened, and holds still.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        measuring: Measuring,
        health: Health,
        setters: Mapping[str, ExposureSetter] | None = None,
    ) -> None:
        self._cameras = cameras
        self._setters = setters or {}
        self._measuring = measuring
        self._health = health
        self._grabbers: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        names = tuple(camera.name for camera in self._cameras)
        self._inbox = Inbox(names)
        settings = self._measuring
        self._pairer: Pairer[Frame] = Pairer(
            names, settings.pair_by, settings.max_skew_ns, settings.max_lag_ns
        )
        self._grabbers = [
            asyncio.create_task(
                grab(
                    camera,
                    self._inbox,
                    self._health.component(f"camera {camera.name}"),
                    self._setters.get(camera.name),
                )
            )
            for camera in self._cameras
        ]
        for grabber in self._grabbers:
            grabber.add_done_callback(lambda _: self._inbox.tick())
        return self

    async def __aexit__(self, *_: object) -> None:
        for grabber in self._grabbers:
            grabber.cancel()
        await asyncio.gather(*self._grabbers, return_exceptions=True)

    async def after(self, t_ns: int, count: int) -> list[Pair[Frame]]:
        """The next ``count`` exposures that were begun after ``t_ns``, each with the frames of all cameras.

        A frame carries the middle of its exposure, so the first one behind ``t_ns`` may have begun before
        it. It is passed over: a camera begins no exposure before the one before has ended. Raises
        CameraError when a camera is at its end or when none come for PATIENCE_S, and a driver's own failure.
        Exposures during which a camera was being set are passed over too.
        """
        found: list[Pair[Frame]] = []
        under_way = True
        while len(found) < count:
            for pair in await self._next():
                frames = pair.items.values()
                if min(frame.t_ns for frame in frames) <= t_ns or any(frame.changing for frame in frames):
                    continue
                if under_way:
                    under_way = False
                else:
                    found.append(pair)
        return found[:count]

    async def _next(self) -> list[Pair[Frame]]:
        """The next complete exposures, at least one."""
        complete: list[Pair[Frame]] = []
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not complete:
                    for frame in await self._inbox.take():
                        pairs = self._pairer.add(frame.camera, frame.sequence, frame.t_ns, frame)
                        complete += [pair for pair in pairs if len(pair.items) == len(self._cameras)]
                    for grabber in self._grabbers:
                        if grabber.done() and not complete:
                            grabber.result()  # a driver's defect
                            raise CameraError(self._complaint())
        except TimeoutError:
            raise CameraError(self._complaint()) from None
        return complete

    def _complaint(self) -> str:
        states = {camera.name: self._health.component(f"camera {camera.name}") for camera in self._cameras}
        bad = [
            f"camera {name}: {c.message or 'no frames'}" for name, c in states.items() if c.state != State.OK
        ]
        return "; ".join(bad) or f"no exposure of all cameras together for {PATIENCE_S:g} s"
