"""Pairing of the frames of several cameras, or of their results, to frame sets: by sequence or by time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Generic, Literal, TypeVar

from altd.measuring.regular_times import RESTART_GAP_NS, RegularTimes, Stamp
from altd.reasons import Reason
from altd.statistics import MAD_TO_SIGMA

Item = TypeVar("Item")
Made = TypeVar("Made")

_PARTNER_TIMEOUT_FRAMES = 4
"""Number of further frames of its own camera for which a frame waits for its partner. If more frames of a
camera than that are late in a row, they are right and an earlier frame was wrong."""
_MAX_HELD_FRAMES = 64
"""Maximum number of frames of one camera that wait for a partner while they arrive faster than exposed."""
_MAX_LATE_ITEMS = 8
"""Late frames of two cameras in a row. Numbers that never settle a frame set must not fill the memory: the
oldest beyond this number are dropped."""
_MAX_COMPARED_FRAMES = 8
"""Number of a camera's frames whose times are compared: a frame may be delivered after its successors."""
_MAX_LAG_SAMPLES = 15
_MIN_DEVIATIONS, _MAX_DEVIATIONS = 7, 63
"""Number of deviations from the lag from which their scatter is known, and of those that are kept."""
_MAX_LAG_PERIODS = 0.55
"""Slightly more than half, so that a lag of half a period does not change sides with every jitter."""
_MIN_SIGMAS = 6.0
"""Distance between the frames of two periods, less the largest skew, in standard deviations of the lag."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair(Generic[Item]):
    """Items of one frame set; ``missing`` gives the reason for each camera without an item.

    ``t_ns`` is the mean of the items' times. ``skew_ns`` is the largest difference between them, without the
    steady lag of one camera behind another if pairing is by time. ``behind_ns`` is the delay of each item
    from ``t_ns``. ``unpaired`` holds first the items that were too late for an earlier frame set, then those
    of unsynchronised cameras. They are not measured, but show the cameras' view and reveal repeated pictures.
    """

    sequence: int
    t_ns: int
    skew_ns: int
    items: Mapping[str, Item]
    missing: Mapping[str, Reason]
    behind_ns: Mapping[str, int]
    unpaired: tuple[Item, ...] = ()

    @property
    def all_items(self) -> tuple[Item, ...]:
        """All items of the cameras, paired or not, in order within each camera; at least one."""
        return (*self.unpaired, *self.items.values())

    def converted(self, make: Callable[[Item], Made]) -> Pair[Made]:
        """Return the same frame set with ``make`` applied to each item, in the order of ``all_items``."""
        unpaired = tuple(make(item) for item in self.unpaired)
        items = {camera: make(item) for camera, item in self.items.items()}
        return Pair(self.sequence, self.t_ns, self.skew_ns, items, self.missing, self.behind_ns, unpaired)


@dataclass(slots=True)
class _Waiting(Generic[Item]):
    camera: str
    sequence: int
    t_ns: int
    aligned_ns: int
    """Time less the camera's lag; of free-running cameras the time by its line (``RegularTimes``)."""
    off_ns: int
    """Time less that by the line."""
    stamp: Stamp
    arrived_ns: int
    delivery: int
    """Number of frames that its camera had delivered, including this one."""
    item: Item


