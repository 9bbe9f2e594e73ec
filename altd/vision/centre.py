"""The input of every fine localiser on noise, and its result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of a pixel: ``read_counts`` of the dark camera, shot noise at ``electrons_per_count``."""

    read_counts: float
    electrons_per_count: float


@dataclass(frozen=True, slots=True)
class Centre:
    """A spot's centre and its sigma by read and shot noise, root mean square of both axes, px."""

    u_px: float
    v_px: float
    sigma_px: float
