"""The pattern of a target, learnt from the laser's spots at known and at estimated places."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from matplotlib.figure import Figure

from altd.calibration.service_flat import FAR, without_surroundings
from altd.records import FloatArray, Frame, Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from altd.vision.settings import SpotSettings
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result, Row

TITLE = "The pattern of a target from the laser's spots"
QUESTION = "Can the spots of a scan, or of ordinary service, replace a flat?"

SEED = 71
HEIGHT, WIDTH, PX_PER_MM, PARTS = 272, 336, 3.7, 3
HALF_AREA_MM = (30.0, 22.0)
RADIUS_MM, ORDER, PEAK_COUNTS = 6.0, 1.3, 175.0
AMBIENT_COUNTS = 5.3, 0.03, 0.015
"""Light around the spots in the middle, and by mm along x and y."""
GRAIN, GRAIN_MM = 0.12, 0.35
PITCH_MM, DOT_MM = 1.0, 0.5
ELECTRONS_PER_COUNT, READ_COUNTS = 10_000.0 / 255, 0.64
SURFACES = "plate", "print"
SPOTS, BEAMS, EXPOSURES = 240, 60, 20
NODES = 6, 5
FILM_REACH_MM = 8.0
"""Distance along x and y from the middle of the film within which beams are judged."""

_READ_SHARE = 0.1
"""Share of the spot's peak that has the weight of read noise, as in ``altd.calibration.laser_flat``."""
_KNOWN_LIGHT = 0.01
"""Light, in exposures at the spot's peak, from which a pixel is known better than assumed: its photon noise
against the contrast of grain."""
_MIN_SHARE = 0.02
"""Share of the spot's peak from which a pixel counts."""

