"""Detection of a shock to the unit: the spots of all its targets jump together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from altd.measuring.spot_locator import Located
from altd.records import Spot

JUMP_MM = 2.2
"""Maximum distance from the position predicted by steady motion. Vibration of a machine at work moves no spot
farther from one frame to the next."""
TOGETHER_NS = 150_000_000
_MAX_UNEVENNESS = 3.0
"""Ratio of the longest interval between two frames to the shortest (``devices.trigger_times``)."""
_GAP_NS = 400_000_000
"""Time without a spot after which its movement is unknown."""


@dataclass(slots=True)
class _Track:
    """Scale of a camera's picture, its last two spots with their times, and the time of its last jump."""

    px_per_mm: float
    before: tuple[Spot, int] | None = None
    last: tuple[Spot, int] | None = None
    jumped_ns: int | None = None


class ShockWatch:
    """Checks every frame. A moved camera, a blow to the unit and one to the laser cannot be distinguished."""

    def __init__(self, px_per_mm: Mapping[str, float]) -> None:
        self._tracks = {camera: _Track(scale) for camera, scale in px_per_mm.items()}

    def is_shock(self, located: Located) -> bool:
        """Return whether the spots of all cameras have jumped by this frame; true once for one shock."""
        track = self._tracks[located.camera]
        if not isinstance(located.spot, Spot):
            return False
        jumped = self._jumped(track, located.spot, located.t_ns)
        track.before, track.last = track.last, (located.spot, located.t_ns)
        if not jumped:
            return False
        track.before = None
        track.jumped_ns = located.t_ns
        times_ns = [other.jumped_ns for other in self._tracks.values()]
        if any(t_ns is None or abs(located.t_ns - t_ns) > TOGETHER_NS for t_ns in times_ns):
            return False
        for other in self._tracks.values():
            other.jumped_ns = None
        return True

    @staticmethod
    def _jumped(track: _Track, spot: Spot, t_ns: int) -> bool:
        if track.before is None or track.last is None:
            return False
        (before, before_ns), (last, last_ns) = track.before, track.last
        if not 0 < last_ns - before_ns <= _GAP_NS or not 0 < t_ns - last_ns <= _GAP_NS:
            return False
        ahead = (t_ns - last_ns) / (last_ns - before_ns)
        u_px = last.u_px + ahead * (last.u_px - before.u_px)
        v_px = last.v_px + ahead * (last.v_px - before.v_px)
        longer = max(min(ahead, _MAX_UNEVENNESS), 1.0)  # of vibration, extrapolation makes 1 + ahead times
        jump_mm = math.hypot(spot.u_px - u_px, spot.v_px - v_px) / track.px_per_mm
        return jump_mm > JUMP_MM * (1.0 + longer) / 2.0
