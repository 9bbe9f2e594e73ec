"""What ``make bench-peers`` found, as a page of Markdown that also reads well in a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

EQUAL = 0.02
"""Errors this share apart are called equal; their own chance is a few percent."""


Key = tuple[float, tuple[int, int]]
"""Focal length in mm, columns and rows of the grid."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Rms distances in px from the truth, of ``frames`` without those that failed.

    ``raw_px`` with nothing removed; ``mapped_px`` without what a smooth map takes out. NaN of too few.
    """

    raw_px: float
    mapped_px: float
    frames: int
    failed: int


@dataclass(frozen=True, slots=True)
class SpotFigures:
    """One localiser: what it is given, its median time a frame, and its scatter by kind of frame."""

    name: str
    altd: bool
    given: str
    how: str
    median_us: float
    scatter: dict[str, Scatter]


@dataclass(frozen=True, slots=True)
class Cell:
    """One focal length and grid: mean and largest error in mm over all lenses that were fitted."""

    mean_mm: float
    max_mm: float
    failed: int


@dataclass(frozen=True, slots=True)
class MapFigures:
    """One map: medians of a fit, of a point alone and of a point among many, and its errors."""

    name: str
    how: str
    fit_us: float
    point_us: float
    among_many_us: float
    cells: dict[Key, Cell]


@dataclass(frozen=True, slots=True)
class Figures:
    """All of a run; the first localiser and the first map are altd's."""

    spots: list[SpotFigures]
    maps: list[MapFigures]
    units: int
    poses: int
    lenses: int
    versions: dict[str, str]


_HEAD = f"""# Peers: altd beside other libraries

Written by `make bench-peers`: every library on the same frames and grids, in one run, in turn. Times
are medians of CPU time on one core as ratios to altd's in that run, so that they hold, within some ten
percent, on other machines. **Bold** is an error below altd's, or a shorter time at an equal or smaller
error somewhere. Errors less than {EQUAL:.0%} apart are called equal; chance alone makes a few percent."""

_SPOT_TERMS = """The dot window is printed and has speckle, the plate has speckle, the clean target has
neither and no hot pixels. The truth is the place of the spot's middle through the simulator's own lens. The
beam is a Gaussian, which suits who fits one.

*Mapped* is what counts in a unit: the rms distance to the truth after a smooth map (degree 3 in u and v,
one a camera of a unit, its freedom paid for) has taken out what any calibration does. *Raw* has nothing
taken out: perspective and the lens's fall-off then pull the middle of a wide spot by a tenth of a pixel,
the more the more weight its flanks have. *Failed* raised, found none or was off by more than 3 px. Errors
and *time* are compared with altd given the same: the whole frame or the spot's region, without or with a
flat field (the mean of 20 exposures in even light less 20 in the dark)."""

_SPOT_HELP = """How each was used. A region is the bright area that altd's coarse search finds, widened on all
sides by half its longer side, so to about twice the spot's 1/e² radius. The peers get it with the
background that altd finds subtracted, and all they get has the hot pixels mended as from a camera's list of
defects, before their time begins. altd has neither help: within its time it cuts, subtracts the background,
removes hot pixels, rejects what is no laser spot and states a sigma. Settings that a peer leaves to its
user were tried on two other units, and the best on the dot window taken."""

_MAP_TERMS = """tilted lenses with Brown distortion a focal length, by the simulator's own code, which suits
who assumes it; nodes over 125 × 100 mm with 0.05 px noise; errors on 2000 held-out points between them over
the same area. Times are relative to altd's: a fit, one point alone (a daemon asks for one a frame), and a
point among 2000 in one call. *Failed* raised, or put a point nowhere or off by more than 5 mm."""


def page(figures: Figures) -> Iterator[str]:
    """The lines of the page."""
    yield from _HEAD.splitlines()
    yield ""
    yield ", ".join(f"{name} {version}" for name, version in figures.versions.items())
    yield ""
    yield from _spots(figures)
    yield ""
    yield from _maps(figures)


def _spots(figures: Figures) -> Iterator[str]:
    first = figures.spots[0]
    kinds = list(first.scatter)
    yield "## The spot of a frame"
    yield ""
    counts = ", ".join(f"{it.frames + it.failed} {kind}" for kind, it in first.scatter.items())
    yield (
        f"{figures.units} simulated units with {figures.poses} poses each, 752 × 480 px, 8 bits;"
        f" frames: {counts}."
    )
    yield from _SPOT_TERMS.splitlines()
    yield ""
    mapped, raw = [], []
    for spot in figures.spots:
        altd = _given_the_same(figures.spots, spot)
        ratio = spot.median_us / altd.median_us
        failed = sum(scatter.failed for scatter in spot.scatter.values())
        level = any(_compare_spots(spot, altd, kind) for kind in kinds)
        mapped.append(
            [
                spot.name,
                spot.given,
                _marked(_ratio(ratio), level and ratio < 1 and not spot.altd),
                *(_error(spot.scatter[k].mapped_px, altd.scatter[k].mapped_px, 4) for k in kinds),
                str(failed),
            ]
        )
        raw_px = (_error(spot.scatter[k].raw_px, altd.scatter[k].raw_px, 3) for k in kinds)
        raw.append([spot.name, spot.given, *raw_px])
    yield from _table(["mapped, px", "given", "time", *kinds, "failed"], mapped)
    yield ""
    yield from _table(["raw, px", "given", *kinds], raw)
    yield ""
    yield from _behind(_spots_ahead(figures.spots))
    yield ""
    yield from _SPOT_HELP.splitlines()
    yield ""
    yield from (f"- {spot.name} ({spot.given}): {spot.how}." for spot in figures.spots)


