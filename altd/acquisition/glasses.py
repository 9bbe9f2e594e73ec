"""The cycle of the glasses: one target after the other is opaque, and frames are marked with its name."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from altd.acquisition.lamps.controller import LampController
from altd.acquisition.self_check.frames import MARGIN_NS
from altd.config import AnySwitchesSettings, ChainSettings, Config
from altd.ports import Clock, LampsError
from altd.records import Frame

MAX_PAUSE_SHARE = 0.5
"""Of the time of settling: a pause by chance before each switching, so that no vibration stays in step."""
_REMEMBERED = 8
_RETRY_S = 0.2


@dataclass(frozen=True, slots=True)
class _Visit:
    """The glasses have settled since ``from_ns``; until ``until_ns`` (None: now) that target is opaque."""

    target: str
    from_ns: int
    until_ns: int | None = None


class OpaqueMarks:
    """Marks frames with the target that was opaque during all of their exposure.

    One task calls ``begin`` and ``end``; any thread marks. ``period_ns`` of a camera is the time from frame
    to frame, for frames that do not tell their exposure.
    """

    def __init__(self, clock: Clock, settle_s: float, period_ns: Mapping[str, int]) -> None:
        self._clock = clock
        self._settle_ns = round(settle_s * 1e9)
        self._period_ns = period_ns
        self._visits: tuple[_Visit, ...] = ()
        """The last ones, oldest first; replaced, never changed."""

    def begin(self, target: str) -> None:
        """The glass of a target is without voltage, all others have it: from now on they settle."""
        visit = _Visit(target, self._clock.monotonic_ns() + self._settle_ns)
        self._visits = (*self._visits, visit)[-_REMEMBERED:]

    def end(self) -> None:
        """The glasses are about to be switched."""
        if self._visits and self._visits[-1].until_ns is None:
            *before, last = self._visits
            self._visits = (*before, replace(last, until_ns=self._clock.monotonic_ns()))

    def mark(self, frame: Frame) -> Frame:
        """The frame with the target that was opaque; empty: the glasses were switched, or settled."""
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

    A switch that fails is tried again; until then no frame is marked. ``chance`` gives numbers from 0 to 1.
    ``is_shuffled``: each round has its own order. A beam needs that: a vibration whose period is the round's
    would move front and rear spots to opposite sides in every round, and look like yaw.
    """

    switches: LampController[str]
    marks: OpaqueMarks
    clock: Clock
    targets: Sequence[str]
    settings: ChainSettings | AnySwitchesSettings
    fps: float
    chance: Callable[[], float] = random.random
    is_shuffled: bool = False

    def _order(self) -> Iterator[str]:
        while True:
            yield from sorted(self.targets, key=lambda _: self.chance() if self.is_shuffled else 0.0)

    async def run(self) -> None:
        """Switch, settle, expose, and the next."""
        exposing_s = (self.settings.exposures + 1) / self.fps
        for target in self._order():
            while not await self._switch(target):
                await self.clock.sleep(_RETRY_S)
            pause_s = MAX_PAUSE_SHARE * self.settings.settle_s * self.chance()
            await self.clock.sleep(self.settings.settle_s + exposing_s + pause_s)

    async def _switch(self, target: str) -> bool:
        """Make a target opaque and all others clear; False: that failed."""
        self.marks.end()
        try:
            await self.switches.apply(target)
        except LampsError:
            return False
        self.marks.begin(target)
        return True


def glass_cycle(switches: LampController[str], config: Config, fps: float, clock: Clock) -> GlassCycle:
    """The cycle of a config's row, or of a beam with ``[switches]``."""
    settings = _visits(config)
    targets = [target.name for target in config.targets]
    period_ns = {target.camera: round(1e9 / fps) for target in config.targets}
    marks = OpaqueMarks(clock, settings.settle_s, period_ns)
    is_beam = config.unit.instrument == "beam"
    return GlassCycle(switches, marks, clock, targets, settings, fps, is_shuffled=is_beam)


def _visits(config: Config) -> ChainSettings | AnySwitchesSettings:
    """The settings of the visits: a row has them in [chain], a beam in [switches]."""
    is_beam = config.unit.instrument == "beam"
    return config.switches if is_beam and config.switches else config.chain or ChainSettings()


def round_s(config: Config, fps: float) -> tuple[float, float]:
    """The shortest and the longest duration of a round of all targets."""
    settings, targets = _visits(config), len(config.targets)
    visit_s = settings.settle_s + (settings.exposures + 1) / fps
    return targets * visit_s, targets * (visit_s + MAX_PAUSE_SHARE * settings.settle_s)
