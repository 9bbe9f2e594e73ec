"""The cycle of a row's glasses: which frames show which target, and what a switch that fails does."""

import asyncio
import random
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from support.clock import FakeClock, stop

from altd.acquisition.glasses import GlassCycle, OpaqueMarks, round_s
from altd.acquisition.lamps.controller import LampController
from altd.config import Config, RowSettings, Target, Unit
from altd.ports import LampsError
from altd.records import Frame

FPS = 20.0
PERIOD_NS = 50_000_000
SETTINGS = RowSettings(settle_s=0.3, exposures=4)
TARGETS = ("t1", "t2", "t3")
PIXELS = np.zeros((4, 4), np.uint8)
CONFIG = Config(
    unit=Unit(serial="ROW", calibration=Path("chain.json"), instrument="chain"),
    targets=tuple(Target(name=name, z_mm=float(at), camera=name) for at, name in enumerate(TARGETS)),
    chain=SETTINGS,
)


class Switch:
    """The controller of the glasses, as far as the cycle knows it."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.complaint = ""
        self.shown: list[tuple[str, float]] = []
        self.takes_s = 0.0

    async def apply(self, opaque: str) -> None:
        await self.clock.sleep(self.takes_s)
        if self.complaint:
            raise LampsError(self.complaint)
        self.shown.append((opaque, self.clock.now_ns * 1e-9))


@pytest.fixture
async def clock() -> AsyncIterator[FakeClock]:
    clock = FakeClock.of_loop(now_ns=10**9)
    yield clock
    clock.end()


def frame(t_ns: int, exposure_ms: float | None = 2.0, opaque: str = "") -> Frame:
    return Frame("t1", 0, t_ns, PIXELS, exposure_ms=exposure_ms, opaque=opaque)


def cycle_of(clock: FakeClock, switch: Switch, seed: int = 1) -> GlassCycle:
    marks = OpaqueMarks(clock, SETTINGS.settle_s, {"t1": PERIOD_NS})
    controller = cast("LampController[str]", switch)
    return GlassCycle(controller, marks, clock, TARGETS, SETTINGS, FPS, random.Random(seed).random)


@pytest.mark.parametrize("seed", range(5))
async def test_every_target_gets_its_exposures_and_the_round_keeps_its_time(
    clock: FakeClock, seed: int
) -> None:
    switch = Switch(clock)
    cycle = cycle_of(clock, switch, seed)
    task = asyncio.create_task(cycle.run())
    seen: list[str] = []
    for _ in range(400):
        await clock.advance(PERIOD_NS * 1e-9)
        seen.append(cycle.marks.mark(frame(clock.now_ns - 2_000_000)).opaque)
    visits = [name for at, name in enumerate(seen) if name and (at == 0 or seen[at - 1] != name)]
    assert visits[:7] == ["t1", "t2", "t3", "t1", "t2", "t3", "t1"]
    runs = "".join("." if not name else name[-1] for name in seen).split(".")
    assert all(len(run) >= SETTINGS.exposures for run in filter(None, runs[:-1]))
    starts_s = [at_s for name, at_s in switch.shown if name == "t1"]
    durations_s = np.diff(starts_s)
    shortest_s, longest_s = round_s(CONFIG, FPS)
    assert np.all((durations_s >= shortest_s) & (durations_s <= longest_s))
    assert durations_s.std() > 0.02  # by chance: no vibration stays in step
    await stop(task)


async def test_the_rounds_of_a_beam_have_an_order_by_chance(clock: FakeClock) -> None:
    switch = Switch(clock)
    cycle = replace(cycle_of(clock, switch), is_shuffled=True)
    task = asyncio.create_task(cycle.run())
    await clock.until(lambda: len(switch.shown) == 120, within_s=200.0)
    await stop(task)
    names = [name for name, _ in switch.shown]
    rounds = [tuple(names[at : at + 3]) for at in range(0, 120, 3)]
    assert all(sorted(of) == sorted(TARGETS) for of in rounds)
    assert len(set(rounds)) == 6  # all orders of three


async def test_a_frame_is_marked_only_if_all_of_its_exposure_shows_one_settled_target(
    clock: FakeClock,
) -> None:
    marks = OpaqueMarks(clock, 0.3, {"t1": PERIOD_NS})
    assert marks.mark(frame(clock.now_ns)).opaque == ""
    marks.begin("t1")
    began_ns = clock.now_ns
    await clock.advance(1.0)
    marks.end()
    ended_ns = clock.now_ns
    marks.begin("t2")
    await clock.advance(1.0)
    margin_ns = 11_000_000  # 1 ms to the end of the exposure, 10 ms between the clocks
    settled_ns = began_ns + 300_000_000
    for t_ns, opaque in (
        (settled_ns + margin_ns, "t1"),
        (settled_ns + margin_ns - 1, ""),
        (ended_ns - margin_ns, "t1"),  # it came late: the next glass is opaque by now
        (ended_ns - margin_ns + 1, ""),
        (ended_ns + 300_000_000 + margin_ns, "t2"),
    ):
        assert marks.mark(frame(t_ns)).opaque == opaque
    unknown = frame(settled_ns + margin_ns, exposure_ms=None)  # as long as from frame to frame
    assert marks.mark(unknown).opaque == ""
    assert marks.mark(frame(began_ns, opaque="t3")).opaque == ""  # the marks alone decide


async def test_a_switch_that_fails_marks_nothing_and_is_tried_again(clock: FakeClock) -> None:
    switch = Switch(clock)
    cycle = cycle_of(clock, switch)
    task = asyncio.create_task(cycle.run())
    await clock.until(lambda: len(switch.shown) == 2)
    switch.complaint = "the chip is gone"
    await clock.advance(2.0)
    lost = len(switch.shown)
    assert cycle.marks.mark(frame(clock.now_ns - 1_000_000)).opaque == ""
    await clock.advance(60.0)
    assert len(switch.shown) == lost
    switch.complaint = ""
    await clock.until(lambda: len(switch.shown) > lost, within_s=1.0)
    assert switch.shown[-1][0] == "t3"  # the one that failed, not the next
    await stop(task)


async def test_frames_are_not_marked_while_a_switch_hangs(clock: FakeClock) -> None:
    switch = Switch(clock)
    cycle = cycle_of(clock, switch)
    task = asyncio.create_task(cycle.run())
    await clock.until(lambda: len(switch.shown) == 1)
    switch.takes_s = 30.0
    await clock.advance(5.0)
    assert cycle.marks.mark(frame(clock.now_ns - 50_000_000)).opaque == ""
    await stop(task)
