"""Runs episodes, each from its own seed, in one or two processes, until enough was measured."""

import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import count, islice
from multiprocessing import active_children, get_context

import cv2
import numpy as np

from benchmarks.campaign.clips import Rig, rig_of
from benchmarks.campaign.detectability import Subject
from benchmarks.campaign.episode import run_episode, run_misnumbered, run_timed
from benchmarks.campaign.judge import HIDDEN_SUFFIX, Outcome, Tally
from benchmarks.campaign.units import SIMULATED, calibrated
from benchmarks.campaign.way import Draw, Spoil, Way, both
from benchmarks.campaign.ways import ANOTHER_UNIT, WAYS
from benchmarks.campaign.ways.numbers import Misnumbered
from benchmarks.campaign.ways.times import Mistimed

PAIRS = "pairs"
_ONE_IS_HIDDEN = "one of the two cannot be detected"
_MOVING_SHARE = 0.2
_BATCH = 6
_COMBINED = ("spots", "surfaces", "ambient", "frames", "cameras")


@dataclass(frozen=True, slots=True)
class Plan:
    """Selection of the episodes; ``pairs`` is the share of episodes disturbed in two ways at once."""

    ways: tuple[str, ...]
    units: tuple[str, ...]
    seed: int
    pairs: float


@dataclass(frozen=True, slots=True)
class Effort:
    """Limits of a campaign in seconds and measurements; the first one reached ends it, None is no limit."""

    seconds: float | None
    measurements: int | None
    processes: int


def run(plan: Plan, effort: Effort, progress: Callable[[int, float], None]) -> tuple[dict[str, Tally], float]:
    """Run the campaign; return the sums by way, and the duration in s."""
    for unit in plan.units:
        calibrated(unit)  # makes the calibrations before the processes need them
    tallies: dict[str, Tally] = {}
    began_s = time.monotonic()
    made = 0
    with closing(_batches(plan, effort.processes)) as batches:
        for results in batches:
            for name, tally in results.items():
                tallies.setdefault(name, Tally()).merge(tally)
                made += tally.measurements + tally.clean
            passed_s = time.monotonic() - began_s
            progress(made, passed_s)
            out_of_time = effort.seconds is not None and passed_s >= effort.seconds
            if out_of_time or (effort.measurements is not None and made >= effort.measurements):
                break
    order = [name + suffix for name in (*WAYS, PAIRS) for suffix in ("", HIDDEN_SUFFIX)]
    return {name: tallies[name] for name in order if name in tallies}, time.monotonic() - began_s


def _batches(plan: Plan, processes: int) -> Generator[dict[str, Tally]]:
    """Yield the sums of a few episodes at a time, in the order of their numbers."""
    batches = (range(first, first + _BATCH) for first in count(0, _BATCH))
    if processes == 1:
        prepare()
        yield from (batch(plan, numbers) for numbers in batches)
    with workers(processes) as pool:
        waiting = deque(pool.submit(batch, plan, numbers) for numbers in islice(batches, 3 * processes))
        while True:
            yield waiting.popleft().result()
            waiting.append(pool.submit(batch, plan, next(batches)))


@contextmanager
def workers(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes within the block; their unfinished work ends with it.

    They are not forked: OpenCV's threads do not survive a fork.
    """
    pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=prepare)
    try:
        yield pool
    finally:
        for worker in active_children():  # one may be at work for an hour of ``good``
            worker.terminate()
        pool.shutdown(cancel_futures=True)


def prepare() -> None:
    """Lower the priority of a worker process and limit it to one thread."""
    os.nice(5)
    cv2.setNumThreads(1)


def batch(plan: Plan, numbers: Sequence[int]) -> dict[str, Tally]:
    """Run the episodes of these numbers."""
    tallies: dict[str, Tally] = {}
    for number in numbers:
        name, note, outcome, invisible = episode(plan, number)
        tallies.setdefault(name, Tally()).add(outcome, note, invisible)
    return tallies


def episode(plan: Plan, number: int) -> tuple[str, str, Outcome, str]:
    """Run one episode; return its way, parameters, result, and the reason if it cannot be detected.

    Ways alternate, so that each gets its share even in a short run; the unit is drawn.
    """
    rng = np.random.default_rng([plan.seed, number])
    way = WAYS[plan.ways[number % len(plan.ways)]]
    spoil = way.make(Draw(rng))
    simulated = [name for name in plan.units if name in SIMULATED] or ["plain"]
    units = plan.units if isinstance(spoil, Spoil) else simulated
    unit = units[int(rng.integers(len(units)))]
    rig = rig_of(unit)
    if isinstance(spoil, Spoil):
        return _spoilt(plan, way, spoil, rig, rng, number)
    if isinstance(spoil, Mistimed):
        name, note, outcome = way.name, f"{spoil.note} (by {spoil.pair_by})", run_timed(rig, spoil, rng)
    elif isinstance(spoil, Misnumbered):
        name, note, outcome = way.name, spoil.note, run_misnumbered(rig, spoil, rng)
    else:
        raise TypeError(f"{way.name} makes {type(spoil).__name__}")
    return name, f"#{number} {unit}: {note}", outcome, way.invisible


def _spoilt(
    plan: Plan, way: Way, spoil: Spoil, rig: Rig, rng: np.random.Generator, number: int
) -> tuple[str, str, Outcome, str]:
    """Run an episode of frames, in some cases disturbed by a second way too."""
    name, note, moving = way.name, spoil.note, way.moving or rng.random() < _MOVING_SHARE
    if rng.random() < plan.pairs and way.kind != "good" and not way.invisible:
        other = _other(plan, way, rng)
        second = other.make(Draw(rng))
        if isinstance(second, Spoil):
            note = f"{way.name} {spoil.note} + {other.name} {second.note}"
            spoil, name, moving = both(spoil, second), PAIRS, moving or other.moving
    foreign = None
    if way.name == ANOTHER_UNIT:
        if not (alike := _units_alike(rig)):
            rig = rig_of("plain")
            alike = _units_alike(rig)
        foreign = rig_of(alike[int(rng.integers(len(alike)))])
    hidden = spoil.undetectable(Subject.of(SIMULATED.get(rig.name)))
    outcome = run_episode(rig, spoil, rng, moving, foreign)
    invisible = way.invisible or (_ONE_IS_HIDDEN if hidden and name == PAIRS else hidden)
    return name + HIDDEN_SUFFIX * bool(hidden), f"#{number} {rig.name}: {note}", outcome, invisible


def _units_alike(rig: Rig) -> list[str]:
    """Other simulated units with the same number of bits per pixel."""
    return [
        spec.name for spec in SIMULATED.values() if spec.config.bits == rig.bits and spec.name != rig.name
    ]


def _other(plan: Plan, way: Way, rng: np.random.Generator) -> Way:
    """Draw the second way of a pair."""
    apart = (way.name, ANOTHER_UNIT)
    others = [
        WAYS[name]
        for name in plan.ways
        if name not in apart and WAYS[name].kind in _COMBINED and not WAYS[name].invisible
    ]
    return others[int(rng.integers(len(others)))] if others else way
