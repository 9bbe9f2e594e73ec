"""Playback of a recording through the camera port, in real time or as fast as its frames are fetched."""

from __future__ import annotations

import threading
from dataclasses import replace

from altd.errors import BadInputError
from altd.ports import CameraEndedError, CameraError, CameraRefusedError, CameraTimeoutError, Clock
from altd.recording.frames_table import FrameLine
from altd.recording.reader import Recording
from altd.records import Frame

_MAX_OVERDUE_S = 0.5
"""In real time, a frame that is not fetched for this long is dropped, as a camera would lose it."""


class Playback:
    """State shared by the cameras of one recording: their frames' times on the current clock, and the pace.

    In real time, the first request of any camera starts the clock for all. At the fast pace, no camera runs
    ahead of another by more than an exposure, however fast its frames are fetched.
    """

    def __init__(self, recording: Recording, clock: Clock, realtime: bool, repeat: bool) -> None:
        self.recording = recording
        self.clock = clock
        self.realtime = realtime
        self.repeat = repeat
        first, last = recording.rows.first, recording.rows.last
        self._first_s = first.t_s
        self._exposure_s = 1 / recording.header.fps
        self._length_s = last.t_s - first.t_s + self._exposure_s
        self.length_sequences = recording.rows.largest_sequence + 1
        self._started_ns: int | None = None
        self._next_s: dict[str, float] = {}
        self._changed = threading.Condition()

    def t_ns(self, row: FrameLine, playthrough: int) -> int:
        """Exposure time of a row's frame, on the monotonic clock, in a playthrough of the recording, ns."""
        with self._changed:
            if self._started_ns is None:
                self._started_ns = self.clock.monotonic_ns()
            return self._started_ns + round(self._due_s(row, playthrough) * 1e9)

    def set_next(self, camera: str, row: FrameLine | None, playthrough: int) -> None:
        """Record which frame a camera delivers next; None: it has reached its end."""
        with self._changed:
            self._next_s[camera] = float("inf") if row is None else self._due_s(row, playthrough)
            self._changed.notify_all()

    def await_others(self, camera: str, timeout_s: float) -> bool:
        """Wait until no other camera is an exposure behind; return False on timeout."""

        def is_abreast() -> bool:
            return self._next_s[camera] <= min(self._next_s.values()) + self._exposure_s / 2

        with self._changed:
            return self._changed.wait_for(is_abreast, timeout_s)

    def _due_s(self, row: FrameLine, playthrough: int) -> float:
        return row.t_s - self._first_s + playthrough * self._length_s


class PlaybackCamera:
    """One camera of a recording."""

    def __init__(self, name: str, playback: Playback) -> None:
        if not playback.recording.rows.count.get(name):
            raise BadInputError(playback.recording.path, f"has no frames of camera {name!r}")
        self.name = name
        self.origin = playback.recording.header.cameras[name].origin
        self.playback = True
        self.waits = not playback.realtime
        self.exposure_range = None
        self.identity = playback.recording.header.cameras[name].identity
        self.width = playback.recording.header.cameras[name].width
        self.height = playback.recording.header.cameras[name].height
        self._playback = playback
        self._playthrough = 0
        self._rows = playback.recording.rows.of(name)
        self._next = next(self._rows, None)
        self._failure: str | None = None
        self._closed = threading.Event()
        playback.set_next(name, self._next, 0)

    def open(self) -> None:
        """Open the camera; the recording itself was checked when it was opened."""
        self._closed.clear()

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next frame, in real time at its due time; overdue frames are then dropped."""
        playback = self._playback
        playthrough, row, t_ns = self._due()
        if playback.realtime:
            while (wait_s := (t_ns - playback.clock.monotonic_ns()) * 1e-9) < -_MAX_OVERDUE_S:
                self._advance()
                playthrough, row, t_ns = self._due()
            if wait_s > timeout_s:
                playback.clock.wait(self._closed, timeout_s)
                raise CameraTimeoutError("the next frame is not due yet")
            if wait_s > 0:
                playback.clock.wait(self._closed, wait_s)
        elif not playback.await_others(self.name, timeout_s):
            raise CameraTimeoutError("another camera's frames are not taken")
        self._advance()
        try:
            frame = playback.recording.frame(row)
        except BadInputError as error:
            raise CameraError(str(error)) from error
        sequence = row.sequence + playthrough * playback.length_sequences
        return replace(frame, t_ns=t_ns, sequence=sequence, playthrough=playthrough)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Raise CameraRefusedError: the frames were exposed when they were recorded."""
        raise CameraRefusedError(
            f"a recording cannot be exposed again, with {exposure_ms:g} ms, {gain_db:g} dB"
        )

    def close(self) -> None:
        """Stop waiting for a frame that is not due yet."""
        self._closed.set()

    def _due(self) -> tuple[int, FrameLine, int]:
        """Playthrough and row of the next frame, and when it is exposed."""
        if self._failure is not None:
            raise CameraError(self._failure)
        if self._next is None:
            raise CameraEndedError("the recording is at its end")
        return self._playthrough, self._next, self._playback.t_ns(self._next, self._playthrough)

    def _advance(self) -> None:
        """Advance to the next row, from the last one to the first where the recording is repeated.

        A table that has changed since its check ends the playback, because its frames are unknown.
        """
        try:
            self._next = next(self._rows, None)
            if self._next is None and self._playback.repeat:
                self._playthrough += 1
                self._rows = self._playback.recording.rows.of(self.name)
                self._next = next(self._rows, None)
        except BadInputError as error:
            self._failure, self._next = str(error), None
        self._playback.set_next(self.name, self._next, self._playthrough)