def _maps(figures: Figures) -> Iterator[str]:
    first = figures.maps[0]
    titles = [_title(key) for key in first.cells]
    yield "## The map from px to mm"
    yield ""
    terms = _MAP_TERMS.splitlines()
    yield f"{figures.lenses} {terms[0]}"
    yield from terms[1:]
    yield ""
    mean, largest = [], []
    for entry in figures.maps:
        level = entry is not first and any(_compare_maps(entry, first, key) for key in first.cells)
        ratios = (
            entry.fit_us / first.fit_us,
            entry.point_us / first.point_us,
            entry.among_many_us / first.among_many_us,
        )
        pairs = [(entry.cells[key], cell) for key, cell in first.cells.items()]
        failed = sum(cell.failed for cell in entry.cells.values())
        times = [_marked(_ratio(ratio), level and ratio < 1) for ratio in ratios]
        mean.append(
            [
                entry.name,
                *times,
                *(_error(here.mean_mm, altd.mean_mm, 4) for here, altd in pairs),
                str(failed),
            ]
        )
        largest.append([entry.name, *(_error(here.max_mm, altd.max_mm, 3) for here, altd in pairs)])
    yield from _table(["mean, mm", "fit", "point", "of many", *titles, "failed"], mean)
    yield ""
    yield from _table(["largest, mm", *titles], largest)
    yield ""
    yield from _behind(_maps_ahead(figures.maps))
    yield ""
    yield "How each was used:"
    yield ""
    yield from (f"- {entry.name}: {entry.how}." for entry in figures.maps)


def _given_the_same(spots: Sequence[SpotFigures], spot: SpotFigures) -> SpotFigures:
    """The row of altd that another one is compared with."""
    return next(other for other in spots if other.altd and other.given == spot.given)


def _compare_spots(spot: SpotFigures, altd: SpotFigures, kind: str) -> float:
    """The error relative to altd's where it is equal or smaller and nothing failed, else 0."""
    here = spot.scatter[kind]
    beside = here.mapped_px / altd.scatter[kind].mapped_px
    return beside if not here.failed and beside < 1 + EQUAL else 0.0


def _compare_maps(entry: MapFigures, first: MapFigures, key: Key) -> float:
    """The same of mean errors."""
    here = entry.cells[key]
    beside = here.mean_mm / first.cells[key].mean_mm
    return beside if not here.failed and beside < 1 + EQUAL else 0.0


def _spots_ahead(spots: Sequence[SpotFigures]) -> Iterator[str]:
    for spot in spots:
        if spot.altd:
            continue
        altd = _given_the_same(spots, spot)
        ratio = spot.median_us / altd.median_us
        beside = {kind: _compare_spots(spot, altd, kind) for kind in spot.scatter}
        if where := _where(beside, ratio < 1):
            yield f"{spot.name} (given: {spot.given}), in {_ratio(ratio)} of altd's time: {where}"


def _maps_ahead(maps: Sequence[MapFigures]) -> Iterator[str]:
    first = maps[0]
    for entry in maps[1:]:
        point, fit = entry.point_us / first.point_us, entry.fit_us / first.fit_us
        beside = {_title(key): _compare_maps(entry, first, key) for key in entry.cells}
        if where := _where(beside, point < 1 or fit < 1):
            yield f"{entry.name}, in {_ratio(fit)} of altd's time a fit and {_ratio(point)} a point: {where}"


def _where(beside: dict[str, float], faster: bool) -> str:
    """Where errors relative to altd's are smaller and, for who is faster, where they are equal."""
    smaller = [f"{name} ({value:.2f})" for name, value in beside.items() if 0 < value < 1 - EQUAL]
    equal = [f"{name} ({value:.2f})" for name, value in beside.items() if faster and value >= 1 - EQUAL]
    parts = [("smaller error: ", smaller), ("equal error: ", equal)]
    return "; ".join(title + ", ".join(names) for title, names in parts if names)


def _behind(lines: Iterator[str]) -> Iterator[str]:
    """The list of where altd is behind; it says so, too, when that is nowhere."""
    found = list(lines)
    yield "Where altd is behind, the peer's error relative to altd's in brackets:" + (
        "" if found else " nowhere."
    )
    if found:
        yield ""
    yield from (f"- {line}." for line in found)


def _title(key: Key) -> str:
    focal_mm, (columns, rows) = key
    return f"f = {focal_mm:g}, {columns} × {rows}"


def _error(value: float, altd: float, digits: int) -> str:
    return _marked(f"{value:.{digits}f}", _below(value, altd)) if math.isfinite(value) else "–"


def _below(value: float, reference: float) -> bool:
    return value < (1 - EQUAL) * reference


def _marked(text: str, ahead: bool) -> str:
    return f"**{text}**" if ahead else text


def _ratio(ratio: float) -> str:
    """Two digits: more would not come out again on another machine."""
    if not math.isfinite(ratio) or ratio <= 0:
        return "–"
    digits = max(1 - math.floor(math.log10(ratio)), 0)
    return f"{round(ratio, 1 - math.floor(math.log10(ratio))):.{digits}f} ×"


def _table(head: list[str], rows: list[list[str]]) -> Iterator[str]:
    """A Markdown table with aligned columns, the numbers to the right."""
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    yield "| " + " | ".join(text.ljust(width) for text, width in zip(head, widths, strict=True)) + " |"
    yield (
        "|" + "|".join("-" * (width + 1) + ("-" if at == 0 else ":") for at, width in enumerate(widths)) + "|"
    )
    for row in rows:
        texts = [
            text.ljust(width) if at == 0 else text.rjust(width)
            for at, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "| " + " | ".join(texts) + " |"
