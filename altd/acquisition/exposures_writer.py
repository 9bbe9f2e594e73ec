"""Exposures of cameras that deliver, written as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from altd.errors import BadInputError
from altd.measuring.pairing import Pair
from altd.ports import Camera
from altd.recording.header import (
    MADE_BY,
    CameraHeader,
    Kind,
    LedPlateHeader,
    PlateHeader,
    RecordingHeader,
    TargetHeader,
    UnitHeader,
    camera_header,
    note_of,
)
from altd.recording.writer import RecordingWriter
from altd.records import Frame

FPS = 20.0
"""Exposures a second by the header, and how long the last one counts."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """The content of a recording: seconds, unit, targets (None: the usual two), author."""

    seconds: float
    unit: UnitHeader
    targets: tuple[TargetHeader, ...] | None = None
    kind: Kind = "measurement"
    by: str = "altd record"
    """The command, in the recording's note."""
    plate: PlateHeader | LedPlateHeader | None = None
    """The plates at the targets' places in a recording of kind ``plate``, the plate of kind ``planar``."""
    pose: tuple[float, float, float] | None = None
    """The known pose of the latter, (a mm, b mm, φ °)."""
    has_opaque: bool = False
    """Whether the cameras look at targets that are switched in turn."""


class ExposuresWriter:
    """Opens the recording with the first exposure of all ``cameras``, when sizes and depths are known.

    ``utc`` is the UTC of an instant on the clock by which the frames are timed.
    """

    def __init__(
        self,
        path: Path,
        plan: RecordingPlan,
        cameras: Mapping[str, Camera],
        utc: Callable[[int], datetime | None],
    ) -> None:
        self._path = path
        self._plan = plan
        self._utc = utc
        self._cameras = cameras
        self._writer: RecordingWriter | None = None
        self._headers: dict[str, CameraHeader] = {}
        self._first_ns = 0
        self._first_sequence = 0
        self._last: tuple[int, float] = (-1, -1.0)
        """Number and time of the last exposure that was kept."""
        self.exposures = 0
        self.length_s = 0.0

    def write(self, pair: Pair[Frame]) -> None:
        """Append an exposure, complete or not; one before the first complete one is left out.

        Raises BadInputError when the folder cannot be used or a camera is another than at the start.
        """
        if self._writer is None:
            if len(pair.items) < len(self._cameras):
                return
            self._first_ns, self._first_sequence = pair.t_ns, pair.sequence
            self._headers = {
                name: camera_header(frame, self._cameras[name]) for name, frame in pair.items.items()
            }
            self._writer = RecordingWriter(
                self._path, self._header(), pose=self._plan.pose, has_opaque=self._plan.has_opaque
            )
        self._check_cameras()
        t_s = (pair.t_ns - self._first_ns) * 1e-9
        last_sequence, last_s = self._last
        if t_s <= last_s:
            return  # a recording is in the order of time
        if pair.sequence - self._first_sequence <= last_sequence:  # counted from zero again
            self._first_sequence = pair.sequence - last_sequence - 1
        sequence = pair.sequence - self._first_sequence
        self._last = sequence, t_s
        try:
            for frame in pair.items.values():
                self._writer.write(frame, sequence, t_s)
        except OSError as error:
            raise BadInputError(self._path, error.strerror or str(error)) from error
        self.exposures += 1
        self.length_s = t_s + 1 / FPS

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
        """Finish; what was written until then is whole."""
        if self._writer is not None:
            self._writer.close()

    def _header(self) -> RecordingHeader:
        return RecordingHeader(
            format="altd-recording/1",
            kind=self._plan.kind,
            fps=FPS,
            cameras=self._headers,
            unit=self._plan.unit,
            targets=self._plan.targets,
            plate=self._plan.plate,
            note=note_of(self._plan.by, self._cameras.values()),
            made_by=MADE_BY,
            start=self._utc(self._first_ns),
        )
