"""Microseconds per stage of the chain, over many frames that are not in any cache: each alone, and inside."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import cv2
import numpy as np

import altd.instruments.beam.instrument as instrument_room
import altd.measuring.spot_locator as locator_room
import altd.vision.frame_analysis as analysis_room
import altd.vision.localise as localise_room
import altd.vision.search as search_room
from altd.instruments.beam.instrument import BeamInstrument
from altd.instruments.beam.solver import fit_beam, joint_covariance_mm2
from altd.measuring.averaging import FrameSetWindow
from altd.measuring.calibration import TargetCalibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import Provenance
from altd.measuring.freshness import FreshnessCheck
from altd.measuring.gate import Gate
from altd.measuring.light_balance import LightBalance
from altd.measuring.motion_memory import MotionMemory
from altd.measuring.pairing import Pairer
from altd.measuring.synchrony import SynchronyCheck
from altd.measuring.view_check import ViewCheck
from altd.reasons import Reason
from altd.records import Fault, Frame, FrameSet, MeanSpots, Spot, TargetPoint
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.localise import locate, spot_in
from altd.vision.search import Search
from benchmarks.material import CAMERAS, WINDOW, Material, make_config

PERIOD_NS = 50_000_000
COPY, SEARCH, CHAIN, REST = "memory pass: copy", "coarse search", "whole chain", "chain, all else"

_Part = tuple[object, str, str]
"""Module that calls a function, or class of a method, its name there, and its name in the table."""

_SEARCH_PARTS: Sequence[_Part] = (
    (search_room, "coarse_image", "coarse picture"),
    (search_room, "fit_background", "background"),
)
_SPOT_PARTS: Sequence[_Part] = (
    (analysis_room, "patch_around", "patch"),
    (localise_room, "_classify", "judging"),
    (analysis_room, "pixel_noise", "noise"),
    (localise_room, "is_patterned", "print or not"),
    (localise_room, "_profile", "profile"),
    (localise_room, "misfit_of", "misfit"),
    (localise_room, "moment", "moment"),
)
RATES_HZ = 20, 100, 200
"""Rates of the pairs for the stages inside the chain: a rare one finds less in the caches."""
_INSIDE: Sequence[_Part] = (
    (analysis_room, "search", SEARCH),
    (localise_room, "spot_in", "fine {0.frame.camera}"),
    (FreshnessCheck, "repeated", "new frames, both"),
    (Pairer, "add", "pairing"),
    (SynchronyCheck, "inspect", "motion in step"),
    (FrameSetWindow, "add", f"averaging over {WINDOW}"),
    (TargetCalibration, "point", "mapping, one point"),
    (TargetCalibration, "cross_checked", "cross-check, one point"),
    (instrument_room, "joint_covariance_mm2", "beam fit"),
    (instrument_room, "fit_beam", "beam fit"),
    (BeamInstrument, "solve", "solution, all else"),
    (ViewCheck, "objection", "view of the camera"),
    (locator_room, "count_dust", "dust, each 5 s"),
    (LightBalance, "changed_light", "light of the targets"),
    (LightBalance, "update", "light of the targets"),
    (MotionMemory, "add", "motion over windows"),
    (Gate, "admit", "gate"),
    (MeasuringChain, "push", REST),
)


@dataclass(frozen=True, slots=True)
class StageFigures:
    """One stage: number of calls for a pair, and time of a call; ``passes`` is the time in memory passes.

    If ``part_of`` is not empty, the stage is part of another one.
    """

    name: str
    part_of: str
    calls_a_pair: int
    median_us: float
    p99_us: float
    passes: float


@dataclass(slots=True)
class _Stage:
    """A stage; the functions of ``parts`` are timed within its own calls."""

    name: str
    calls_a_pair: int
    works: Sequence[Callable[[], object]]
    parts: Sequence[_Part] = ()
    rest: str = ""
    """Name in the table for the time outside all parts."""
    part_of: str = ""
    samples_us: list[float] = field(default_factory=list)
    inside_us: dict[str, list[float]] = field(default_factory=dict)

    def take(self) -> None:
        clock = time.perf_counter_ns
        with ExitStack() as patches:
            for room, function, name in self.parts:
                samples_us = self.inside_us.setdefault(name, [])
                timed = _timed(getattr(room, function), samples_us)
                patches.enter_context(mock.patch.object(room, function, timed))
            for work in self.works:
                before = clock()
                work()
                self.samples_us.append((clock() - before) * 1e-3)

    def inner(self) -> list[_Stage]:
        """Parts as stages, without parts that a target did not need."""
        used = {name: samples_us for name, samples_us in self.inside_us.items() if samples_us}
        if self.rest:
            parts = zip(*used.values(), strict=True)
            used[self.rest] = [whole - sum(part) for whole, part in zip(self.samples_us, parts, strict=True)]
        return [
            _Stage(name, self.calls_a_pair, (), part_of=self.name, samples_us=samples_us)
            for name, samples_us in used.items()
        ]


def measure_stages(material: Material, rounds: int) -> list[StageFigures]:
    """Time every stage over all frames, in turn, ``rounds`` times: disturbances affect all alike.

    Before a frame's next turn it has left the caches, like a frame that a camera has just written.
    """
    stages = [
        *_memory_stages(material),
        *_vision_stages(material),
        *_stages_after_vision(material, rounds),
    ]
    for _ in range(rounds):
        for stage in stages:
            stage.take()
    stages = [row for stage in stages for row in (stage, *stage.inner())]
    one_pass_us = float(np.median(stages[0].samples_us))
    return [_figures(stage, one_pass_us) for stage in stages]


def pure_rate(material: Material, seconds: float) -> float:
    """Pairs/s of the chain alone, called in a loop."""
    chain = _chain(material)
    count, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        for frame in material.pair(count, count * PERIOD_NS):
            chain.push(frame)
        count += 1
    return count / (time.perf_counter() - begun)


class _Inside:
    """CPU time of calls within each other: that of a call is without the timed calls that it makes.

    Between two pairs of a slow rate other programs get the processor; CPU time does not contain theirs.
    """

    def __init__(self) -> None:
        self.ns: Counter[str] = Counter()
        self._of_inner_ns = [0]

    def timed(self, work: Callable[..., object], name: str) -> Callable[..., object]:
        """Time a function; ``name`` is a format of its arguments."""

        def timed(*arguments: object, **more: object) -> object:
            stage = name.format(*arguments)
            self.ns[stage] += 0  # the order of the stages is that of their first calls
            self._of_inner_ns.append(0)
            before = time.thread_time_ns()
            try:
                return work(*arguments, **more)
            finally:
                took_ns = time.thread_time_ns() - before
                self.ns[stage] += took_ns - self._of_inner_ns.pop()
                self._of_inner_ns[-1] += took_ns

        return timed


def measure_inside(material: Material) -> dict[str, list[float]]:
    """Mean CPU time of each stage inside the chain, µs a pair, with all pairs once at each of ``RATES_HZ``.

    The last row is the whole chain: by construction the sum of the others.
    """
    runs = [_inside_us(material, rate_hz) for rate_hz in RATES_HZ]
    _, *names = dict.fromkeys(name for run in runs for name in run)
    inside_us = {name: [run.get(name, 0.0) for run in runs] for name in (*names, REST)}
    return inside_us | {CHAIN: [sum(run.values()) for run in runs]}


def _inside_us(material: Material, rate_hz: float) -> dict[str, float]:
    """Pace the chain; its window is filled before."""
    chain, calls = _chain(material), len(material.pairs)
    sets = [material.pair(k, k * PERIOD_NS) for k in range(WINDOW + calls)]
    inside = _Inside()
    for frame in (frame for frames in sets[:WINDOW] for frame in frames):
        chain.push(frame)
    with ExitStack() as patches:
        for place, function, name in _INSIDE:
            timed = inside.timed(getattr(place, function), name)
            patches.enter_context(mock.patch.object(place, function, timed))
        due_s = time.monotonic()
        for frames in sets[WINDOW:]:
            time.sleep(max(due_s - time.monotonic(), 0.0))
            due_s += 1 / rate_hz
            for frame in frames:
                chain.push(frame)
    return {name: total_ns * 1e-3 / calls for name, total_ns in inside.ns.items()}


def _figures(stage: _Stage, one_pass_us: float) -> StageFigures:
    median_us, p99_us = (float(value) for value in np.percentile(stage.samples_us, (50, 99)))
    return StageFigures(
        stage.name, stage.part_of, stage.calls_a_pair, median_us, p99_us, median_us / one_pass_us
    )


def _chain(material: Material) -> MeasuringChain:
    config = make_config()
    views = [View(target.name, target.camera) for target in config.targets]
    instrument = BeamInstrument(material.calibration, config.measuring, config.installation)
    provenance = Provenance(origins=lambda: [Fault(Reason.SIMULATED)])
    return MeasuringChain(views, material.calibration, config.measuring, instrument, provenance)


def _memory_stages(material: Material) -> list[_Stage]:
    """Minimum cost of accessing every pixel of a frame."""
    frames = [frame.pixels for pair in material.pairs for frame in pair]
    kept = np.empty_like(frames[0])
    size = kept.shape[1] // 8, kept.shape[0] // 8

    def copy(pixels: Any) -> None:
        np.copyto(kept, pixels)

    def shrink(pixels: Any) -> None:
        cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)

    return [
        _Stage(COPY, 2, [_call(copy, pixels) for pixels in frames]),
        _Stage("memory pass: cv2.resize to 1/8", 2, [_call(shrink, pixels) for pixels in frames]),
    ]


def _vision_stages(material: Material) -> list[_Stage]:
    every = [_call(search_room.search, f.pixels) for pair in material.pairs for f in pair]
    stages = [_Stage(SEARCH, 2, every, _SEARCH_PARTS, "regions")]
    for what, calibration in (("", material.calibration), (", no flat", material.without_flats)):
        for index, name in enumerate(CAMERAS):
            target = calibration.target(name)
            assert target is not None  # noqa: S101  the scan has both
            works = []
            for pair in material.pairs:
                found = search_room.search(pair[index].pixels)
                works.append(_call(_fine, pair[index], found, target))
            stages.append(_Stage(f"fine {name}{what}", 1, works, _SPOT_PARTS))
    return stages


def _fine(frame: Frame, found: Search, target: TargetCalibration) -> None:
    analysis = FrameAnalysis(frame, target.localiser, found)
    spot_in(analysis, found.regions[0], target.flat, target.spot)


def _timed(work: Callable[..., object], samples_us: list[float]) -> Callable[..., object]:
    def timed(*arguments: object) -> object:
        before = time.perf_counter_ns()
        result = work(*arguments)
        samples_us.append((time.perf_counter_ns() - before) * 1e-3)
        return result

    return timed


def _stages_after_vision(material: Material, rounds: int) -> list[_Stage]:
    """Pairing to beam, and the whole chain: they have state, so their frames are those of one long run."""
    calls = len(material.pairs)
    run = [material.pair(k, k * PERIOD_NS) for k in range(rounds * calls)]
    spots = {id(frame.pixels): _spot(material, frame) for pair in material.pairs for frame in pair}
    exposures = [
        FrameSet(pair[0].sequence, pair[0].t_ns, {f.camera: spots[id(f.pixels)] for f in pair})
        for pair in run
    ]
    pairer: Pairer[Spot] = Pairer(CAMERAS, "time", 10_000_000, 30_000_000)
    window = FrameSetWindow(CAMERAS, WINDOW, 1)
    chain = _chain(material)
    fresh = {camera: FreshnessCheck() for camera in CAMERAS}
    synchrony = SynchronyCheck(CAMERAS)
    to_check, to_compare = iter(run), iter(exposures)
    to_pair, to_average, to_chain = iter(run), iter(exposures), iter(run)

    def check_two() -> None:
        for frame in next(to_check):
            fresh[frame.camera].repeated(frame)

    def pair_two() -> None:
        for frame in next(to_pair):
            pairer.add(frame.camera, frame.sequence, frame.t_ns, spots[id(frame.pixels)])

    def through_chain() -> None:
        for frame in next(to_chain):
            chain.push(frame)

    means, points = _means_and_points(material, exposures[:calls])
    map_works = [
        _call(target.point, float(u), float(v))
        for mean in means
        for target, (u, v) in zip(material.calibration.targets, mean.px, strict=True)
    ]
    check_works = [
        _call(target.cross_checked, point, float(u), float(v))
        for mean, found in zip(means, points, strict=True)
        for target, point, (u, v) in zip(material.calibration.targets, found, mean.px, strict=True)
    ]
    return [
        _Stage("new frames, both", 1, [check_two] * calls),
        _Stage("pairing", 1, [pair_two] * calls),
        _Stage("motion in step", 1, [lambda: synchrony.inspect(next(to_compare))] * calls),
        _Stage(f"averaging over {WINDOW}", 1, [lambda: window.add(next(to_average))] * calls),
        _Stage("mapping, one point", 2, map_works),
        _Stage("cross-check, one point", 2, check_works),
        _Stage("beam fit", 1, [_call(_beam, m, p) for m, p in zip(means, points, strict=True)]),
        _Stage(CHAIN, 1, [through_chain] * calls),
    ]


def _spot(material: Material, frame: Frame) -> Spot:
    target = material.calibration.target(frame.camera)
    spot = locate(frame, target.localiser, target.flat, target.spot) if target else locate(frame)
    if not isinstance(spot, Spot):
        raise TypeError(f"the material has a frame without a spot: {spot}")
    return spot


def _means_and_points(
    material: Material, exposures: Sequence[FrameSet]
) -> tuple[list[MeanSpots], list[list[TargetPoint]]]:
    window = FrameSetWindow(CAMERAS, WINDOW, 1)
    means = [mean for exposure in exposures if isinstance(mean := window.add(exposure), MeanSpots)]
    points = []
    for mean in means:
        mapped = [
            target.point(float(u), float(v))
            for target, (u, v) in zip(material.calibration.targets, mean.px, strict=True)
        ]
        points.append([point for point in mapped if point is not None])
    return means, points


def _beam(mean: MeanSpots, points: Sequence[TargetPoint]) -> None:
    fit_beam((0.0, 280.0), points, joint_covariance_mm2(mean, points))


def _call(function: Callable[..., object], *arguments: object) -> Callable[[], object]:
    return lambda: function(*arguments)