Power = Literal["constant", "estimated"]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Response of a target, (HEIGHT, WIDTH), and the one that is assumed without a flat; None: even."""

    response: FloatArray
    assumed: Flat | None


@dataclass(frozen=True, slots=True)
class Case:
    """One way of learning.

    ``spots`` pictures are learnt from, and other beams judged after each number of ``passes``; 0 is without a
    flat. With ``step_mm`` the spots are on a grid of known places. ``power_rms`` is the scatter of the
    laser's power, ``power`` how it is taken. ``speckle`` is the contrast of a speckle that differs from
    picture to picture. With ``film`` a film of 10 mm takes a tenth of the light in the middle, from half of
    the spots on. The light around a spot is subtracted as a plane of means, or as the ``median`` of counts.
    """

    name: str
    passes: tuple[int, ...]
    spots: int = SPOTS
    step_mm: float | None = None
    power_rms: float = 0.0
    power: Power = "constant"
    speckle: float = 0.0
    film: bool = False
    median: bool = False


CONSTANT = Case("estimated places", (0, 1, 2, 4))
ESTIMATED = Case("power scatters by 1 % and is estimated", (1, 3, 8), power_rms=0.01, power="estimated")
KNOWN = Case("known places, 6 mm apart", (1,), step_mm=6.0)
CASES = (
    CONSTANT,
    Case("a quarter of the spots", (2,), spots=SPOTS // 4),
    Case("power scatters by 1 %", (2,), power_rms=0.01),
    ESTIMATED,
    KNOWN,
    Case("known places, 28 mm apart", (1,), step_mm=28.0),
    Case("median of whole counts subtracted", (1, 2, 4), median=True),
    Case("moving speckle", (0, 2), speckle=0.05),
    Case("film from half of the spots on", (0, 2), film=True),
)


def grain(rng: np.random.Generator, contrast: float) -> FloatArray:
    """Grains of a surface in parts of a pixel, mean 1."""
    white = rng.normal(size=(HEIGHT * PARTS, WIDTH * PARTS))
    noise = np.asarray(cv2.GaussianBlur(white, (0, 0), 0.4 * GRAIN_MM * PX_PER_MM * PARTS), np.float64)
    return np.asarray(np.maximum(1 + contrast * noise / noise.std(), 0))


def dots(rng: np.random.Generator | None) -> FloatArray:
    """A hexagonal print in parts of a pixel: its dots are off their places and sizes, without ``rng`` not."""
    v, u = np.mgrid[: HEIGHT * PARTS, : WIDTH * PARTS] / (PX_PER_MM * PARTS)
    row_mm = PITCH_MM * np.sqrt(3) / 2
    row = np.rint(v / row_mm).astype(int)
    odd = 0.5 * (row % 2)
    column = np.rint(u / PITCH_MM - odd).astype(int)
    off_u, off_v, more = np.zeros((3, int(row.max()) + 1, int(column.max()) + 1))
    if rng is not None:
        off_u, off_v = rng.normal(0, 0.015 * PITCH_MM, (2, *more.shape))
        more = rng.normal(0, 0.02 * DOT_MM, more.shape)
    radius = DOT_MM / 2 + more[row, column]
    away = np.hypot(u - (column + odd) * PITCH_MM - off_u[row, column], v - row * row_mm - off_v[row, column])
    return np.asarray(0.04 + 0.85 / (1 + np.exp(-np.clip((radius - away) / 0.04, -40, 40))))


def seen(parts: FloatArray) -> FloatArray:
    """A surface as the pixels see it, through a lens that blurs by 0.6 px."""
    pixels = parts.reshape(HEIGHT, PARTS, WIDTH, PARTS).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(pixels, (0, 0), 0.6))


def surface(name: str) -> Surface:
    """The plate, grainy alone, or the grainy window with its print, whose lattice is assumed."""
    rng = np.random.default_rng([SEED, name == "print"])
    parts = grain(rng, GRAIN)
    if name == "plate":
        return Surface(seen(parts), None)
    assumed = Flat.from_response(seen(dots(None)), "print")
    response = seen(parts * dots(rng))
    return Surface(response / response.max(), assumed)


def irradiance(at_px: FloatArray, form: Sequence[float], order: float) -> FloatArray:
    """A super-Gaussian spot at (2,) px, peak 1; ``form`` holds a, b, c in 1/px² as in ``Profile``."""
    a, b, c = form
    du, dv = np.arange(WIDTH) - at_px[0], (np.arange(HEIGHT) - at_px[1])[:, None]
    q = 0.5 * (a * du * du + 2 * b * du * dv + c * dv * dv)
    return np.asarray(np.exp(-(q**order)))


CURVATURE = 2 * 2 ** (1 / ORDER) / (RADIUS_MM * PX_PER_MM) ** 2
"""exp(−2 (r/R)^2n) is exp(−q^n) with q = ½ a r² and a = 2 · 2^(1/n) / R²."""


def film() -> FloatArray:
    """Light that a film of 10 mm leaves, in the middle."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot(u - (WIDTH - 1) / 2, v - (HEIGHT - 1) / 2) / PX_PER_MM
    return np.asarray(1 - 0.1 / (1 + np.exp((away - 5.0) / 0.75)))


