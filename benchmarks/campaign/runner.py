"""Runs episodes, each from a seed of its own, in one or two processes, until enough was measured."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import cv2
import numpy as np

from benchmarks.campaign.cache import calibrated
from benchmarks.campaign.catalogue import ANOTHER_UNIT, WAYS
from benchmarks.campaign.clips import Rig, rig_of
from benchmarks.campaign.episode import Episode, run_episode
from benchmarks.campaign.judge import Tally
from benchmarks.campaign.units import SIMULATED
from benchmarks.campaign.way import Draw, Way, both

PAIRS = "pairs"
_MOVING_SHARE = 0.2
_BATCH = 6


@dataclass(frozen=True, slots=True)
class Plan:
    """What is drawn from; ``pairs`` is the share of episodes that are spoilt in two ways at once."""

    ways: tuple[str, ...]
    units: tuple[str, ...]
    seed: int
    pairs: float


@dataclass(frozen=True, slots=True)
class Effort:
    """When it is enough: so many seconds or measurements, whichever comes first; None ends nothing."""

    seconds: float | None
    measurements: int | None
    processes: int


def run(plan: Plan, effort: Effort, progress: Callable[[int, float], None]) -> tuple[dict[str, Tally], float]:
    """The sums by way, and the seconds that it took."""
    for unit in plan.units:
        calibrated(unit)  # makes the calibrations before processes do so together
    tallies: dict[str, Tally] = {}
    began_s = time.monotonic()
    made = 0
    for results in _batches(plan, effort.processes):
        for name, tally in results.items():
            tallies.setdefault(name, Tally()).merge(tally)
            made += tally.measurements + tally.clean
        passed_s = time.monotonic() - began_s
        progress(made, passed_s)
        out_of_time = effort.seconds is not None and passed_s >= effort.seconds
        if out_of_time or (effort.measurements is not None and made >= effort.measurements):
            break
    order = {name: number for number, name in enumerate((*WAYS, PAIRS))}
    return dict(sorted(tallies.items(), key=lambda item: order[item[0]])), time.monotonic() - began_s


def _batches(plan: Plan, processes: int) -> Iterator[dict[str, Tally]]:
    """The sums of a few episodes at a time, in the order of their numbers."""
    if processes == 1:
        _prepare()
        number = 0
        while True:
            yield batch(plan, range(number, number + _BATCH))
            number += _BATCH
    # not forked: OpenCV's threads do not live on in a fork
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=_prepare) as pool:
        waiting = [
            pool.submit(batch, plan, range(n * _BATCH, (n + 1) * _BATCH)) for n in range(3 * processes)
        ]
        number = len(waiting)
        try:
            while True:
                yield waiting.pop(0).result()
                waiting.append(pool.submit(batch, plan, range(number * _BATCH, (number + 1) * _BATCH)))
                number += 1
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _prepare() -> None:
    os.nice(5)
    cv2.setNumThreads(1)


@cache
def _rig(name: str) -> Rig:
    return rig_of(name)


def batch(plan: Plan, numbers: Sequence[int]) -> dict[str, Tally]:
    """Run the episodes of these numbers."""
    tallies: dict[str, Tally] = {}
    for number in numbers:
        name, note, result = episode(plan, number)
        tallies.setdefault(name, Tally()).add(result.clean, result.spoilt, note)
    return tallies


def episode(plan: Plan, number: int) -> tuple[str, str, Episode]:
    """Run one episode; the name of its way, what was drawn, and what came of it.

    Ways come in turn, so that each gets its share however short the run; the unit is drawn.
    """
    rng = np.random.default_rng([plan.seed, number])
    draw = Draw(rng)
    way = WAYS[plan.ways[number % len(plan.ways)]]
    unit = plan.units[(number // len(plan.ways) + int(rng.integers(len(plan.units)))) % len(plan.units)]
    rig = _rig(unit)
    spoil, name, moving = way.make(draw), way.name, way.moving or rng.random() < _MOVING_SHARE
    if rng.random() < plan.pairs and way.kind not in ("good",) and not way.invisible:
        other = _other(plan, way, rng)
        spoil, name, moving = both(spoil, other.make(draw)), PAIRS, moving or other.moving
        note = f"{way.name} {spoil.note.split('; ')[0]} + {other.name} {spoil.note.split('; ', 1)[-1]}"
    else:
        note = spoil.note
    foreign = None
    if way.name == ANOTHER_UNIT:
        alike = [one.name for one in SIMULATED.values() if one.config.bits == rig.bits and one.name != unit]
        foreign = _rig(alike[int(rng.integers(len(alike)))])
    return name, f"#{number} {unit}: {note}", run_episode(rig, spoil, rng, moving, foreign)


def _other(plan: Plan, way: Way, rng: np.random.Generator) -> Way:
    """The second way of a pair."""
    others = [
        WAYS[name]
        for name in plan.ways
        if name not in (way.name, ANOTHER_UNIT) and WAYS[name].kind != "good" and not WAYS[name].invisible
    ]
    return others[int(rng.integers(len(others)))] if others else way
