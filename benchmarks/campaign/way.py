"""A way to disturb measurements: its effect on light, on grey values and on the stream of frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from altd.records import PixelArray
from benchmarks.campaign.detectability import Undetectable, always_detectable
from benchmarks.campaign.scene import Scene

CAMERAS = ("front", "rear")


@dataclass(slots=True)
class Shot:
    """One frame on its way to the chain; ``k`` counts the episode's exposures."""

    camera: str
    k: int
    sequence: int
    t_ns: int
    pixels: PixelArray
    bits: int


class OnLight(Protocol):
    """Changes the light of frame set ``since`` after the onset."""

    def __call__(self, scene: Scene, since: int) -> Scene:
        """Return the disturbed scene."""


class OnPixels(Protocol):
    """Changes grey values; ``before`` is the camera's previous frame, None for the first."""

    def __call__(self, pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        """Return the disturbed frame."""


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

    def one(self) -> frozenset[str]:
        """Draw front or rear."""
        return frozenset((self.of(*CAMERAS),))

    def seed(self) -> int:
        """Draw a seed for random numbers that must be the same at each frame set."""
        return int(self.rng.integers(1 << 31))


@dataclass(frozen=True, slots=True)
class Way:
    """A named way. ``moving``: only a moving beam reveals it. ``invisible``: why physics hides it, size."""

    name: str
    kind: str
    make: Callable[[Draw], object]
    """Draws the parameters: a ``Spoil``, or the types of the modules ``times`` and ``numbers``."""
    moving: bool = False
    invisible: str = ""


@dataclass(slots=True)
class Registry:
    """Ways of one kind, in the order of their definition."""

    kind: str
    ways: list[Way] = field(default_factory=list)

    def add(
        self, *, moving: bool = False, invisible: str = ""
    ) -> Callable[[Callable[[Draw], Spoil]], Callable[[Draw], Spoil]]:
        """Return a decorator that registers a function under its own name."""

        def enter(make: Callable[[Draw], Spoil]) -> Callable[[Draw], Spoil]:
            self.ways.append(Way(make.__name__, self.kind, make, moving, invisible))
            return make

        return enter


def both(first: Spoil, second: Spoil) -> Spoil:
    """Combine two ways, the first one's light first; each on its own cameras."""
    parts = (first, second)

    def light(scene: Scene, since: int) -> Scene:
        for part in parts:
            if part.light is not None and scene.camera in part.cameras:
                scene = part.light(scene, since)
        return scene

    return Spoil(
        note="; ".join(part.note for part in parts),
        light=light,
        stream=_streams(parts),
        pixels=None,
        varies=first.varies or second.varies,
        no_beam=first.no_beam or second.no_beam,
        undetectable=lambda subject: first.undetectable(subject) or second.undetectable(subject),
    )


def _streams(parts: Sequence[Spoil]) -> OnStream:
    """Apply grey values and streams of several ways, one after another."""

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        for part in parts:
            spoil_pixels(part, shots, onset)
            if part.stream is not None:
                shots = part.stream(shots, onset)
        return shots

    return stream


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
