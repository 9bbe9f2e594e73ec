"""What every fine localiser is told of the noise, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Noise:
    """What disturbs a pixel: ``read_counts`` of the dark camera, shot noise at ``electrons_per_count``."""

    read_counts: float
    electrons_per_count: float


@dataclass(frozen=True, slots=True)
class Centre:
    """A spot's centre, px, and what read and shot noise do to it: root mean square of both axes."""

    u_px: float
    v_px: float
    sigma_px: float