def picture(
    of: Surface, at_px: FloatArray, case: Case, number: int, rng: np.random.Generator, exposures: int = 1
) -> Frame:
    """The mean of some exposures of a spot, 8 bits."""
    light = PEAK_COUNTS * irradiance(at_px, (CURVATURE, 0.0, CURVATURE), ORDER) * of.response
    light *= 1 + case.power_rms * rng.normal()
    if case.speckle:
        noise = cv2.GaussianBlur(rng.normal(size=light.shape), (0, 0), 1.0)
        light *= 1 + case.speckle * noise / noise.std()
    if case.film and 2 * number >= case.spots:
        light *= film()
    middle, by_x, by_y = AMBIENT_COUNTS
    x, y = np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT)[:, None] - (HEIGHT - 1) / 2
    light += middle + (by_x * x + by_y * y) / PX_PER_MM
    electrons = rng.poisson(light * ELECTRONS_PER_COUNT * exposures)
    read = rng.normal(0, READ_COUNTS / np.sqrt(exposures), light.shape)
    counts = electrons / (ELECTRONS_PER_COUNT * exposures) + read
    return Frame("front", number, number, np.clip(np.rint(counts), 0, 255).astype(np.uint8))


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Places (n, 2) px of the spots that were found, their numbers, median form and order."""

    places_px: FloatArray
    numbers: list[int]
    form: tuple[float, float, float]
    order: float


def located(frames: Sequence[Frame], flat: Flat | None) -> Located:
    """Locate the spots of pictures."""
    spots = [locate(frame, SpotSettings(method="profile"), flat) for frame in frames]
    good = {number: spot for number, spot in enumerate(spots) if isinstance(spot, Spot)}
    shapes = np.array([(s.shape.a, s.shape.b, s.shape.c, s.shape.order) for s in good.values() if s.shape])
    a, b, c, order = np.median(shapes, axis=0).tolist()
    places = np.array([(spot.u_px, spot.v_px) for spot in good.values()])
    return Located(places, list(good), (a, b, c), order)


def learnt(
    frames: Sequence[Frame],
    of: Located,
    places_px: FloatArray,
    flats: tuple[Flat | None, Flat | None],
    case: Case,
) -> Flat:
    """Weighted mean of the pictures over the model of the spots at ``places_px``.

    ``flats`` are the assumed one, taken where the spots give hardly any light, and the one by which the spots
    were located, by which the power of each is estimated.
    """
    even, present = (
        np.ones((HEIGHT, WIDTH)) if flat is None else flat.response.astype(np.float64) for flat in flats
    )
    light, weight = np.zeros((2, HEIGHT, WIDTH))
    for number, at_px in zip(of.numbers, places_px, strict=True):
        pixels = frames[number].pixels
        expected = irradiance(at_px, of.form, of.order)
        excess = without_surroundings(pixels.astype(np.float32), expected < FAR)
        if case.median or excess is None:
            excess = pixels - np.float32(np.median(pixels))
        weights = np.where(expected > _MIN_SHARE, 1 / (expected + _READ_SHARE), 0)
        if case.power == "estimated":
            model = expected * present
            expected *= float((weights * model * excess).sum() / (weights * model * model).sum())
            expected /= PEAK_COUNTS
        light += weights * expected * excess
        weight += weights * expected * expected
    level = float((light * even).sum() / (weight * even * even).sum())
    return Flat.from_response((light + _KNOWN_LIGHT * level * even) / (weight + _KNOWN_LIGHT), "laser")


def to_px(places_mm: FloatArray) -> FloatArray:
    """Pixels of places (n, 2) mm from the middle of the picture."""
    return places_mm * PX_PER_MM + (np.array([WIDTH, HEIGHT]) - 1) / 2


def quadratic(places_px: FloatArray) -> FloatArray:
    """Terms (n, 6) of a quadratic map."""
    x, y = places_px.T / WIDTH
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def grid(step_mm: float) -> FloatArray:
    """Places (n, 2) mm of a stage, which reach beyond the spots by less than a step."""
    x, y = (np.arange(-reach, reach + step_mm, step_mm) for reach in HALF_AREA_MM)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


class Target:
    """A surface, and the scan of a stage whose quadratic map takes up the smooth part of all errors."""

    def __init__(self, name: str, case: Case) -> None:
        self.surface = surface(name)
        self._case = replace(case, film=False)
        self._rng = np.random.default_rng([SEED, 2, name == "print"])
        nodes = [np.linspace(-reach, reach, count) for reach, count in zip(HALF_AREA_MM, NODES, strict=True)]
        self._nodes_px = to_px(np.stack(np.meshgrid(*nodes), axis=-1).reshape(-1, 2))
        self._scan = self.pictures(self._nodes_px, self._case, 0, EXPOSURES)

    def pictures(self, places_px: FloatArray, case: Case, first: int, exposures: int = 1) -> list[Frame]:
        """Pictures of spots at places (n, 2)."""
        return [
            picture(self.surface, at_px, case, first + number, self._rng, exposures)
            for number, at_px in enumerate(places_px)
        ]

    def measured(self, frames: Sequence[Frame], flat: Flat | None) -> tuple[Located, FloatArray]:
        """Spots of pictures, and their places (n, 2) by the map of the scan through the same flat."""
        nodes, spots = located(self._scan, flat), located(frames, flat)
        off = nodes.places_px - self._nodes_px[nodes.numbers]
        terms = np.linalg.lstsq(quadratic(nodes.places_px), off, rcond=None)[0]
        return spots, spots.places_px - quadratic(spots.places_px) @ terms


def errors_mm(name: str, case: Case) -> dict[int, FloatArray]:
    """Errors (n, 2) of beams that nothing was learnt from, by the number of passes before."""
    target = Target(name, case)
    places_mm = grid(case.step_mm) if case.step_mm is not None else _places_mm(3, case.spots, HALF_AREA_MM)
    places_px = to_px(places_mm)
    frames = target.pictures(places_px, case, 0) if max(case.passes) else []
    beams_px = to_px(_places_mm(4, BEAMS, (FILM_REACH_MM, FILM_REACH_MM) if case.film else HALF_AREA_MM))
    beams = target.pictures(beams_px, case, case.spots, EXPOSURES)
    flat, errors = target.surface.assumed, {}
    for number in range(max(case.passes) + 1):
        if number:
            spots, estimated_px = target.measured(frames, flat)
            at_px = estimated_px if case.step_mm is None else places_px[spots.numbers]
            flat = learnt(frames, spots, at_px, (target.surface.assumed, flat), case)
        if number in case.passes:
            seen_spots, measured_px = target.measured(beams, flat)
            errors[number] = (measured_px - beams_px[seen_spots.numbers]) / PX_PER_MM
    return errors


def _places_mm(stream: int, count: int, half_area_mm: tuple[float, float]) -> FloatArray:
    return np.random.default_rng([SEED, stream]).uniform(-1, 1, (count, 2)) * half_area_mm


def left(wave: FloatArray, passes: int, power: Power) -> FloatArray:
    """Share of a wave of texture that is not learnt after some passes; ``wave`` is 2π s over its length.

    A Gaussian spot of intensity sigma s is displaced by a wave, and, where the power is estimated, weighted
    by it. What it takes of the wave with it is missing in the mean over the spots.
    """
    square = np.square(wave)
    taken = np.exp(-square) * (square + (power == "estimated"))
    return np.asarray(taken**passes)


def run(progress: Progress) -> Result:
    """Two surfaces, all cases."""
    found: dict[str, dict[str, dict[int, FloatArray]]] = {}
    for name in SURFACES:
        for case in CASES:
            progress(f"learnt-pattern: {name}, {case.name}")
            found.setdefault(case.name, {})[name] = errors_mm(name, case)
    rows = [
        Row(
            f"{case.name}: {_passes(number)}",
            tuple(
                figure(found[case.name][name][number])
                for name in SURFACES
                for figure in (_rms, lambda errors: float(np.abs(errors).max()))
            ),
        )
        for case in CASES
        for number in case.passes
    ]
    rms = {
        (case.name, number): [_rms(found[case.name][name][number]) for name in SURFACES]
        for case in CASES
        for number in case.passes
    }
    none, twice, known = rms[CONSTANT.name, 0], rms[CONSTANT.name, 2], rms[KNOWN.name, 1]
    power = rms[ESTIMATED.name, 8]
    return Result(
        of="learnt from",
        thesis_source="none, it uses no flat",
        columns=tuple(
            Column(f"{name}, {what}, mm") for name in SURFACES for what in ("error rms", "largest error")
        ),
        rows=tuple(rows),
        headline=(
            f"Spots at estimated places reduce the error from {none[0]:.4f} to {twice[0]:.4f} mm on a grainy "
            f"plate and from {none[1]:.4f} to {twice[1]:.4f} mm on print, spots at known places to "
            f"{known[0]:.4f} and {known[1]:.4f} mm; if the laser's power scatters by 1 % and is estimated, "
            f"eight passes reach {power[0]:.4f} and {power[1]:.4f} mm."
        ),
        text=f"""
