"""Straight moves of an xy table, one after another; each accelerates, runs and brakes."""

import math
from collections import deque
from dataclasses import dataclass, field

Xy = tuple[float, float]


@dataclass(slots=True)
class Move:
    """Move from standstill to standstill, mm in machine coordinates; ``begin`` starts it."""

    start_mm: Xy
    end_mm: Xy
    speed_mm_s: float
    acceleration_mm_s2: float
    start_s: float = math.inf

    @property
    def length_mm(self) -> float:
        """Length of the path."""
        return math.dist(self.start_mm, self.end_mm)

    @property
    def _peak_speed_mm_s(self) -> float:
        """Maximum speed of the move; a short path ends before full speed is reached."""
        return min(self.speed_mm_s, math.sqrt(self.acceleration_mm_s2 * self.length_mm))

    @property
    def end_s(self) -> float:
        """Time at which the table is at rest again."""
        if self.length_mm == 0:
            return self.start_s
        return (
            self.start_s
            + self.length_mm / self._peak_speed_mm_s
            + self._peak_speed_mm_s / self.acceleration_mm_s2
        )

    def begin(self, t_s: float) -> None:
        """Start the move at ``t_s``."""
        self.start_s = t_s

    def travelled_mm(self, t_s: float) -> float:
        """Distance travelled at ``t_s``."""
        if t_s <= self.start_s or self.length_mm == 0:
            return 0.0
        if t_s >= self.end_s:
            return self.length_mm
        top, a = self._peak_speed_mm_s, self.acceleration_mm_s2
        passed, left = t_s - self.start_s, self.end_s - t_s
        if passed < top / a:
            return a * passed**2 / 2
        if left < top / a:
            return self.length_mm - a * left**2 / 2
        return top * (passed - top / a / 2)

    def speed_at(self, t_s: float) -> float:
        """Speed along the path, mm/s."""
        if not self.start_s < t_s < self.end_s:
            return 0.0
        a = self.acceleration_mm_s2
        return min(self._peak_speed_mm_s, a * (t_s - self.start_s), a * (self.end_s - t_s))

    def at(self, t_s: float) -> Xy:
        """Position at ``t_s``."""
        share = self.travelled_mm(t_s) / self.length_mm if self.length_mm else 1.0
        (x0, y0), (x1, y1) = self.start_mm, self.end_mm
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0)


def braking(move: Move, t_s: float) -> Move:
    """Motion after a hold: the second half of a move whose top speed is the current speed."""
    speed, a = move.speed_at(t_s), move.acceleration_mm_s2
    here = move.at(t_s)
    way = min(speed**2 / (2 * a), move.length_mm - move.travelled_mm(t_s))
    if way <= 0:
        return Move(here, here, move.speed_mm_s, a, t_s)
    unit = [(end - start) / move.length_mm for start, end in zip(move.start_mm, move.end_mm, strict=True)]
    stop = here[0] + way * unit[0], here[1] + way * unit[1]
    before = here[0] - way * unit[0], here[1] - way * unit[1]
    return Move(before, stop, math.inf, a, t_s - speed / a)


@dataclass(slots=True)
class Planner:
    """Planned moves, and the position of the table between them, mm in machine coordinates."""

    place_mm: Xy
    moves: deque[Move] = field(default_factory=deque)
    held: Move | None = None
    """Braking move of a hold; None without a hold."""

    @property
    def target_mm(self) -> Xy:
        """End of the last move."""
        return self.moves[-1].end_mm if self.moves else self.place_mm

    def at(self, t_s: float) -> Xy:
        """Position at ``t_s``."""
        if self.held is not None:
            return self.held.at(t_s)
        return self.moves[0].at(t_s) if self.moves else self.place_mm

    def moving(self, t_s: float) -> bool:
        """Whether the table moves, including braking."""
        return t_s < self.held.end_s if self.held is not None else bool(self.moves)

    def started(self, t_s: float) -> bool:
        """Whether the first move has started."""
        return bool(self.moves) and t_s >= self.moves[0].start_s

    def add(self, move: Move, t_s: float) -> None:
        """Plan a move; it begins at once if no other is planned."""
        if not self.moves:
            move.begin(t_s)
        self.moves.append(move)

    def advance(self, t_s: float) -> None:
        """Remove finished moves."""
        while self.moves and self.held is None and t_s >= self.moves[0].end_s:
            done = self.moves.popleft()
            self.place_mm = done.end_mm
            if self.moves:
                self.moves[0].begin(done.end_s)

    def hold(self, t_s: float) -> None:
        """Start braking."""
        if self.moves:
            self.held = braking(self.moves[0], t_s)

    def resume(self, t_s: float) -> None:
        """Continue the move that the hold interrupted."""
        if self.held is not None:
            rest = self.moves[0]
            self.moves[0] = Move(self.held.end_mm, rest.end_mm, rest.speed_mm_s, rest.acceleration_mm_s2)
            self.moves[0].begin(t_s)
            self.held = None

    def stop_dead(self, t_s: float) -> None:
        """Stop without braking, and discard planned moves."""
        self.place_mm = self.at(t_s)
        self.moves.clear()
        self.held = None
