"""A recording behind the camera port, in real time or as fast as its frames are taken."""

from __future__ import annotations

import time
from dataclasses import replace

from altd.errors import BadInputError
from altd.ports import CameraEndedError, CameraError
from altd.recording import Recording, Row
from altd.records import Frame, Origin


class Playback:
    """What the cameras of one recording share: its frames' times on today's clock.

    The first camera that asks starts the clock for all, so that they stay in step.
    """

    def __init__(self, recording: Recording, realtime: bool, repeat: bool) -> None:
        self.recording = recording
        self.realtime = realtime
        self.repeat = repeat
        first, last = recording.rows[0], recording.rows[-1]
        self._first_s = first.t_s
        self.length_s = last.t_s - first.t_s + 1 / recording.header.fps
        self.length_sequences = max(row.sequence for row in recording.rows) + 1
        self._started_ns: int | None = None

    def t_ns(self, row: Row, turn: int) -> int:
        """When a row's frame is exposed, on the monotonic clock, in the given turn through the recording."""
        if self._started_ns is None:
            self._started_ns = time.monotonic_ns()
        return self._started_ns + round((row.t_s - self._first_s + turn * self.length_s) * 1e9)


class PlaybackCamera:
    """One camera of a recording."""

    def __init__(self, name: str, playback: Playback) -> None:
        rows = tuple(row for row in playback.recording.rows if row.camera == name)
        if not rows:
            raise BadInputError(playback.recording.path, f"has no frames of camera {name!r}")
        self.name = name
        self.origin = Origin.PLAYBACK
        self.waits = not playback.realtime
        self.width = playback.recording.header.cameras[name].width
        self.height = playback.recording.header.cameras[name].height
        self._playback = playback
        self._rows = rows
        self._next = 0

    def open(self) -> None:
        """Nothing to get ready; the recording was checked when it was opened."""

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame, at its time when the pace is real time."""
        playback = self._playback
        turn, index = divmod(self._next, len(self._rows))
        if turn and not playback.repeat:
            raise CameraEndedError("the recording is at its end")
        row = self._rows[index]
        t_ns = playback.t_ns(row, turn)
        if playback.realtime:
            wait_s = (t_ns - time.monotonic_ns()) * 1e-9
            if wait_s > 0:
                time.sleep(min(wait_s, timeout_s))
        self._next += 1
        try:
            frame = playback.recording.frame(row)
        except BadInputError as error:
            raise CameraError(str(error)) from error
        return replace(frame, t_ns=t_ns, sequence=row.sequence + turn * playback.length_sequences)

    def close(self) -> None:
        """Nothing to let go of."""