Drawn without the simulator: a plate with grain of contrast {GRAIN:g} and {GRAIN_MM:g} mm, and the same with
hexagonal dots of {DOT_MM:g} at {PITCH_MM:g} mm, each a little off its place, whose nominal lattice is known.
altd's localiser places {SPOTS} single exposures of a super-Gaussian spot of {2 * RADIUS_MM:g} mm, anywhere on
{2 * HALF_AREA_MM[0]:g} × {2 * HALF_AREA_MM[1]:g} mm, through the present flat. The flat is then the mean of
all pictures over the spots' common model, weighted by photon and read noise, and the next pass begins. The
map is a quadratic through {NODES[0] * NODES[1]} nodes of a scan, fitted again in each pass. Errors are those
of {BEAMS} other beams, each the mean of {EXPOSURES} exposures, by the last flat and map. *No pass* is without
a flat. Speckle of contrast 0.05 is the same in the exposures of one mean. The light around the spots is
uneven, {AMBIENT_COUNTS[0]:g} counts in the middle; a plane of means is subtracted. With the median of whole
counts instead, the rest stays in place, and each pass adds to the error.

A spot takes part of the texture with it: a wave of amplitude c and wave number k displaces a Gaussian spot of
sigma s by s² k c exp(−s²k²/2), and the mean over all spots lacks the share s²k² exp(−s²k²) of it, 0.37 at
most. Where the power of each picture is estimated it lacks (1 + s²k²) exp(−s²k²), 0.74 of the waves that
displace most, and nearly all of longer ones. Each pass leaves that share of the rest. So a constant power
needs two passes and an unknown one about eight. With an unknown one, waves much longer than the spot are not
observable: the map of the scan takes up the displacement by them.

