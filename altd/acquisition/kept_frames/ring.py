"""The newest frames of all cameras in memory, up to a limit."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from altd.records import CameraIdentity, Frame


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    frame: Frame
    identity: CameraIdentity | None


class FrameRing:
    """Keeps the newest frames.

    Nothing is copied: a frame is frozen and owns its pixels. ``max_bytes`` limits the kept pixels,
    ``length_ns`` their age; ``identity`` returns the identity of the camera that delivers now.
    """

    def __init__(
        self,
        max_bytes: int,
        length_ns: int,
        identity: Callable[[str], CameraIdentity | None],
    ) -> None:
        self._max_bytes = max_bytes
        self._length_ns = length_ns
        self._identity = identity
        self._lock = threading.Lock()
        self._kept: deque[_Kept] = deque()
        self._bytes = 0

    @property
    def nbytes(self) -> int:
        """Memory of the kept pixels, bytes."""
        return self._bytes

    def keep(self, frame: Frame) -> None:
        """Keep a frame, from the thread of its camera."""
        kept = _Kept(frame, self._identity(frame.camera))
        with self._lock:
            if self._kept and frame.t_ns < self._kept[-1].frame.t_ns - self._length_ns:
                self._clear()  # a recording is being repeated: the kept frames do not precede this one
            self._kept.append(kept)
            self._bytes += frame.pixels.nbytes
            while self._kept and (
                self._bytes > self._max_bytes or frame.t_ns - self._kept[0].frame.t_ns > self._length_ns
            ):
                self._bytes -= self._kept.popleft().frame.pixels.nbytes

    def between(self, since_ns: int, until_ns: int) -> deque[Frame]:
        """Return the kept frames between these instants, in the order of delivery.

        If a camera was exchanged meanwhile, only frames since then are returned: a recording cannot
        distinguish the two cameras.
        """
        with self._lock:
            kept = [each for each in self._kept if since_ns <= each.frame.t_ns <= until_ns]
        last: dict[str, CameraIdentity | None] = {}
        changed: set[str] = set()
        frames: deque[Frame] = deque()
        for each in reversed(kept):
            camera = each.frame.camera
            if each.identity != last.setdefault(camera, each.identity):
                changed.add(camera)
            if camera not in changed:
                frames.appendleft(each.frame)
        return frames

    def _clear(self) -> None:
        self._kept.clear()
        self._bytes = 0
