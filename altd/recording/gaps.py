"""Rows that a recording's table lacks: an exposure that not every camera has, numbers that leap.

A recording of a live unit may have lost frames, so this is reported and no reason to refuse it; measurements
of such an exposure carry a reason (``camera_silent``, ``out_of_step``, ``exposures_lost``).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from altd.recording.frames_table import Row
from altd.recording.header import FRAMES_FILE
from altd.recording.reader import Recording
from altd.records import counted

_MAX_NAMED = 3
"""So many places are named, the others counted."""


@dataclass(slots=True)
class Gap:
    """Exposures that lack something, from one number to another: all frames, or those of ``cameras``.

    ``row`` is that of the exposures' first frame, or the one that follows where there is none.
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


def gaps(rows: Iterable[Row], cameras: Sequence[str]) -> Iterator[Gap]:
    """The gaps of a table in the order of its numbers; ``rows`` is gone through once a camera, in step.

    A camera without any row is left to the caller: it is one fault, not one an exposure.
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
    """The missing rows of a table, a line each for the first places and one for the others."""
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


def _of(camera: str, rows: Iterable[Row]) -> Iterator[Row]:
    return (row for row in rows if row.camera == camera)