class Lags:
    """Delay of each camera's frames behind the first camera's, estimated from their times.

    Free-running cameras keep a lag of up to half a period either way, which drifts as their crystals differ.
    A frame is compared with the nearest of the first camera's frames after subtracting the known lag; the
    median over the last ones is the lag. One well beyond half a period is a period too large. If the times
    scatter so that the nearest frame may be of another period, no frames belong together.
    """

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self._reference, *others = cameras
        self._reference_ns: deque[int] = deque(maxlen=_MAX_COMPARED_FRAMES)
        self._pending_ns: dict[str, deque[int]] = {
            camera: deque(maxlen=_MAX_COMPARED_FRAMES) for camera in others
        }
        self._samples_ns: dict[str, deque[int]] = {
            camera: deque(maxlen=_MAX_LAG_SAMPLES) for camera in others
        }
        self._deviations_ns: dict[str, deque[int]] = {
            camera: deque(maxlen=_MAX_DEVIATIONS) for camera in others
        }
        self.ns = dict.fromkeys(cameras, 0)
        """Lag of each camera; 0 for the first, and for one whose lag is not known yet."""
        self.unambiguous_ns = dict.fromkeys(cameras, math.inf)
        """Distance from the lag below which a frame is not of another period, by the last scatter."""

    def add(self, camera: str, t_ns: int) -> None:
        """Update the lags with the time of one frame."""
        times_ns = self._reference_ns if camera == self._reference else self._pending_ns[camera]
        if times_ns and t_ns - times_ns[-1] > RESTART_GAP_NS:
            self._reset(camera)
        times_ns.append(t_ns)
        period_ns = self._period_ns()
        if period_ns is not None:
            for other in self._pending_ns if camera == self._reference else (camera,):
                self._estimate(other, period_ns)

    def _reset(self, camera: str) -> None:
        """Discard the lag after a gap: the camera may have been restarted."""
        if camera == self._reference:
            self._reference_ns.clear()
        for other in self._pending_ns if camera == self._reference else (camera,):
            self._pending_ns[other].clear()
            self._samples_ns[other].clear()
            self.ns[other] = 0

    def _period_ns(self) -> float | None:
        reference_ns = self._reference_ns
        if len(reference_ns) < 2:
            return None
        return median(reference_ns[n] - reference_ns[n - 1] for n in range(1, len(reference_ns)))

    def _estimate(self, camera: str, period_ns: float) -> None:
        """Compare the frames around which the first camera's frames are complete."""
        pending_ns, samples_ns = self._pending_ns[camera], self._samples_ns[camera]
        while pending_ns and pending_ns[0] + period_ns / 2 <= self._reference_ns[-1]:
            t_ns = pending_ns.popleft()
            sample_ns = self._behind_nearest(t_ns, self.ns[camera])
            deviation_ns = abs(sample_ns - self.ns[camera])
            if deviation_ns > _MAX_LAG_PERIODS * period_ns:
                continue  # the first camera's frame is missing
            samples_ns.append(sample_ns)
            self._deviations_ns[camera].append(deviation_ns)
            lag_ns = round(median(samples_ns))
            if abs(lag_ns) > _MAX_LAG_PERIODS * period_ns:
                samples_ns.clear()
                samples_ns.append(lag_ns := self._behind_nearest(t_ns, 0))
            self.ns[camera] = lag_ns
            if len(self._deviations_ns[camera]) >= _MIN_DEVIATIONS:
                scatter_ns = MAD_TO_SIGMA * median(self._deviations_ns[camera])
                self.unambiguous_ns[camera] = period_ns - _MIN_SIGMAS * scatter_ns

    def _behind_nearest(self, t_ns: int, lag_ns: int) -> int:
        return t_ns - min(self._reference_ns, key=lambda first_ns: abs(t_ns - lag_ns - first_ns))


