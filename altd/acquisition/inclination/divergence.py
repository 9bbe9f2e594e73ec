"""Whether the beam's inclination against gravity changes slowly: refraction, or a laser that moved. Pure.

The beam's pitch in the unit and the unit's pitch against gravity add up to the beam's own inclination, which
stays while the machine moves. What it is nobody needs to know: it is compared with what it was.
"""

from __future__ import annotations

import math

MEAN_S = 600.0
"""The time over which the reference and the inclination of now are averaged: shorter is vibration."""
MAX_GAP_S = 600.0
"""A beam that was away for longer may be another one, of a laser that was set up again: a new reference."""
INTERVAL_S = 1.0
"""From one sample to the next; further ones between them say nothing more."""


class PitchDivergence:
    """How far the beam's inclination has moved from what it was in the first ten minutes."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._begin_ns = 0
        self._reference_deg = self._now_deg = 0.0
        self._samples = 0

    def add(self, t_ns: int, inclination_deg: float) -> None:
        """A sample of the beam's inclination against gravity."""
        since_s = math.inf if self._last_ns is None else (t_ns - self._last_ns) * 1e-9
        if since_s < INTERVAL_S:
            return
        self._last_ns = t_ns
        if since_s > MAX_GAP_S:
            self._begin_ns, self._samples = t_ns, 0
        if (t_ns - self._begin_ns) * 1e-9 < MEAN_S:
            self._samples += 1
            self._reference_deg += (inclination_deg - self._reference_deg) / self._samples
            self._now_deg = self._reference_deg
        else:
            self._now_deg += (1.0 - math.exp(-since_s / MEAN_S)) * (inclination_deg - self._now_deg)

    def divergence_deg(self, now_ns: int) -> float | None:
        """The inclination of now minus the reference; None: not known yet, or not of now."""
        if self._last_ns is None or (self._last_ns - self._begin_ns) * 1e-9 < MEAN_S:
            return None
        if (now_ns - self._last_ns) * 1e-9 > MAX_GAP_S:
            return None
        return self._now_deg - self._reference_deg
