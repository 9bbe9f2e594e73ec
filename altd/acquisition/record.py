"""Keep frames for replay: every exposure of all cameras, paired as the measurement would pair them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.frame_sets import FrameSets
from altd.config import Measuring
from altd.errors import BadInputError
from altd.measuring.pairing import Pair
from altd.ports import Camera
from altd.recording.header import (
    MADE_BY,
    CameraHeader,
    Kind,
    RecordingHeader,
    TargetHeader,
    UnitHeader,
    camera_header,
    note_of,
)
from altd.recording.writer import RecordingWriter
from altd.records import Frame
from altd.status.health import Health


async def record(
    cameras: Sequence[Camera],
    path: Path,
    unit: UnitHeader,
    measuring: Measuring,
    health: Health,
    utc: Callable[[int], datetime | None],
    seconds: float,
    kind: Kind = "measurement",
    fps: float = 20.0,
    exposure: Mapping[str, ExposureControl] | None = None,
    progress: Callable[[int, int], None] = lambda done, planned: None,
    targets: tuple[TargetHeader, ...] | None = None,
) -> int:
    """Write a recording of a kind; returns the number of exposures.

    Ends after ``seconds`` of exposures, when all sources are at their end, or on cancellation; what was
    written until then is whole. Exposure time and gain are set by ``exposure`` when a camera is opened, and
    hold still; what was exposed while they were being set is not kept. ``progress`` is told after each
    exposure how many of how many are kept. ``targets`` are what the cameras look at; None: the usual two.
    Raises BadInputError when the folder cannot be used, and a driver's own failure; a camera that is merely
    lost is waited for.
    """
    sink = _Sink(path, unit, targets, cameras, kind, fps, utc)
    try:
        async with FrameSets(cameras, measuring, health, exposure) as sets:
            while sink.length_s < seconds and not sets.is_at_end:
                for pair in await sets.settled():
                    changing = any(frame.changing for frame in pair.items.values())
                    if sink.length_s < seconds and not changing:
                        sink.write(pair)
                        progress(sink.exposures, round(seconds * fps))
            sets.check()
            return sink.exposures
    finally:
        sink.close()


class _Sink:
    """Opens the writer with the first exposure, when sizes and depths are known."""

    def __init__(
        self,
        path: Path,
        unit: UnitHeader,
        targets: tuple[TargetHeader, ...] | None,
        cameras: Sequence[Camera],
        kind: Kind,
        fps: float,
        utc: Callable[[int], datetime | None],
    ) -> None:
        self._path = path
        self._unit = unit
        self._targets = targets
        self._kind: Kind = kind
        self._fps = fps
        self._utc = utc
        self._cameras = {camera.name: camera for camera in cameras}
        self._writer: RecordingWriter | None = None
        self._headers: dict[str, CameraHeader] = {}
        self._first_ns = 0
        self._first_sequence = 0
        self._last: tuple[int, float] = (-1, -1.0)
        """Number and time of the last exposure that was kept."""
        self.exposures = 0
        self.length_s = 0.0

    def write(self, pair: Pair[Frame]) -> None:
        if self._writer is None:
            if len(pair.items) < len(self._cameras):
                return
            self._first_ns, self._first_sequence = pair.t_ns, pair.sequence
            self._headers = {
                name: camera_header(frame, self._cameras[name]) for name, frame in pair.items.items()
            }
            self._writer = RecordingWriter(self._path, self._header())
        self._check_cameras()
        t_s = (pair.t_ns - self._first_ns) * 1e-9
        last_sequence, last_s = self._last
        if t_s <= last_s:
            return  # a recording stands in the order of time
        if pair.sequence - self._first_sequence <= last_sequence:  # counted anew
            self._first_sequence = pair.sequence - last_sequence - 1
        sequence = pair.sequence - self._first_sequence
        self._last = sequence, t_s
        try:
            for frame in pair.items.values():
                self._writer.write(frame, sequence, t_s)
        except OSError as error:
            raise BadInputError(self._path, error.strerror or str(error)) from error
        self.exposures += 1
        self.length_s = t_s + 1 / self._fps

    def _check_cameras(self) -> None:
        """A camera that was changed for another would have its frames taken for those of the first."""
        for name, header in self._headers.items():
            camera = self._cameras[name]
            difference = (camera.identity or header.identity).difference_from(header.identity)
            if camera.origin is not header.origin:
                difference = f"its frames are {camera.origin} now, they were {header.origin}"
            if difference:
                raise BadInputError(self._path, f"camera {name} is another than at the start: {difference}")

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()

    def _header(self) -> RecordingHeader:
        return RecordingHeader(
            format="altd-recording/1",
            kind=self._kind,
            fps=self._fps,
            cameras=self._headers,
            unit=self._unit,
            targets=self._targets,
            note=note_of("altd record", self._cameras.values()),
            made_by=MADE_BY,
            start=self._utc(self._first_ns),
        )
