"""``python -m benchmarks.peers_measure`` (``make bench-peers``): altd and other libraries, side by side."""

from __future__ import annotations

import argparse
import contextlib
import math
import platform
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import trackpy

import altd
from altd.records import FloatArray
from benchmarks.peers_frames import KINDS, Sample, make_samples
from benchmarks.peers_localise import LOCALISERS, Localiser
from benchmarks.peers_map import FOCAL_MM, GRIDS, MAPPERS, Mapper, Task, distance_mm, make_tasks
from benchmarks.peers_page import Cell, Figures, MapFigures, Scatter, SpotFigures, page
from tools.markdown import wrapped

UNITS, POSES, LENSES = 5, 30, 12
QUICK = 2, 14, 2

_MAX_ERROR_PX = 3.0
_MAX_ERROR_MM = 5.0
_MAP_DEGREE = 3


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and write the same to ``--page``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers_measure", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer frames and lenses")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the page there too")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)  # as the daemon does
    trackpy.quiet()
    warnings.simplefilter("ignore")  # what a peer warns of counts by what comes out
    units, poses, lenses = QUICK if options.quick else (UNITS, POSES, LENSES)
    spots, maps = measure_spots(units, poses), measure_maps(lenses)
    text = "\n".join(page(Figures(spots, maps, units, poses, lenses, _versions()))) + "\n"
    print(text)
    print(_absolute(spots, maps))
    if options.page:
        options.page.parent.mkdir(exist_ok=True)
        options.page.write_text(wrapped(text))
    return 0


def measure_spots(units: int, poses: int) -> list[SpotFigures]:
    """Every localiser on each frame before the next frame: what disturbs, disturbs all alike."""
    runs = [_SpotRun(localiser) for localiser in LOCALISERS]
    for number, sample in enumerate(make_samples(units, poses)):
        if number == 0:
            for run in runs:
                run.warm_up(sample)
        for run in runs:
            run.take(sample)
    return [run.figures() for run in runs]


class _SpotRun:
    """One localiser through all frames: errors by kind and by the camera of one unit, and times."""

    def __init__(self, localiser: Localiser) -> None:
        self._localiser = localiser
        self._times_ns: list[int] = []
        self._found: dict[tuple[str, int, str], list[tuple[float, float, float, float]]] = defaultdict(list)
        self._failed: dict[str, int] = defaultdict(int)

    def warm_up(self, sample: Sample) -> None:
        """Compile and import whatever the first call does."""
        with contextlib.suppress(Exception):  # it is counted in ``take``
            self._localiser.find(sample)

    def take(self, sample: Sample) -> None:
        """One frame."""
        before_ns = time.process_time_ns()  # what else the machine does does not count
        try:
            u, v = self._localiser.find(sample)
        except Exception as error:  # whatever a library raises is a failure of it
            if self._localiser.library == "altd" and not isinstance(error, LookupError):
                raise  # a mistake in here, not a spot that was not found
            u = v = math.nan
        self._times_ns.append(time.process_time_ns() - before_ns)
        true_u, true_v = sample.truth_px
        if math.hypot(u - true_u, v - true_v) <= _MAX_ERROR_PX:
            group = sample.kind, sample.seed, sample.frame.camera
            self._found[group].append((true_u, true_v, u - true_u, v - true_v))
        else:
            self._failed[sample.kind] += 1

    def figures(self) -> SpotFigures:
        localiser = self._localiser
        return SpotFigures(
            localiser.name,
            localiser.library == "altd",
            localiser.given,
            localiser.how,
            float(np.median(self._times_ns)) * 1e-3,
            {kind: self._scatter(kind) for kind in KINDS},
        )

    def _scatter(self, kind: str) -> Scatter:
        groups = [np.array(found) for (of, _, _), found in self._found.items() if of == kind]
        count = sum(len(group) for group in groups)
        raw = sum(float(np.square(group[:, 2:]).sum()) for group in groups)
        left, freedom = 0.0, 0
        for group in groups:
            design = _smooth(group[:, :2])
            if len(group) > design.shape[1]:
                solution = np.linalg.lstsq(design, group[:, 2:], rcond=None)[0]
                left += float(np.square(group[:, 2:] - design @ solution).sum())
                freedom += len(group) - design.shape[1]
        return Scatter(
            math.sqrt(raw / count) if count else math.nan,
            math.sqrt(left / freedom) if freedom else math.nan,
            count,
            self._failed[kind],
        )


