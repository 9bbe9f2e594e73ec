"""A straight move of an xy table: it speeds up, runs and brakes, as a function of time."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class Move:
    """From standstill to standstill, mm in machine coordinates; ``begin`` sets it going."""

    start_mm: tuple[float, float]
    end_mm: tuple[float, float]
    speed_mm_s: float
    acceleration_mm_s2: float
    start_s: float = math.inf

    @property
    def length_mm(self) -> float:
        """The way."""
        return math.dist(self.start_mm, self.end_mm)

    @property
    def _top_mm_s(self) -> float:
        """The speed that is reached: a short way is over before the full one."""
        return min(self.speed_mm_s, math.sqrt(self.acceleration_mm_s2 * self.length_mm))

    @property
    def end_s(self) -> float:
        """When it stands again."""
        if self.length_mm == 0:
            return self.start_s
        return self.start_s + self.length_mm / self._top_mm_s + self._top_mm_s / self.acceleration_mm_s2

    def begin(self, t_s: float) -> None:
        """Start at ``t_s``."""
        self.start_s = t_s

    def gone_mm(self, t_s: float) -> float:
        """The way gone at ``t_s``."""
        if t_s <= self.start_s or self.length_mm == 0:
            return 0.0
        if t_s >= self.end_s:
            return self.length_mm
        top, a = self._top_mm_s, self.acceleration_mm_s2
        passed, left = t_s - self.start_s, self.end_s - t_s
        if passed < top / a:
            return a * passed**2 / 2
        if left < top / a:
            return self.length_mm - a * left**2 / 2
        return top * (passed - top / a / 2)

    def speed_at(self, t_s: float) -> float:
        """Speed along the way, mm/s."""
        if not self.start_s < t_s < self.end_s:
            return 0.0
        a = self.acceleration_mm_s2
        return min(self._top_mm_s, a * (t_s - self.start_s), a * (self.end_s - t_s))

    def at(self, t_s: float) -> tuple[float, float]:
        """The place at ``t_s``."""
        share = self.gone_mm(t_s) / self.length_mm if self.length_mm else 1.0
        (x0, y0), (x1, y1) = self.start_mm, self.end_mm
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0)


def braking(move: Move, t_s: float) -> Move:
    """What becomes of a move that is told to hold: the second half of one with that top speed."""
    speed, a = move.speed_at(t_s), move.acceleration_mm_s2
    here = move.at(t_s)
    way = min(speed**2 / (2 * a), move.length_mm - move.gone_mm(t_s))
    if way <= 0:
        return Move(here, here, move.speed_mm_s, a, t_s)
    unit = [(end - start) / move.length_mm for start, end in zip(move.start_mm, move.end_mm, strict=True)]
    stop = here[0] + way * unit[0], here[1] + way * unit[1]
    before = here[0] - way * unit[0], here[1] - way * unit[1]
    return Move(before, stop, math.inf, a, t_s - speed / a)
