"""Writing a recording, frame by frame."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.files.writing import replace_file
from altd.recording.frames_table import COLUMNS, OPAQUE, POSE_COLUMNS
from altd.recording.header import (
    FRAMES_FILE,
    HEADER_FILE,
    CameraHeader,
    RecordingHeader,
    read_header,
)
from altd.records import Frame, utc_text


def refuse_used_folder(path: Path) -> None:
    """Raise BadInputError if ``path`` exists and is not an empty folder."""
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise BadInputError(path, "exists and is not an empty folder")
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be read") from error


def _comparable(header: RecordingHeader) -> dict[str, CameraHeader]:
    """Return the cameras without the values that may differ between two parts of a recording."""
    free = {"exposure_ms": None, "gain_db": None}
    return {name: camera.model_copy(update=free) for name, camera in header.cameras.items()}


def _encoded(header: RecordingHeader) -> bytes:
    document = header.model_dump(mode="json", exclude_none=True)
    if header.start is not None:
        document["start"] = utc_text(header.start)
    return (json.dumps(document, indent=1) + "\n").encode()


class RecordingWriter:
    """Writes a recording frame by frame; the files are readable after each frame.

    Raises BadInputError if the folder exists and is not empty. With ``resume_at`` it continues in the folder
    of an earlier writer, after that many bytes of its table; the existing header is kept, and must have the
    same cameras and unit. ``stated``: values of further columns, the known pose of a plate or the joints of
    its machine. ``has_opaque``: the table has a column of the target that was switched to show the spot.
    """

    def __init__(
        self,
        path: Path,
        header: RecordingHeader,
        resume_at: int | None = None,
        stated: Mapping[str, float] | None = None,
        has_opaque: bool = False,
    ) -> None:
        self._path = path
        self._header = header
        self._has_opaque = has_opaque
        blank = dict.fromkeys(POSE_COLUMNS if header.kind == "planar" else (), "")
        self._stated: dict[str, object] = {**blank, **(stated or {})}
        if resume_at is not None:
            self._resume(header, resume_at)
            return
        refuse_used_folder(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            for camera in header.cameras:
                (path / camera).mkdir()  # if two start here at once, it fails for the later one
        except OSError as error:
            raise BadInputError(path, error.strerror or "cannot be written") from error
        try:
            (path / HEADER_FILE).write_bytes(_encoded(header))
            self._file = (path / FRAMES_FILE).open("ab", buffering=0)
            self._append((*COLUMNS, *self._stated, *((OPAQUE,) if has_opaque else ())))
        except OSError as error:
            shutil.rmtree(path, ignore_errors=True)
            raise BadInputError(path, error.strerror or "cannot be written") from error

    def _resume(self, header: RecordingHeader, resume_at: int) -> None:
        there = read_header(self._path / HEADER_FILE)
        if (_comparable(there), there.unit, there.shown_targets) != (
            _comparable(header),
            header.unit,
            header.shown_targets,
        ):
            raise BadInputError(
                self._path / HEADER_FILE,
                "is of another unit, of other targets, of other cameras, or of cameras of another size",
            )
        self._header = there
        try:
            self._file = (self._path / FRAMES_FILE).open("ab", buffering=0)
            self._file.truncate(resume_at)
        except OSError as error:
            raise BadInputError(self._path / FRAMES_FILE, error.strerror or "cannot be written") from error

    def _append(self, row: Iterable[object]) -> None:
        """Write a row completely; raises OSError and then leaves nothing of it."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(row)
        line, before_bytes = text.getvalue().encode(), os.fstat(self._file.fileno()).st_size
        if self._file.write(line) < len(line):
            self._file.truncate(before_bytes)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(
        self, frame: Frame, sequence: int, t_s: float, position_mm: tuple[float, float] | None = None
    ) -> Path:
        """Append one frame with the exposure's number and time; returns its file.

        Raises OSError when the disk refuses.
        """
        name = f"{frame.camera}/{sequence:06d}.png"
        done, data = cv2.imencode(".png", np.asarray(frame.pixels))
        if not done:
            raise OSError(f"{name} cannot be encoded")
        self._check_exposure(frame)
        at = ("", "") if position_mm is None else tuple(f"{value:.4f}" for value in position_mm)
        try:
            (self._path / name).write_bytes(data.tobytes())
            leds = "on" if frame.leds_on else "off"
            opaque = (frame.opaque,) if self._has_opaque else ()
            stated = self._stated.values()
            self._append((sequence, f"{t_s:.6f}", frame.camera, name, leds, *at, *stated, *opaque))
        except OSError:  # a full disk: a partial file is not part of the recording
            (self._path / name).unlink(missing_ok=True)
            raise
        return self._path / name

    def _check_exposure(self, frame: Frame) -> None:
        """Remove exposure and gain from the header unless all frames without LEDs have them."""
        camera = self._header.cameras[frame.camera]
        stated, own = (camera.exposure_ms, camera.gain_db), (frame.exposure_ms, frame.gain_db)
        if frame.leds_on or stated in ((None, None), own):
            return
        free = camera.model_copy(update={"exposure_ms": None, "gain_db": None})
        cameras = {**self._header.cameras, frame.camera: free}
        self._header = self._header.model_copy(update={"cameras": cameras})
        replace_file(self._path / HEADER_FILE, _encoded(self._header))

    def synced(self) -> int:
        """Write the table to the disk; returns its length, bytes."""
        os.fsync(self._file.fileno())
        return os.fstat(self._file.fileno()).st_size

    def close(self) -> None:
        """Close the table; harmless when done twice."""
        self._file.close()
