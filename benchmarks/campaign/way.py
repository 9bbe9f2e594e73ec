"""A way to disturb measurements: its effect on light, on grey values and on the stream of frames."""

import inspect
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from altd.records import PixelArray
from benchmarks.campaign.detectability import Undetectable, always_detectable
from benchmarks.campaign.scene import Scene

CAMERAS = ("front", "rear")
MS, S = 1_000_000, 1_000_000_000
PERIOD_NS, START_NS = 50 * MS, 1_000 * S
"""Time between two exposures, and time of the first one."""


@dataclass(slots=True)
class Shot:
    """One frame on its way to the chain; ``k`` counts the episode's exposures."""

    camera: str
    k: int
    sequence: int
    t_ns: int
    pixels: PixelArray
    bits: int


OnLight = Callable[[Scene, int], Scene]
"""Changes the light of the frame set that is this number after the onset."""
OnPixels = Callable[[PixelArray, PixelArray | None, int], PixelArray]
"""Changes grey values of some bits; the second frame is the camera's previous one, None for the first."""
OnStream = Callable[[list[Shot], int], list[Shot]]
"""Changes the frames of an episode, in order, from frame set ``onset`` on."""


@dataclass(frozen=True, slots=True)
class Spoil:
    """One way with its parameters drawn; None for what it does not change.

    ``cameras`` are the cameras whose light and pixels are disturbed. ``varies``: its light differs at each
    exposure. ``no_beam``: no laser is left to measure, so any value is wrong. ``undetectable`` gives the
    reason why it cannot be detected on a unit, if so.
    """

    note: str
    light: OnLight | None = None
    pixels: OnPixels | None = None
    stream: OnStream | None = None
    cameras: frozenset[str] = frozenset(CAMERAS)
    varies: bool = False
    no_beam: bool = False
    undetectable: Undetectable = always_detectable


class Draw:
    """Draws the parameters of one episode, from its own random numbers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def uniform(self, low: float, high: float) -> float:
        """Draw a number uniformly between two limits."""
        return float(self.rng.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """Draw a number uniformly in its logarithm: as many small ones as large ones."""
        return math.exp(self.uniform(math.log(low), math.log(high)))

    def whole(self, low: int, high: int) -> int:
        """Draw an integer, both ends included."""
        return int(self.rng.integers(low, high + 1))

    def angle(self) -> float:
        """Draw a direction, radians."""
        return self.uniform(-math.pi, math.pi)

    def of(self, *choices: str) -> str:
        """Draw one of several choices."""
        return choices[int(self.rng.integers(len(choices)))]

    def sign(self) -> int:
        """Draw -1 or 1."""
        return 1 if self.rng.random() < 0.5 else -1

    def targets(self) -> frozenset[str]:
        """Draw front, rear or both."""
        return frozenset(CAMERAS if self.rng.random() < 1 / 3 else (self.of(*CAMERAS),))

    def both(self) -> frozenset[str]:
        """Front and rear, without drawing."""
        return frozenset(CAMERAS)

    def one(self) -> frozenset[str]:
        """Draw front or rear."""
        return frozenset((self.of(*CAMERAS),))

    def seed(self) -> int:
        """Draw a seed for random numbers that must be the same at each frame set."""
        return int(self.rng.integers(1 << 31))


Parameter = Callable[[Draw], Any]
"""Draws a parameter of a way, such as ``Draw.angle``."""


def uniform(low: float, high: float) -> Parameter:
    """Parameter drawn uniformly between two limits."""
    return lambda draw: draw.uniform(low, high)


def log(low: float, high: float) -> Parameter:
    """Parameter drawn uniformly in its logarithm."""
    return lambda draw: draw.log(low, high)


def whole(low: int, high: int) -> Parameter:
    """Parameter that is an integer, both ends included."""
    return lambda draw: draw.whole(low, high)


def of(*choices: str) -> Parameter:
    """Parameter that is one of several choices."""
    return lambda draw: draw.of(*choices)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A change whose last arguments are drawn once for each episode."""

    change: Callable[..., Any]
    parameters: tuple[Parameter, ...]

    def values(self, draw: Draw) -> dict[str, Any]:
        """Draw the arguments by their names."""
        parameters = list(inspect.signature(self.change).parameters)
        names = parameters[len(parameters) - len(self.parameters) :]
        return {name: of(draw) for name, of in zip(names, self.parameters, strict=True)}


def drawn(*parameters: Parameter) -> Callable[[Callable[..., Any]], Drawn]:
    """Return a decorator of a change that draws its last arguments in this order."""
    return lambda change: Drawn(change, parameters)


@dataclass(frozen=True, slots=True)
class Way:
    """A named way. ``moving``: only a moving beam reveals it. ``invisible``: why physics hides it, size."""

    name: str
    kind: str
    summary: str
    make: Callable[[Draw], object]
    """Draws the parameters: a ``Spoil``, or the types of the modules ``times`` and ``numbers``."""
    moving: bool = False
    invisible: str = ""