class Pairer(Generic[Item]):
    """Pairs the items of cameras; also returns items that cannot be paired, with the reason.

    By sequence: items of one frame set have the same number, and times that differ by ``max_skew_ns`` at
    most. By time: items whose regular times (``RegularTimes``), each less its camera's lag, differ by at most
    that belong together, unless a lag is larger than ``max_lag_ns``; their stamps differ by at most that too,
    or are near their lines. The numbers are those of the first camera that delivered, and only increase. A
    camera that did not deliver at that time is silent; one that delivered only items that do
    not match is unsynchronised (``out_of_step``).

    A jump of a number or a time, in either direction, disturbs its own frame set and a few after it: see
    ``_is_late`` and ``_expire``.
    """

    def __init__(
        self,
        cameras: tuple[str, ...],
        by: Literal["sequence", "time"],
        max_skew_ns: int,
        max_lag_ns: int,
    ) -> None:
        self.cameras = cameras
        self._lags = Lags(cameras) if by == "time" else None
        self._regular = {camera: RegularTimes() for camera in cameras}
        self._max_skew_ns = max_skew_ns
        self._max_lag_ns = max_lag_ns
        self._waiting: dict[str, list[_Waiting[Item]]] = {camera: [] for camera in cameras}
        self._delivers_ns: dict[str, tuple[int, int]] = {}
        """Aligned times of each camera's first and last frame without a gap between them."""
        self._last_out: int | None = None
        self._last_out_ns = 0
        self._delivered = dict.fromkeys(cameras, 0)
        self._late_in_a_row = dict.fromkeys(cameras, 0)
        self._ahead: dict[str, int] = {}
        """If pairing is by time: lead of each camera's numbers over the frame sets', as far as known."""
        self._last_number: int | None = None
        self._late: deque[Item] = deque(maxlen=_MAX_LATE_ITEMS)
        """Items that were too late since the last frame set; they are returned with the next one."""
        self.late = 0
        """Number of items that arrived after their frame set was given up."""
        self.lost_pairs = 0
        """Number of frame sets that lack a frame, are not synchronised, or are gaps in the numbers."""

    @property
    def lags_ns(self) -> Mapping[str, int]:
        """Delay of each camera's frames behind the first one's; empty if pairing is by sequence."""
        return self._lags.ns if self._lags else {}

    def add(
        self, camera: str, sequence: int, t_ns: int, item: Item, arrived_ns: int | None = None
    ) -> list[Pair[Item]]:
        """Add one item; return the frame sets that are now settled, oldest first.

        ``arrived_ns`` is the time of its arrival if that is known. Items that arrive faster than they were
        exposed were delayed: their partners are on the way, too.
        """
        regular_ns, stamp = t_ns, Stamp.ALONE
        if self._lags:
            regular_ns, stamp = self._regular[camera].add(sequence, t_ns)
            # The lag of a camera that was restarted is that of its stamps, before the line is known.
            self._lags.add(camera, regular_ns if stamp is Stamp.ON_LINE else t_ns)
        aligned_ns = regular_ns - self.lags_ns.get(camera, 0)
        since_ns, last_ns = self._delivers_ns.get(camera, (aligned_ns, aligned_ns))
        is_broken = not 0 <= aligned_ns - last_ns <= RESTART_GAP_NS
        self._delivers_ns[camera] = aligned_ns if is_broken else since_ns, aligned_ns
        self._delivered[camera] += 1
        arrived_ns = t_ns if arrived_ns is None else arrived_ns
        new = _Waiting(
            *(camera, sequence, t_ns, aligned_ns, t_ns - regular_ns, stamp),
            *(arrived_ns, self._delivered[camera], item),
        )
        self._expire(new)
        if self._is_late(new):
            self._count_late(new)
            return []
        self._waiting[camera].append(new)
        settled: list[Pair[Item]] = []
        group = self._group_of(new)
        if len(group) == len(self.cameras):
            settled += self._settle_older(group)
            settled.append(self._settle(group))
        elif not self._is_held_up(new):
            while len(self._waiting[camera]) > _PARTNER_TIMEOUT_FRAMES:
                group = self._group_of(min(self._waiting[camera], key=self._order))
                settled += self._settle_older(group)
                settled.append(self._settle(group))
        return settled

    def _is_held_up(self, new: _Waiting[Item]) -> bool:
        """Return whether a camera's waiting frames arrived at least twice as fast as they were exposed."""
        waiting = self._waiting[new.camera]
        arrived_in_ns = new.arrived_ns - waiting[0].arrived_ns
        return len(waiting) <= _MAX_HELD_FRAMES and 0 <= 2 * arrived_in_ns < new.t_ns - waiting[0].t_ns

    def flush(self) -> list[Pair[Item]]:
        """Settle all waiting items, at the end of a recording."""
        settled = []
        while waiting := [items[0] for items in self._waiting.values() if items]:
            settled.append(self._settle(self._group_of(min(waiting, key=self._order))))
        return settled

    def _order(self, waiting: _Waiting[Item]) -> int:
        return waiting.aligned_ns if self._lags else waiting.sequence

    def _expire(self, new: _Waiting[Item]) -> None:
        """Drop a camera's frames that after the timeout are still ahead of the frames that it delivers."""
        waiting = self._waiting[new.camera]
        for old in list(waiting):
            ahead = self._order(old) > self._order(new)
            if ahead and new.delivery - old.delivery > _PARTNER_TIMEOUT_FRAMES:
                waiting.remove(old)
                self._count_late(old)

    def _count_late(self, waiting: _Waiting[Item]) -> None:
        self.late += 1
        self._late.append(waiting.item)

    def _is_late(self, new: _Waiting[Item]) -> bool:
        """Return whether the frame set of a frame was given up before the frame arrived.

        A number that fell back although its time did not was restarted from zero. If a camera continues to
        deliver late frames, the time of an earlier frame set was in the future: the order then restarts with
        this frame.
        """
        if self._last_out is None or self._order(new) > self._last_out:
            self._late_in_a_row[new.camera] = 0
            return False
        self._late_in_a_row[new.camera] += 1
        counted_anew = not self._lags and new.t_ns > self._last_out_ns + self._max_skew_ns
        if not counted_anew and self._late_in_a_row[new.camera] <= _PARTNER_TIMEOUT_FRAMES:
            return True
        self._last_out = None
        self._late_in_a_row[new.camera] = 0
        return False

    def _group_of(self, one: _Waiting[Item]) -> dict[str, _Waiting[Item]]:
        """Return the waiting items of the same frame set as ``one``, by camera."""
        group = {}
        for camera in self.cameras:
            for other in self._waiting[camera]:
                if self._together(one, other):
                    group[camera] = other
                    break
        return group

    def _together(self, one: _Waiting[Item], other: _Waiting[Item]) -> bool:
        if not self._lags:
            return one.sequence == other.sequence
        if one is other:
            return True
        lag_ns = self._lags.ns[one.camera] - self._lags.ns[other.camera]
        unambiguous_ns = self._lags.unambiguous_ns
        near_ns = min(self._max_skew_ns, unambiguous_ns[one.camera], unambiguous_ns[other.camera])
        return abs(one.aligned_ns - other.aligned_ns) <= near_ns and abs(lag_ns) <= self._max_lag_ns

    def _settle_older(self, group: Mapping[str, _Waiting[Item]]) -> list[Pair[Item]]:
        """Settle the frame sets older than one that is settled, even if incomplete."""
        first = min(self._order(waiting) for waiting in group.values())
        settled = []
        while older := [
            items[0] for items in self._waiting.values() if items and self._order(items[0]) < first
        ]:
            of_older = self._group_of(min(older, key=self._order))
            # By time an older frame may be near a frame of the group too, which has its partner.
            settled.append(self._settle({c: w for c, w in of_older.items() if w is not group.get(c)}))
        return settled

    def _settle(self, group: Mapping[str, _Waiting[Item]]) -> Pair[Item]:
        for camera, waiting in group.items():
            self._waiting[camera].remove(waiting)
        times = [waiting.t_ns for waiting in group.values()]
        t_ns = sum(times) // len(times)
        self._last_out = max(self._order(waiting) for waiting in group.values())
        self._last_out_ns = max(times)
        sequence = self._number_of(group)
        aligned = [waiting.aligned_ns for waiting in group.values()]
        stamped = [waiting.aligned_ns + waiting.off_ns for waiting in group.values()]
        skew_ns = max(stamped) - min(stamped)
        seen = {waiting.stamp for waiting in group.values()}
        is_off = Stamp.CROWDED in seen or (skew_ns > self._max_skew_ns and seen != {Stamp.ON_LINE})
        gap = 0 if self._last_number is None else max(sequence - self._last_number - 1, 0)
        self.lost_pairs += gap + (len(group) < len(self.cameras) or is_off)
        self._last_number = sequence
        items = {camera: waiting.item for camera, waiting in group.items()}
        late = tuple(self._late)
        self._late.clear()
        if is_off:
            missing = dict.fromkeys(self.cameras, Reason.OUT_OF_STEP)
            return Pair(sequence, t_ns, skew_ns, {}, missing, {}, (*late, *items.values()))
        missing = {c: self._why_missing(c, min(aligned)) for c in self.cameras if c not in group}
        behind_ns = {camera: waiting.t_ns - t_ns for camera, waiting in group.items()}
        return Pair(sequence, t_ns, skew_ns, items, missing, behind_ns, late)

    def _number_of(self, group: Mapping[str, _Waiting[Item]]) -> int:
        """Return the number of a frame set; by time the count continues while cameras drop out and return."""
        if not self._lags:
            return next(iter(group.values())).sequence
        camera = next((camera for camera in group if camera in self._ahead), next(iter(group)))
        number = group[camera].sequence - self._ahead.get(camera, 0)
        last = self._last_number
        if last is not None and (number < last or camera not in self._ahead):
            number = last + 1
        self._ahead |= {of: waiting.sequence - number for of, waiting in group.items()}
        return number + (number == last)  # a camera skipped an exposure and did not count it

    def _why_missing(self, camera: str, t_ns: int) -> Reason:
        if camera in self._delivers_ns:
            since_ns, last_ns = self._delivers_ns[camera]
            if since_ns - self._max_skew_ns <= t_ns <= last_ns + self._max_skew_ns:
                return Reason.OUT_OF_STEP
        return Reason.CAMERA_SILENT
