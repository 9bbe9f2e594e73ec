"""altd-recording/1: a folder of frames with their times (DESIGN §4); read and write."""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import os
import shutil
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from altd import __version__
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.picture import PNG_HEAD_BYTES, check_png_head, decode_png, png_bytes
from altd.files.reading import read_file, read_head
from altd.measurement_json import utc_text
from altd.ports import Camera
from altd.recording_table import COLUMNS, MAX_POSITION_MM, Row, Rows
from altd.records import CameraIdentity, Frame, Origin

HEADER_FILE = "recording.json"
FRAMES_FILE = "frames.csv"

Kind = Literal["scan", "plate", "flat", "measurement", "self-check"]
"""What a recording shows."""

_LARGEST_HEADER_BYTES = 1 << 20
_LARGEST_FILE_BYTES = 1 << 28

MADE_BY = f"altd {__version__}"

Length = Annotated[float, Field(gt=0, le=MAX_POSITION_MM)]
Position = Annotated[float, Field(ge=-MAX_POSITION_MM, le=MAX_POSITION_MM)]


def _in_our_time(start: datetime) -> datetime:
    if not 1970 <= start.year <= 2200:
        raise ValueError(f"the year {start.year} is none of a recording")
    return start


class _Header(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class CameraHeader(_Header):
    """Size and depth of one camera's frames."""

    width: Annotated[int, Field(ge=16, le=20_000)]
    height: Annotated[int, Field(ge=16, le=20_000)]
    bits: Annotated[int, Field(ge=8, le=16)]
    serial: str | None = None
    """The camera's serial number, where its driver tells one."""
    model: str | None = None
    """What its maker calls it."""
    driver: str | None = None
    """The driver that named it: ``driver`` of the config."""
    origin: Origin = Origin.CAMERA
    """How its frames came to be."""
    exposure_ms: float | None = None
    """As the first frame was exposed, where the driver tells; a recording keeps to it."""
    gain_db: float | None = None
    mirrored: bool | None = None
    """Whether the camera sees its target mirrored, where that is not the usual: see a plate's calibration."""

    @property
    def identity(self) -> CameraIdentity:
        """Which camera it was, as far as the recording knows."""
        return CameraIdentity(self.serial, self.model, self.driver)


def camera_header(frame: Frame, camera: Camera | None) -> CameraHeader:
    """The header of a camera that is open and delivers such frames."""
    known = (camera.identity if camera else None) or CameraIdentity()
    rows, columns = frame.pixels.shape
    return CameraHeader(
        width=columns,
        height=rows,
        bits=frame.bits,
        serial=known.serial,
        model=known.model,
        driver=known.driver,
        origin=camera.origin if camera else Origin.CAMERA,
        exposure_ms=frame.exposure_ms,
        gain_db=frame.gain_db,
    )


def note_of(command: str, cameras: Collection[Camera]) -> str:
    """The note of what a command records of cameras that are open: its name, and what is not live."""
    played = any(camera.playback for camera in cameras)
    simulated = any(camera.origin is Origin.SIMULATED for camera in cameras)
    return f"{command}{', playback' * played}{', simulated' * simulated}"


class UnitHeader(_Header):
    """The unit that was recorded."""

    serial: str
    target_distance_mm: Annotated[float, Field(gt=0, le=100_000)]


class PlateHeader(_Header):
    """A grid of lit LEDs; ``origin_mm`` is the LED with the smallest x and the smallest y.

    ``disc_mm`` is the diameter of an LED's even disc, ``beam_mm`` the 1/e² diameter of the laser spot that
    will be measured.
    """

    columns: Annotated[int, Field(ge=4, le=100)]
    rows: Annotated[int, Field(ge=4, le=100)]
    pitch_mm: Length
    origin_mm: tuple[Position, Position]
    disc_mm: Length | None = None
    beam_mm: Annotated[float, Field(ge=0, le=50)] = 12.0


class RecordingHeader(_Header):
    """``recording.json``; unknown keys are ignored."""

    format: Literal["altd-recording/1"]
    kind: Kind
    fps: Annotated[float, Field(ge=0.001, le=100_000)]
    cameras: Annotated[Mapping[str, CameraHeader], Field(min_length=1)]
    unit: UnitHeader
    note: str = ""
    made_by: str | None = None
    """The program that wrote it, with its version."""
    start: Annotated[datetime, AfterValidator(_in_our_time)] | None = None
    """UTC of t_s = 0, where it is known."""
    plate: PlateHeader | None = None
    """In a recording of kind ``plate``."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording whose header, rows and frame sizes have been checked."""

    path: Path
    header: RecordingHeader
    rows: Rows

    def frame(self, row: Row) -> Frame:
        """Decode the frame of a row; raises BadInputError that names the file and the row."""
        camera = self.header.cameras[row.camera]
        size = camera.width, camera.height, camera.bits
        try:
            pixels = decode_png(read_file(self.path / row.file, png_bytes(*size)), *size)
        except ValueError as error:
            raise BadInputError(self.rows.place(row), f"{row.file} {error}") from error
        except BadInputError as error:
            raise BadInputError(self.rows.place(row), f"{row.file}: {error.message}") from error
        pixels.flags.writeable = False
        t_ns = round(row.t_s * 1e9)
        return Frame(row.camera, row.sequence, t_ns, pixels, camera.bits, row.leds_on)

    def sha256(self) -> str:
        """Hash over header, rows and all frame files, in the rows' order."""
        digest = hashlib.sha256(read_file(self.path / HEADER_FILE, _LARGEST_HEADER_BYTES))
        for piece in self.rows.table.pieces():
            digest.update(piece)
        for row in self.rows:
            digest.update(read_file(self.path / row.file, _LARGEST_FILE_BYTES))
        return digest.hexdigest()


def open_recording(path: Path) -> Recording:
    """Read header and rows and check every frame's file, size and depth without decoding it.

    Raises BadInputError that names the file and, in ``frames.csv``, the row (the first frame is row 2).
    """
    header = _read_header(path / HEADER_FILE)
    table = path / FRAMES_FILE
    return Recording(path, header, Rows.checked(table, header.cameras, partial(_check_png, path, header)))


def _read_header(path: Path) -> RecordingHeader:
    content = read_file(path, _LARGEST_HEADER_BYTES)
    try:
        return RecordingHeader.model_validate(parse_json(content))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        if isinstance(first["input"], int | float):
            message += f", not {first['input']}"
        raise BadInputError(path, f"{place}: {message}" if place else message) from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error


def _check_png(path: Path, header: RecordingHeader, row: Row) -> None:
    """Signature, size, depth and colour, without decoding it."""
    camera, place = header.cameras[row.camera], f"{path / FRAMES_FILE}: row {row.number}"
    try:
        head = read_head(path / row.file, PNG_HEAD_BYTES)
        check_png_head(head, camera.width, camera.height, camera.bits)
    except ValueError as error:
        raise BadInputError(place, f"{row.file} {error}") from error
    except BadInputError as error:
        raise BadInputError(place, f"{row.file}: {error.message}") from error


def refuse_used_folder(path: Path) -> None:
    """Raise BadInputError when ``path`` is something else than an empty or a new folder."""
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise BadInputError(path, "exists and is not an empty folder")
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be read") from error


def _comparable(header: RecordingHeader) -> dict[str, CameraHeader]:
    """The cameras without what may differ between two parts of a recording."""
    free = {"exposure_ms": None, "gain_db": None}
    return {name: camera.model_copy(update=free) for name, camera in header.cameras.items()}


class RecordingWriter:
    """Writes a recording frame by frame; what is on disk is readable after each frame.

    Raises BadInputError when the folder exists and is not empty. With ``resume_at`` it goes on in a folder
    that another writer left, behind the first so many bytes of its table; the header there stays, and must
    have the same cameras and unit.
    """

    def __init__(self, path: Path, header: RecordingHeader, resume_at: int | None = None) -> None:
        self._path = path
        if resume_at is not None:
            self._resume(header, resume_at)
            return
        refuse_used_folder(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            for camera in header.cameras:
                (path / camera).mkdir()  # fails for the later one of two that began here at once
        except OSError as error:
            raise BadInputError(path, error.strerror or "cannot be written") from error
        try:
            document = header.model_dump(mode="json", exclude_none=True)
            if header.start is not None:
                document["start"] = utc_text(header.start)
            (path / HEADER_FILE).write_text(json.dumps(document, indent=1) + "\n")
            self._file = (path / FRAMES_FILE).open("ab", buffering=0)
            self._append(COLUMNS)
        except OSError as error:
            shutil.rmtree(path, ignore_errors=True)
            raise BadInputError(path, error.strerror or "cannot be written") from error

    def _resume(self, header: RecordingHeader, resume_at: int) -> None:
        there = _read_header(self._path / HEADER_FILE)
        if (_comparable(there), there.unit) != (_comparable(header), header.unit):
            raise BadInputError(
                self._path / HEADER_FILE,
                "is of another unit, of other cameras, or of cameras of another size",
            )
        try:
            self._file = (self._path / FRAMES_FILE).open("ab", buffering=0)
            self._file.truncate(resume_at)
        except OSError as error:
            raise BadInputError(self._path / FRAMES_FILE, error.strerror or "cannot be written") from error

    def _append(self, row: Iterable[object]) -> None:
        """A row as a whole; raises OSError, and then there is nothing of it."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(row)
        line, before_bytes = text.getvalue().encode(), os.fstat(self._file.fileno()).st_size
        if self._file.write(line) < len(line):
            self._file.truncate(before_bytes)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(
        self, frame: Frame, sequence: int, t_s: float, position_mm: tuple[float, float] | None = None
    ) -> Path:
        """Append one frame under the exposure's number and time; returns its file.

        Raises OSError when the disk refuses.
        """
        name = f"{frame.camera}/{sequence:06d}.png"
        done, data = cv2.imencode(".png", np.asarray(frame.pixels), [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not done:
            raise OSError(f"{name} cannot be encoded")
        at = ("", "") if position_mm is None else tuple(f"{value:.4f}" for value in position_mm)
        try:
            (self._path / name).write_bytes(data.tobytes())
            self._append((sequence, f"{t_s:.6f}", frame.camera, name, "on" if frame.leds_on else "off", *at))
        except OSError:  # a full disk: half a frame is no part of the recording
            (self._path / name).unlink(missing_ok=True)
            raise
        return self._path / name

    def synced(self) -> int:
        """Bring the table to the disk; its length so far, bytes."""
        os.fsync(self._file.fileno())
        return os.fstat(self._file.fileno()).st_size

    def close(self) -> None:
        """Finish; harmless when done twice."""
        self._file.close()