Places 28 mm apart leave most of the area unlit, and a flat of them is no better than none. A film of 10 mm,
which takes a tenth of the light, is not recognised: the beams below it, {FILM_REACH_MM:g} mm from its middle
at most, err as without a flat. The smooth fall-off of a lens, nodes beyond the area of the spots, beams of
another size and beams at a slant are not drawn.
""",
        figure=_plot(rms),
        caption="Left: texture that is not learnt, by theory. Right: error after each number of passes",
    )


def _passes(number: int) -> str:
    return "no pass" if number == 0 else "one pass" if number == 1 else f"{number} passes"


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _plot(rms: dict[tuple[str, int], list[float]]) -> Figure:
    figure, (theory, measured) = panels(1, 2)
    wave = np.linspace(0, 3.5, 141)
    for case, colour in ((CONSTANT, OURS), (ESTIMATED, THESIS)):
        for passes, dashes in ((1, "-"), (2, "--"), (8, ":")):
            rest = left(wave, passes, case.power)
            theory.plot(wave, rest, dashes, color=colour, label=f"{case.power} power, {_passes(passes)}")
    theory.set(xlabel="2π · sigma of the spot / length of the wave", ylabel="share that is not learnt")
    theory.legend()
    for case, colour in ((CONSTANT, OURS), (ESTIMATED, THESIS)):
        for at, (name, marker) in enumerate(zip(SURFACES, "os", strict=True)):
            line = {0: rms[CONSTANT.name, 0][at]} | {n: rms[case.name, n][at] for n in case.passes}
            label = f"{case.power} power, {name}"
            measured.plot(list(line), list(line.values()), marker=marker, color=colour, label=label)
    measured.set(xlabel="passes", ylabel="error, mm rms", ylim=(0, None))
    measured.legend()
    return figure
