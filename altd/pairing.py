"""Frames of several cameras, or what was found in them, become exposures: by sequence or by time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from altd.records import Reason

Item = TypeVar("Item")

_PATIENCE = 4
"""A frame waits for its partner until its own camera has delivered this many more."""
_RESTART = 1000
"""A sequence that falls back by more than this was started anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair(Generic[Item]):
    """What belongs to one exposure. ``missing`` says, for a camera without an item, why.

    ``skew_ns`` is the largest difference in time between the items.
    """

    sequence: int
    t_ns: int
    skew_ns: int
    items: Mapping[str, Item]
    missing: Mapping[str, Reason]


@dataclass(slots=True)
class _Waiting(Generic[Item]):
    sequence: int
    t_ns: int
    item: Item


class Pairer(Generic[Item]):
    """Pairs the items of cameras; what cannot be paired comes out too, with the reason.

    By sequence: items of one exposure carry one number, and times no further apart than ``max_skew_ns``.
    By time: items whose times are no further apart than that belong together; the number is the first
    camera's. A camera from which nothing came since is silent; one that delivers, but nothing that fits, is
    out of step.
    """

    def __init__(
        self,
        cameras: tuple[str, ...],
        by: Literal["sequence", "time"],
        max_skew_ns: int,
    ) -> None:
        self._cameras = cameras
        self._by_time = by == "time"
        self._max_skew_ns = max_skew_ns
        self._waiting: dict[str, list[_Waiting[Item]]] = {camera: [] for camera in cameras}
        self._last_t_ns: dict[str, int] = {}
        self._last_out: int | None = None
        self.late = 0
        """Items that came after their exposure was given up."""

    def add(self, camera: str, sequence: int, t_ns: int, item: Item) -> list[Pair[Item]]:
        """Take one item; returns the exposures that are now settled, oldest first."""
        self._last_t_ns[camera] = t_ns
        new = _Waiting(sequence, t_ns, item)
        if self._is_late(new):
            self.late += 1
            return []
        self._waiting[camera].append(new)
        settled: list[Pair[Item]] = []
        group = self._group_of(new)
        if len(group) == len(self._cameras):
            settled += self._give_up_before(group)
            settled.append(self._settle(group))
        elif len(self._waiting[camera]) > _PATIENCE:
            settled.append(self._settle(self._group_of(self._waiting[camera][0])))
        return settled

    def flush(self) -> list[Pair[Item]]:
        """Settle all that still waits, at the end of a recording."""
        settled = []
        while waiting := [items[0] for items in self._waiting.values() if items]:
            settled.append(self._settle(self._group_of(min(waiting, key=self._order))))
        return settled

    def _order(self, waiting: _Waiting[Item]) -> int:
        return waiting.t_ns if self._by_time else waiting.sequence

    def _is_late(self, new: _Waiting[Item]) -> bool:
        order = self._order(new)
        if self._last_out is None or order > self._last_out:
            return False
        if not self._by_time and order < self._last_out - _RESTART:
            self._last_out = None
            return False
        return True

    def _group_of(self, one: _Waiting[Item]) -> dict[str, _Waiting[Item]]:
        """What waits and belongs to the same exposure as ``one``, by camera."""
        group = {}
        for camera in self._cameras:
            for other in self._waiting[camera]:
                if self._together(one, other):
                    group[camera] = other
                    break
        return group

    def _together(self, one: _Waiting[Item], other: _Waiting[Item]) -> bool:
        if self._by_time:
            return abs(one.t_ns - other.t_ns) <= self._max_skew_ns
        return one.sequence == other.sequence

    def _give_up_before(self, group: Mapping[str, _Waiting[Item]]) -> list[Pair[Item]]:
        """Settle, incomplete as they are, the exposures older than a complete one."""
        first = min(self._order(waiting) for waiting in group.values())
        settled = []
        while older := [
            items[0] for items in self._waiting.values() if items and self._order(items[0]) < first
        ]:
            settled.append(self._settle(self._group_of(min(older, key=self._order))))
        return settled

    def _settle(self, group: Mapping[str, _Waiting[Item]]) -> Pair[Item]:
        for camera, waiting in group.items():
            self._waiting[camera].remove(waiting)
        times = [waiting.t_ns for waiting in group.values()]
        t_ns = sum(times) // len(times)
        self._last_out = max(self._order(waiting) for waiting in group.values())
        sequence = next(group[camera].sequence for camera in self._cameras if camera in group)
        skew_ns = max(times) - min(times)
        if skew_ns > self._max_skew_ns:
            return Pair(sequence, t_ns, skew_ns, {}, dict.fromkeys(self._cameras, Reason.OUT_OF_STEP))
        missing = {c: self._why_missing(c, t_ns) for c in self._cameras if c not in group}
        return Pair(sequence, t_ns, skew_ns, {c: w.item for c, w in group.items()}, missing)

    def _why_missing(self, camera: str, t_ns: int) -> Reason:
        last_ns = self._last_t_ns.get(camera)
        alive = last_ns is not None and last_ns >= t_ns - self._max_skew_ns
        return Reason.OUT_OF_STEP if alive else Reason.CAMERA_SILENT