@dataclass(slots=True)
class Registry:
    """Ways of one kind, in the order of their definition."""

    kind: str
    ways: list[Way] = field(default_factory=list)

    def row(
        self,
        name: str,
        summary: str,
        make: Callable[[Draw], object],
        *,
        moving: bool = False,
        invisible: str = "",
    ) -> None:
        """Register a way that is a case of another function."""
        self.ways.append(Way(name, self.kind, summary, make, moving, invisible))

    def on_light(
        self, note: str, cameras: Callable[[Draw], frozenset[str]] = Draw.targets, *, varies: bool = False
    ) -> Callable[[Drawn], Drawn]:
        """Return a decorator that registers a change of a scene by its name and docstring.

        ``note`` is formatted with the parameters. With ``varies`` the change gets ``since`` after the scene.
        """

        def enter(way: Drawn) -> Drawn:
            def make(draw: Draw) -> Spoil:
                values = way.values(draw)

                def light(scene: Scene, since: int) -> Scene:
                    changed: Scene = way.change(scene, *([since] if varies else []), **values)
                    return changed

                return Spoil(note.format(**values), light=light, cameras=cameras(draw), varies=varies)

            return self._registered(way, make)

        return enter

    def on_pixels(self, note: str) -> Callable[[Drawn], Drawn]:
        """Return a decorator that registers a change of a frame's own grey values with some bits."""

        def enter(way: Drawn) -> Drawn:
            def make(draw: Draw) -> Spoil:
                values = way.values(draw)

                def pixels(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
                    return grey(way.change(pixels.copy(), bits, **values), pixels)

                return Spoil(note.format(**values), pixels=pixels, cameras=draw.targets())

            return self._registered(way, make)

        return enter

    def _registered(self, way: Drawn, make: Callable[[Draw], Spoil]) -> Drawn:
        self.row(way.change.__name__, summary_of(way.change), make)
        return way

    def add(
        self, *, moving: bool = False, invisible: str = ""
    ) -> Callable[[Callable[[Draw], Spoil]], Callable[[Draw], Spoil]]:
        """Return a decorator that registers a function under its own name and docstring."""

        def enter(make: Callable[[Draw], Spoil]) -> Callable[[Draw], Spoil]:
            self.row(make.__name__, summary_of(make), make, moving=moving, invisible=invisible)
            return make

        return enter


def summary_of(function: Callable[..., object]) -> str:
    """First line of a docstring."""
    return (function.__doc__ or "").strip().splitlines()[0]


def names_of(cameras: Iterable[str]) -> str:
    """Cameras of a note."""
    return " and ".join(sorted(cameras))


def both(first: Spoil, second: Spoil) -> Spoil:
    """Combine two ways, the first one's light first; each on its own cameras."""
    parts = (first, second)

    def light(scene: Scene, since: int) -> Scene:
        for part in parts:
            if part.light is not None and scene.camera in part.cameras:
                scene = part.light(scene, since)
        return scene

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        for part in parts:
            spoil_pixels(part, shots, onset)
            if part.stream is not None:
                shots = part.stream(shots, onset)
        return shots

    return Spoil(
        note="; ".join(part.note for part in parts),
        light=light,
        stream=stream,
        varies=first.varies or second.varies,
        no_beam=first.no_beam or second.no_beam,
        undetectable=lambda subject: first.undetectable(subject) or second.undetectable(subject),
    )


def spoil_pixels(spoil: Spoil, shots: Sequence[Shot], onset: int) -> None:
    """Change the grey values of the shots from ``onset`` on, each with its camera's previous frame."""
    if spoil.pixels is None:
        return
    before: dict[str, PixelArray] = {}
    for shot in shots:
        clean = shot.pixels
        if shot.k >= onset and shot.camera in spoil.cameras:
            shot.pixels = spoil.pixels(clean, before.get(shot.camera), shot.bits)
        before[shot.camera] = clean


def showing(shots: Sequence[Shot], onset: int, source: Callable[[Shot], tuple[str, int]]) -> list[Shot]:
    """Replace pictures from ``onset`` on by those at the camera and exposure of ``source``, if they exist."""
    pictures = {(shot.camera, shot.k): shot.pixels for shot in shots}
    return [
        replace(shot, pixels=pictures.get(source(shot), shot.pixels)) if shot.k >= onset else shot
        for shot in shots
    ]


def grey(picture: npt.ArrayLike, like: PixelArray) -> PixelArray:
    """Convert to integer grey values of the same depth as another frame."""
    if like.dtype == np.uint8:
        return np.ascontiguousarray(picture, np.uint8)
    return np.ascontiguousarray(picture, np.uint16)
