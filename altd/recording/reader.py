"""A recording, read: header and rows checked, frames decoded one by one."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from altd.errors import BadInputError
from altd.files.picture import PNG_HEAD_BYTES, check_png_head, decode_png, png_bytes
from altd.files.reading import read_file, read_head
from altd.recording.frames_table import Row, Rows
from altd.recording.header import FRAMES_FILE, HEADER_FILE, MAX_HEADER_BYTES, RecordingHeader, read_header
from altd.records import Frame

_MAX_FILE_BYTES = 1 << 28


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
        digest = hashlib.sha256(read_file(self.path / HEADER_FILE, MAX_HEADER_BYTES))
        for piece in self.rows.table.pieces():
            digest.update(piece)
        for row in self.rows:
            digest.update(read_file(self.path / row.file, _MAX_FILE_BYTES))
        return digest.hexdigest()


def open_recording(path: Path) -> Recording:
    """Read header and rows and check every frame's file, size and depth without decoding it.

    Raises BadInputError that names the file and, in ``frames.csv``, the row (the first frame is row 2).
    """
    if os.path.lexists(path) and not os.path.lexists(path / HEADER_FILE):
        lacks = f"it has no {HEADER_FILE}" if path.is_dir() else "a recording is a folder"
        raise BadInputError(path, f"is no recording: {lacks}")
    header = read_header(path / HEADER_FILE)
    table = path / FRAMES_FILE
    return Recording(path, header, Rows.checked(table, header.cameras, partial(_check_png, path, header)))


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
