"""The newest frame of each camera, from the thread that acquires it to the one that locates its spot."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from altd.records import Frame


def keep_mark(dropped: Frame, newer: Frame) -> Frame:
    """The frame that replaces another: the mark of a change of exposure is not lost with who bore it."""
    return replace(newer, changing=True) if dropped.changing else newer


@dataclass(slots=True, eq=False)
class _Slot:
    """One camera's newest frame, and how its locating does."""

    changed: threading.Condition
    frame: Frame | None = None
    before: Frame | None = None
    """The one that it replaced, as long as that may still find its partner."""
    given: Frame | None = None
    """What the thread is to locate next; it is out of the slot, also while the thread is only waking up."""
    is_closed: bool = False
    dropped: int = 0
    is_idle: bool = False
    """The thread waits for a frame."""
    has_waited: bool = False
    """The one in the slot, or one that it replaced, came while another was being located."""
    is_behind: bool = False
    """So had the one that is being located."""
    round: int = 0
    """In which a frame was given last."""

    @property
    def is_ready(self) -> bool:
        """Whether a frame and its thread wait for each other."""
        return self.is_idle and self.frame is not None

    @property
    def holds_up_others(self) -> bool:
        """Whether it is busy, and was so when its last or its next frame came."""
        return not self.is_idle and (self.is_behind or self.has_waited)


class LatestFrames:
    """A slot for each camera: the newest frame wins, and what is replaced untaken is counted.

    Frames are given in rounds, one of each camera in a round. Where locating keeps up, each is given when it
    comes. Where that of a camera is behind, no round begins before that camera can begin one: then all that
    wait are given the newest frame set of which each has a frame. So they drop the same frame sets, and what
    is left makes pairs.
    """

    def __init__(self, cameras: Iterable[str]) -> None:
        self._lock = threading.Lock()
        self._slots = {camera: _Slot(threading.Condition(self._lock)) for camera in cameras}
        self._round = 0
        self._round_ns = 0
        """The time of the frame set that is given in it."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Frames per camera that were replaced before they were taken."""
        return {camera: slot.dropped for camera, slot in self._slots.items()}

    def put(self, frame: Frame, wait: bool) -> None:
        """Fill a camera's slot; with ``wait`` only when it is empty."""
        with self._lock:
            slot = self._slots[frame.camera]
            while wait and slot.frame is not None and not slot.is_closed:
                slot.changed.wait()
            if slot.is_closed:
                return
            if slot.frame is not None:
                slot.before = self._newer(slot, slot.frame)
            slot.frame = frame
            slot.has_waited |= not slot.is_idle
            self._give()

    def take(self, camera: str) -> Frame | None:
        """A camera's newest frame, when it is its turn; None once it is closed and empty.

        The one that was taken before has been located.
        """
        with self._lock:
            slot = self._slots[camera]
            slot.is_idle = True
            self._give()
            while slot.given is None and not (slot.is_closed and slot.frame is None):
                slot.changed.wait()
            frame, slot.given = slot.given, None
            return frame

    def end(self, camera: str) -> None:
        """No frame of this camera follows."""
        with self._lock:
            self._close(self._slots[camera])

    def close(self) -> None:
        """No frame follows; threads that wait are let go."""
        with self._lock:
            for slot in self._slots.values():
                self._close(slot)
            self._give()

    def _newer(self, slot: _Slot, frame: Frame) -> Frame:
        """A frame after which the one before it is not given any more."""
        before, slot.before = slot.before, None
        if before is None:
            return frame
        slot.dropped += 1
        return keep_mark(before, frame)

    def _close(self, slot: _Slot) -> None:
        slot.is_closed = True
        slot.changed.notify_all()

    def _give(self) -> None:
        """Give frames to all who may have them now: of the round that has begun, and of the next one."""
        for slot in self._slots.values():
            if slot.is_ready and slot.round != self._round:
                self._give_to(slot)
        ready = [slot for slot in self._slots.values() if slot.is_ready]
        is_closed = all(slot.is_closed for slot in self._slots.values())
        # once closed, a thread that ended with a frame in hand must not hold up those that wait for theirs
        if ready and (is_closed or not any(slot.holds_up_others for slot in self._slots.values())):
            self._round += 1
            self._round_ns = min(slot.frame.t_ns for slot in ready if slot.frame is not None)
            for slot in ready:
                self._give_to(slot)

    def _give_to(self, slot: _Slot) -> None:
        """The newest frame, or the one before it where that is nearer to the others of the round."""
        newest, before, t_ns = slot.frame, slot.before, self._round_ns
        assert newest is not None  # noqa: S101  it is ready
        if before is not None and abs(before.t_ns - t_ns) < abs(newest.t_ns - t_ns):
            slot.given, slot.before = before, None
        else:
            slot.given, slot.frame = self._newer(slot, newest), None
        slot.is_idle, slot.is_behind, slot.has_waited = False, slot.has_waited, slot.frame is not None
        slot.round = self._round
        slot.changed.notify_all()
