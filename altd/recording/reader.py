"""Reading a recording: header and rows checked, frames decoded one by one, and missing rows listed.

A recording of a live unit may have lost frames, so gaps are reported but not refused. Measurements of such an
exposure have a reason (``camera_silent``, ``out_of_step``, ``exposures_lost``).
"""

from __future__ import annotations

import hashlib
import heapq
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

from altd.errors import BadInputError, did_you_mean
from altd.files.picture import PNG_HEAD_BYTES, check_png_head, decode_png, png_bytes
from altd.files.reading import read_file, read_head
from altd.recording.frames_table import FrameLine, Rows
from altd.recording.header import FRAMES_FILE, HEADER_FILE, MAX_HEADER_BYTES, RecordingHeader, read_header
from altd.records import Frame, counted

_MAX_FILE_BYTES = 1 << 28


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording whose header, rows and frame sizes have been checked."""

    path: Path
    header: RecordingHeader
    rows: Rows

    def frame(self, row: FrameLine) -> Frame:
        """Decode the frame of a row; raises BadInputError with the file and the row."""
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
        return Frame(
            *(row.camera, row.sequence, t_ns, pixels, camera.bits, row.leds_on),
            *(camera.exposure_ms, camera.gain_db),
            opaque=row.opaque,
            row_time_us=camera.row_time_us or 0.0,
        )

    def sha256(self) -> str:
        """Return the hash over header, rows and all frame files, in the rows' order."""
        digest = hashlib.sha256(read_file(self.path / HEADER_FILE, MAX_HEADER_BYTES))
        for piece in self.rows.table.pieces():
            digest.update(piece)
        for row in self.rows:
            digest.update(read_file(self.path / row.file, _MAX_FILE_BYTES))
        return digest.hexdigest()


def open_recording(path: Path) -> Recording:
    """Read header and rows and check every frame's file, size and depth without decoding it.

    Raises BadInputError with the file and, in ``frames.csv``, the row (the first frame is row 2).
    """
    if os.path.lexists(path) and not os.path.lexists(path / HEADER_FILE):
        lacks = f"it has no {HEADER_FILE}" if path.is_dir() else "a recording is a folder"
        raise BadInputError(path, f"is not a recording: {lacks}")
    header = read_header(path / HEADER_FILE)
    table = path / FRAMES_FILE
    return Recording(path, header, Rows.checked(table, header.cameras, partial(_check_row, path, header)))


def _check_row(path: Path, header: RecordingHeader, row: FrameLine) -> None:
    """Check the name of a switched target, and the frame's file."""
    names = [target.name for target in header.shown_targets]
    if row.opaque and row.opaque not in names:
        known = f"is not a target of recording.json{did_you_mean(row.opaque, names)}"
        raise BadInputError(f"{path / FRAMES_FILE}: row {row.number}", f"opaque {row.opaque!r} {known}")
    _check_png(path, header, row)


def _check_png(path: Path, header: RecordingHeader, row: FrameLine) -> None:
    """Check signature, size, depth and colour, without decoding the frame."""
    camera, place = header.cameras[row.camera], f"{path / FRAMES_FILE}: row {row.number}"
    try:
        head = read_head(path / row.file, PNG_HEAD_BYTES)
        check_png_head(head, camera.width, camera.height, camera.bits)
    except ValueError as error:
        raise BadInputError(place, f"{row.file} {error}") from error
    except BadInputError as error:
        raise BadInputError(place, f"{row.file}: {error.message}") from error


_MAX_NAMED = 3
"""Maximum number of places that are named; the others are counted."""


@dataclass(slots=True)
class Gap:
    """Exposures from ``first`` to ``last`` that lack all frames, or those of ``cameras``.

    ``row`` is that of the exposures' first frame, or the next one if there is none.
    """

    row: int
    first: int
    last: int
    cameras: tuple[str, ...]

    def __str__(self) -> str:
        is_one = self.first == self.last
        which = f"sequence {self.first}" if is_one else f"sequences {self.first} to {self.last}"
        if not self.cameras:
            return f"row {self.row}: before it {which} {'is' if is_one else 'are'} missing"
        cameras = " and ".join(map(repr, self.cameras))
        return f"row {self.row}: {which} {'has' if is_one else 'have'} no row of camera {cameras}"


def gaps(rows: Iterable[FrameLine], cameras: Sequence[str]) -> Iterator[Gap]:
    """Yield the gaps of a table in the order of its sequences; ``rows`` is read once per camera, in step.

    A camera without any row is left to the caller: it is one fault, not one per exposure.
    """
    by_camera = [_of(camera, rows) for camera in cameras]
    gap: Gap | None = None
    expected: int | None = None
    for sequence, group in groupby(
        heapq.merge(*by_camera, key=lambda row: row.sequence), key=lambda row: row.sequence
    ):
        there = list(group)
        row = min(row.number for row in there)
        if expected is not None and sequence > expected:
            if gap is not None:
                yield gap
                gap = None
            yield Gap(row, expected, sequence - 1, ())
        expected = sequence + 1
        lacking = tuple(camera for camera in cameras if camera not in {row.camera for row in there})
        if gap is not None and gap.cameras == lacking:
            gap.last = sequence
            continue
        if gap is not None:
            yield gap
        gap = Gap(row, sequence, sequence, lacking) if lacking else None
    if gap is not None:
        yield gap


def gap_lines(recording: Recording) -> list[str]:
    """Return the missing rows of a table: one line for each of the first places, one for the others."""
    table = recording.path / FRAMES_FILE
    cameras = list(recording.header.cameras)
    empty = [camera for camera in cameras if not recording.rows.count[camera]]
    lines = [f"{table}: no row of camera {camera!r}" for camera in empty]
    more = exposures = 0
    for number, gap in enumerate(gaps(recording.rows, [name for name in cameras if name not in empty])):
        exposures += gap.last - gap.first + 1
        if number < _MAX_NAMED:
            lines.append(f"{table}: {gap}")
        else:
            more += 1
    if more:
        lines.append(
            f"{table}: {counted(more, 'more such place')}; {exposures} exposures lack a frame in all"
        )
    return lines


def _of(camera: str, rows: Iterable[FrameLine]) -> Iterator[FrameLine]:
    return (row for row in rows if row.camera == camera)
