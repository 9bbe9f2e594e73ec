"""Writes the exposures of delivering cameras as a recording."""

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
"""Exposures per second in the header; the last exposure counts for one period in the length."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """Content of a recording: length in seconds, unit, targets (None: the usual two), author."""

    seconds: float
    unit: UnitHeader
    targets: tuple[TargetHeader, ...] | None = None
    kind: Kind = "measurement"
    by: str = "altd record"
    """Command in the recording's note."""
    plate: PlateHeader | LedPlateHeader | None = None
    """Plates in place of the targets for kind ``plate``; the plate with LEDs for kind ``planar``."""
    stated: Mapping[str, float] | None = None
    """Known pose of the plate for kind ``planar``, or joints of its machine, by their columns."""
    has_opaque: bool = False
    """Whether the cameras view targets that are switched in turn."""


class ExposuresWriter:
    """Opens the recording at the first exposure of all ``cameras``, when sizes and bit depths are known.

    ``utc`` returns the UTC of an instant on the clock by which the frames are timed.
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
        """Number and time in seconds of the last written exposure."""
        self.exposures = 0
        self.length_s = 0.0

    def write(self, pair: Pair[Frame]) -> None:
        """Append an exposure, complete or not; skip exposures before the first complete one.

        Raises BadInputError if the folder cannot be used or a camera was exchanged since the start.
        """
        if self._writer is None:
            if len(pair.items) < len(self._cameras):
                return
            self._first_ns, self._first_sequence = pair.t_ns, pair.sequence
            self._headers = {
                name: camera_header(frame, self._cameras[name]) for name, frame in pair.items.items()
            }
            self._writer = RecordingWriter(
                self._path, self._header(), stated=self._plan.stated, has_opaque=self._plan.has_opaque
            )
        self._check_cameras()
        t_s = (pair.t_ns - self._first_ns) * 1e-9
        last_sequence, last_s = self._last
        if t_s <= last_s:
            return  # a recording is in order of time
        if pair.sequence - self._first_sequence <= last_sequence:  # the camera restarted its count
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
        """Raise BadInputError if a camera was exchanged: its frames would be attributed to the first one."""
        for name, header in self._headers.items():
            camera = self._cameras[name]
            difference = (camera.identity or header.identity).difference_from(header.identity)
            if camera.origin is not header.origin:
                difference = f"its frames are {camera.origin} now, they were {header.origin}"
            if difference:
                raise BadInputError(self._path, f"camera {name} is another than at the start: {difference}")

    def close(self) -> None:
        """Finish the recording; the exposures written so far are complete."""
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