def _smooth(px: FloatArray) -> FloatArray:
    """The monomials of a smooth map at (n, 2) px."""
    u, v = (px - px.mean(axis=0)).T / 300.0
    powers = [(i, j) for i in range(_MAP_DEGREE + 1) for j in range(_MAP_DEGREE + 1 - i)]
    return np.column_stack([u**i * v**j for i, j in powers])


def measure_maps(lenses: int) -> list[MapFigures]:
    """Every map on each lens and grid before the next one."""
    runs = [_MapRun(mapper) for mapper in MAPPERS]
    for number, task in enumerate(make_tasks(lenses)):
        if number == 0:
            for run in runs:
                run.warm_up(task)
        for run in runs:
            run.take(task)
    return [run.figures() for run in runs]


class _MapRun:
    """One map through all lenses and grids."""

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper
        self._fit_ns: list[int] = []
        self._point_ns: list[float] = []
        self._among_many_ns: list[float] = []
        self._errors_mm: dict[tuple[float, tuple[int, int]], list[FloatArray]] = defaultdict(list)
        self._failed: dict[tuple[float, tuple[int, int]], int] = defaultdict(int)

    def warm_up(self, task: Task) -> None:
        """Whatever the first call does once."""
        with contextlib.suppress(Exception):  # it is counted in ``take``
            self._mapper.fit(task)

    def take(self, task: Task) -> None:
        """One lens on one grid."""
        key = task.focal_mm, task.grid
        clock = time.process_time_ns
        begun_ns = clock()
        try:
            to_mm = self._mapper.fit(task)
            fitted_ns = clock()
            errors_mm = distance_mm(task, to_mm)
            mapped_ns = clock()
            points = [task.dense_px[row : row + 1] for row in range(0, len(task.dense_px), 100)]
            first_ns = clock()
            for point in points:
                to_mm(point)
            last_ns = clock()
        except Exception as error:  # whatever a library raises is a failure of it
            if self._mapper.library == "altd" and not isinstance(error, ValueError):
                raise
            self._failed[key] += 1
            return
        self._fit_ns.append(fitted_ns - begun_ns)
        self._among_many_ns.append((mapped_ns - fitted_ns) / len(errors_mm))
        self._point_ns.append((last_ns - first_ns) / len(points))
        if errors_mm.max() <= _MAX_ERROR_MM:
            self._errors_mm[key].append(errors_mm)
        else:
            self._failed[key] += 1

    def figures(self) -> MapFigures:
        return MapFigures(
            self._mapper.name,
            self._mapper.how,
            _median_us(self._fit_ns),
            _median_us(self._point_ns),
            _median_us(self._among_many_ns),
            {(focal_mm, grid): self._cell((focal_mm, grid)) for focal_mm in FOCAL_MM for grid in GRIDS},
        )

    def _cell(self, key: tuple[float, tuple[int, int]]) -> Cell:
        errors = self._errors_mm[key]
        if not errors:
            return Cell(math.nan, math.nan, self._failed[key])
        return Cell(float(np.mean(errors)), float(np.max(errors)), self._failed[key])


def _median_us(times_ns: Sequence[float]) -> float:
    return float(np.median(times_ns)) * 1e-3 if times_ns else math.nan


def _versions() -> dict[str, str]:
    libraries = sorted(
        {*(it.library for it in LOCALISERS), *(it.library for it in MAPPERS), "numba", "numpy"}
    )
    return {
        "altd": altd.__version__,
        **{library: version(library) for library in libraries if library != "altd"},
        "Python": platform.python_version(),
    }


def _absolute(spots: list[SpotFigures], maps: list[MapFigures]) -> str:
    """What the ratios are ratios to, on this machine; no part of the page."""
    frame, region, first = spots[0], spots[1], maps[0]
    return (
        f"altd on this machine, medians: {frame.name} {frame.median_us:.0f} µs, {region.name}"
        f" {region.median_us:.0f} µs; map: a fit {first.fit_us * 1e-3:.1f} ms,"
        f" a point {first.point_us:.0f} µs, among many {first.among_many_us:.0f} µs"
    )


if __name__ == "__main__":
    sys.exit(main())
