"""Cameras that deliver frames from memory, and keep when they did."""

from __future__ import annotations

import threading
import time

from altd.ports import CameraTimeoutError
from altd.records import Frame, Origin
from benchmarks.material import CAMERAS, Material

_LEAD_NS = 50_000_000
"""From the first camera's opening to the first frame set: both threads are waiting by then."""


class Source:
    """One trigger for all cameras: frame set k at ``start + k`` periods. At 0 pairs/s nothing ever comes."""

    def __init__(self, material: Material, pairs_per_s: float) -> None:
        self.material = material
        self.period_ns = round(1e9 / pairs_per_s) if pairs_per_s else 0
        self.handed_ns: list[int] = []
        """Per frame set, when its last frame was handed over."""
        self.stop_at_ns: int | None = None
        """No exposures after this instant."""
        self._start_ns: int | None = None
        self._lock = threading.Lock()

    @property
    def cameras(self) -> dict[str, MemoryCamera]:
        """Fresh cameras of this source, by name."""
        return {name: MemoryCamera(self, index) for index, name in enumerate(CAMERAS)}

    def start_ns(self) -> int:
        """When frame set 0 is exposed; the first to ask fixes it."""
        with self._lock:
            if self._start_ns is None:
                self._start_ns = time.monotonic_ns() + _LEAD_NS
            return self._start_ns

    def planned(self, seconds: float) -> int:
        """Exposures from the first one on for that long."""
        return round(seconds * 1e9) // self.period_ns + 1

    def note(self, sequence: int) -> None:
        """A frame of this frame set is handed over now."""
        with self._lock:
            if sequence == len(self.handed_ns):
                self.handed_ns.append(0)
            self.handed_ns[sequence] = time.monotonic_ns()


class MemoryCamera:
    """See ``altd.ports.Camera``. Late, it delivers what it owes at once: a driver's queue does the same."""

    waits = False
    origin = Origin.SIMULATED
    playback = False
    exposure_range = None
    identity = None

    def __init__(self, source: Source, index: int) -> None:
        self.name = CAMERAS[index]
        self._source = source
        self._index = index
        self._next = 0

    def open(self) -> None:
        """Join the trigger."""
        self._source.start_ns()

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame, at its time; its pixels are shared, not copied."""
        source = self._source
        t_ns = source.start_ns() + self._next * source.period_ns
        wait_s = (t_ns - time.monotonic_ns()) * 1e-9
        ended = source.stop_at_ns is not None and t_ns > source.stop_at_ns
        if not source.period_ns or ended or wait_s > timeout_s:
            time.sleep(timeout_s)
            raise CameraTimeoutError(f"{self.name}: nothing within {timeout_s:g} s")
        if wait_s > 0:
            time.sleep(max((t_ns - time.monotonic_ns()) * 1e-9, 0.0))
        frame = source.material.pair(self._next, t_ns)[self._index]
        source.note(self._next)
        self._next += 1
        return frame

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Never asked for: there is no range."""

    def close(self) -> None:
        """Nothing to let go of."""
