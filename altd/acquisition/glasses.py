"""The cycle of the glasses: one target at a time is opaque, and frames are marked with its name."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from altd.acquisition.lamps.controller import LampController
from altd.acquisition.self_check.frames import MARGIN_NS
from altd.config import AnySwitchesSettings, Config, RowSettings
from altd.ports import Clock, LampsError
from altd.records import Frame

MAX_PAUSE_SHARE = 0.5
"""Maximum random pause before a switching, as share of the settling time: no vibration stays in step."""
_REMEMBERED = 8
_RETRY_S = 0.2


@dataclass(frozen=True, slots=True)
class _Visit:
    """Interval in which the settled ``target`` is opaque; ``until_ns`` None: it still is."""

    target: str
    from_ns: int
    until_ns: int | None = None


class OpaqueMarks:
    """Marks frames with the target that was opaque during their whole exposure.

    One task calls ``begin`` and ``end``; any thread may call ``mark``. ``period_ns`` of a camera is the time
    from frame to frame; it is used for frames without an exposure time.
    """

    def __init__(self, clock: Clock, settle_s: float, period_ns: Mapping[str, int]) -> None:
        self._clock = clock
        self._settle_ns = round(settle_s * 1e9)
        self._period_ns = period_ns
        self._visits: tuple[_Visit, ...] = ()
        """The last visits, oldest first; the tuple is replaced, never changed."""

    def begin(self, target: str) -> None:
        """Note that only the glass of ``target`` is without voltage: the glasses begin to settle."""
        visit = _Visit(target, self._clock.monotonic_ns() + self._settle_ns)
        self._visits = (*self._visits, visit)[-_REMEMBERED:]

    def end(self) -> None:
        """Note that the glasses are about to be switched."""
        if self._visits and self._visits[-1].until_ns is None:
            *before, last = self._visits
            self._visits = (*before, replace(last, until_ns=self._clock.monotonic_ns()))

    def mark(self, frame: Frame) -> Frame:
        """Return the frame with its opaque target; empty: the glasses were being switched or settling."""
        ms = frame.exposure_ms
        half_ns = (self._period_ns[frame.camera] if ms is None else round(0.5e6 * ms)) + MARGIN_NS
        begin_ns, end_ns = frame.t_ns - half_ns, frame.t_ns + half_ns
        for visit in self._visits:
            if visit.from_ns <= begin_ns and (visit.until_ns is None or end_ns <= visit.until_ns):
                return replace(frame, opaque=visit.target)
        return replace(frame, opaque="") if frame.opaque else frame


@dataclass(eq=False)
class GlassCycle:
    """Switches the glasses of ``targets`` in turn, until cancelled.

    A failed switching is retried; until it succeeds no frame is marked. ``chance`` returns numbers from 0 to
    1. ``is_shuffled``: each round has its own order. A beam needs this: a vibration with the period of a
    round would move front and rear spots to opposite sides in every round, which looks like yaw.
    """

    switches: LampController[str]
    marks: OpaqueMarks
    clock: Clock
    targets: Sequence[str]
    settings: RowSettings | AnySwitchesSettings
    fps: float
    chance: Callable[[], float] = random.random
    is_shuffled: bool = False
    spare_frames: int = 1

    def _order(self) -> Iterator[str]:
        while True:
            yield from sorted(self.targets, key=lambda _: self.chance() if self.is_shuffled else 0.0)

    async def run(self) -> None:
        """Switch, settle and expose one target after the other until cancelled."""
        exposing_s = (self.settings.exposures + self.spare_frames) / self.fps
        for target in self._order():
            while not await self._switch(target):
                await self.clock.sleep(_RETRY_S)
            pause_s = MAX_PAUSE_SHARE * self.settings.settle_s * self.chance()
            await self.clock.sleep(self.settings.settle_s + exposing_s + pause_s)

    async def _switch(self, target: str) -> bool:
        """Make a target opaque and all others clear; return whether that succeeded."""
        self.marks.end()
        try:
            await self.switches.apply(target)
        except LampsError:
            return False
        self.marks.begin(target)
        return True


def glass_cycle(switches: LampController[str], config: Config, fps: float, clock: Clock) -> GlassCycle:
    """Return the cycle for a config's row, or for a beam with ``[switches]``."""
    settings = _visits(config)
    targets = [target.name for target in config.targets]
    period_ns = {target.camera: round(1e9 / fps) for target in config.targets}
    marks = OpaqueMarks(clock, settings.settle_s, period_ns)
    is_beam = config.unit.instrument == "beam"
    spare = _spare_frames(config)
    return GlassCycle(switches, marks, clock, targets, settings, fps, is_shuffled=is_beam, spare_frames=spare)


def _spare_frames(config: Config) -> int:
    """Return the frame intervals of a visit besides its exposures; more where triggers are uneven."""
    return 3 if any(camera.software_triggered for camera in config.cameras.values()) else 1


def _visits(config: Config) -> RowSettings | AnySwitchesSettings:
    """Return the settings of the visits: [chain] of a row, [switches] of a beam."""
    is_beam = config.unit.instrument == "beam"
    return config.switches if is_beam and config.switches else config.chain or RowSettings()


def round_s(config: Config, fps: float) -> tuple[float, float]:
    """Return the shortest and the longest duration of a round of all targets, s."""
    settings, targets = _visits(config), len(config.targets)
    visit_s = settings.settle_s + (settings.exposures + _spare_frames(config)) / fps
    return targets * visit_s, targets * (visit_s + MAX_PAUSE_SHARE * settings.settle_s)
