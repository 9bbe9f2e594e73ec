"""Current knowledge of a unit, and its recent course: everything expires. Times are arguments."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from altd.terminal.canvas import Place
from altd.terminal.documents import SelfCheckDocument, Shown, ShownBeam, StatusDocument, TargetsDocument

HOLD_S = 1.5
"""Time for which an answer is shown when no other follows."""
PATH_S = 10.0
"""Duration of a spot's path that is shown."""
KEPT_S = 600.0
"""Time for which each number is kept for its trend."""


@dataclass(frozen=True, slots=True)
class Moment:
    """The present knowledge. ``lost`` is the reason why there is none; empty while the daemon answers."""

    lost: str
    reading: ShownBeam | None
    age_s: float | None
    """Current age of the reading."""
    status: StatusDocument | None
    check: SelfCheckDocument | None
    targets: TargetsDocument | None

    @property
    def numbers(self) -> tuple[Shown, ...]:
        """The numbers of the reading; empty without a reading."""
        return () if self.reading is None else self.reading.numbers


class Knowledge:
    """Receives answers and discards them in time."""

    def __init__(self) -> None:
        self._lost = "no answer so far"
        self._reading: ShownBeam | None = None
        self._reading_s = self._status_s = -KEPT_S
        self._status: StatusDocument | None = None
        self._check: SelfCheckDocument | None = None
        self._targets: TargetsDocument | None = None
        self._past: deque[tuple[float, ShownBeam | None]] = deque()

    def set_reading(self, reading: ShownBeam | None, now_s: float) -> None:
        """Store the latest measurement; None: none has been made yet."""
        self._reading, self._reading_s, self._lost = reading, now_s, ""
        self._past.append((now_s, reading))
        while now_s - self._past[0][0] > KEPT_S:
            self._past.popleft()

    def set_status(self, status: StatusDocument, now_s: float) -> None:
        """Store the unit's state. The past of another unit is discarded."""
        if self._status is not None and status.serial != self._status.serial:
            self._past.clear()
        self._status, self._status_s = status, now_s

    def set_documents(self, check: SelfCheckDocument, targets: TargetsDocument) -> None:
        """Store the documents that change seldom."""
        self._check, self._targets = check, targets

    def set_lost(self, why: str) -> None:
        """Discard reading and state at once, because the daemon does not answer."""
        self._lost = why
        self._reading = None
        self._status_s = self._reading_s = -KEPT_S

    def at(self, now_s: float) -> Moment:
        """Return the knowledge at this moment."""
        silent_s = now_s - self._reading_s
        if not self._lost and silent_s > HOLD_S:
            return Moment("the daemon does not answer", None, None, None, None, self._targets)
        if self._lost:
            return Moment(self._lost, None, None, None, None, self._targets)
        reading = self._reading
        age_s = None if reading is None or reading.age_s is None else reading.age_s + silent_s
        status = self._status if now_s - self._status_s <= HOLD_S else None
        return Moment("", reading, age_s, status, self._check, self._targets)

    def path(self, target: str, now_s: float) -> list[Place]:
        """Recent positions of the target's spot, the oldest first; empty while its position is not known."""
        if (reading := self.at(now_s).reading) is None or reading.spots.get(target) is None:
            return []
        places: list[Place] = []
        for at_s, past in self._past:
            place = None if past is None else past.spots.get(target)
            if now_s - at_s <= PATH_S and place is not None:
                places.append(place)
        return places

    def trend(self, key: str, now_s: float, columns: int, step_s: float) -> Sequence[float | None]:
        """Means of a number over steps of ``step_s``, the last of them now; None: not known then."""
        last = int(now_s // step_s)
        sums: dict[int, tuple[float, int]] = {}
        for at_s, past in reversed(self._past):
            column = int(at_s // step_s) - last + columns - 1
            if column < 0:
                break
            for number in past.numbers if past is not None else ():
                if number.key == key and number.value is not None:
                    total, count = sums.get(column, (0.0, 0))
                    sums[column] = total + number.value, count + 1
        return [sums[column][0] / sums[column][1] if column in sums else None for column in range(columns)]
