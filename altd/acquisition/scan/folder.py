"""The folder of an unfinished scan: its committed contents are complete and list the finished nodes.

It is named DIR.unfinished and renamed to DIR at the end, so a partial scan cannot be mistaken for a complete
one. After each node, or every 64 nodes of a flat, ``scan.json`` is replaced; it has the committed length of
the table. Data beyond that length, left by an interruption, is cut off when the scan is resumed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from altd.acquisition.scan.plan import Facts, Raster
from altd.config import Scan
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import read_file, read_head
from altd.files.writing import replace_file
from altd.measuring.pairing import Pair
from altd.ports import Camera
from altd.recording.header import (
    FRAMES_FILE,
    MADE_BY,
    RecordingHeader,
    SelfCheckHeader,
    TargetHeader,
    UnitHeader,
    camera_header,
)
from altd.recording.reader import open_recording
from altd.recording.writer import RecordingWriter, refuse_used_folder
from altd.records import Frame

STATE_FILE = "scan.json"
FPS = 20.0

_MAX_STATE_BYTES = 1 << 24

SpotPx = tuple[float, float]


class DoneNode(BaseModel):
    """A node whose frames are kept: the position of the stage, and the mean spot per camera, px.

    A node in the margin of a flat may have no spots.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    position_mm: tuple[float, float]
    spots_px: dict[str, SpotPx]


class State(BaseModel):
    """Content of ``scan.json``."""

    model_config = ConfigDict(allow_inf_nan=False)

    format: Literal["altd-scan/1"] = "altd-scan/1"
    facts: Facts
    start: datetime | None = None
    table_bytes: int = 0
    exposures: int = 0
    last_t_s: float = 0.0
    led_pairs: list[Literal["before", "after"]] = []
    self_check: SelfCheckHeader | None = None
    nodes: dict[str, DoneNode] = {}
    refused: dict[str, str] = {}


class ScanFolder:
    """The folder of a scan. Raises BadInputError if a scan can neither start nor be resumed there."""

    def __init__(
        self,
        output: Path,
        facts: Facts,
        utc: Callable[[int], datetime | None],
        cameras: Sequence[Camera] = (),
        targets: tuple[TargetHeader, ...] | None = None,
        scan: Scan | None = None,
    ) -> None:
        self._output = output.resolve()
        self.path = self._output.with_name(f"{self._output.name}.unfinished")
        self._utc = utc
        self._cameras = {camera.name: camera for camera in cameras}
        self._targets = targets
        self._scan = scan or Scan()
        self._writer: RecordingWriter | None = None
        self._first_ns: int | None = None
        self._first_s = 0.0
        refuse_used_folder(self._output)
        self.resumed = self.path.exists()
        self.state = self._read(facts) if self.resumed else State(facts=facts)

    def _read(self, facts: Facts) -> State:
        file = self.path / STATE_FILE
        try:
            state = State.model_validate(parse_json(read_file(file, _MAX_STATE_BYTES)))
        except BadInputError as error:
            raise BadInputError(file, f"{error.message}; remove the folder to scan again") from error
        except ValueError as error:  # also pydantic's
            raise BadInputError(file, "is not a record of a scan; remove the folder to scan again") from error
        for key in sorted({*state.facts, *facts}):
            then, now = state.facts.get(key), facts.get(key)
            if then != now:
                raise BadInputError(
                    self.path,
                    f"was begun with {key} = {_shown(then)}, now it is {_shown(now)}: "
                    "set it back, or remove the folder to scan again",
                )
        self._check_frames(state)
        return state

    def _check_frames(self, state: State) -> None:
        """Cut off uncommitted data, and check every committed frame."""
        table = self.path / FRAMES_FILE
        read_head(table, 1)  # raises an error that names the table if it is not a regular file
        try:
            os.truncate(table, state.table_bytes)
        except OSError as error:
            raise BadInputError(table, error.strerror or "cannot be written") from error
        if state.exposures:
            open_recording(self.path)

    def keep(
        self,
        frame_sets: Sequence[Pair[Frame]],
        unit: UnitHeader,
        note: str,
        position_mm: tuple[float, float] | None,
    ) -> None:
        """Write frame sets; the next ``commit`` makes them part of the scan. Raises OSError if that fails."""
        writer = self._writer or self._open(frame_sets, unit, note)
        for pair in frame_sets:
            t_s = self._t_s(pair.t_ns)
            for frame in pair.items.values():
                with writer.write(frame, self.state.exposures, t_s, position_mm).open("rb") as file:
                    os.fsync(file.fileno())
            self.state.exposures += 1
            self.state.last_t_s = t_s

    def commit(self) -> None:
        """Make the written frame sets part of the scan; raises OSError."""
        if self._writer is not None:
            self.state.table_bytes = self._writer.synced()
            state = self.state.model_dump_json(indent=1, exclude_none=True) + "\n"
            replace_file(self.path / STATE_FILE, state.encode())

    def finish(self) -> None:
        """Close the folder and rename it to its final name; raises OSError."""
        self.commit()
        self.close()
        self.path.replace(self._output)

    def close(self) -> None:
        """Close the recording; harmless if called twice."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _open(self, frame_sets: Sequence[Pair[Frame]], unit: UnitHeader, note: str) -> RecordingWriter:
        state = self.state
        start = self._utc(frame_sets[0].t_ns)
        frames = {name: frame for pair in frame_sets for name, frame in pair.items.items()}
        header = RecordingHeader(
            format="altd-recording/1",
            kind="flat" if isinstance(self._scan, Raster) else "scan",
            fps=FPS,
            cameras={name: camera_header(frame, self._cameras.get(name)) for name, frame in frames.items()},
            unit=unit,
            targets=self._targets,
            self_check=state.self_check,
            turned_deg=self._scan.turned_deg,
            seat_mm_per_m=self._scan.seat_mm_per_m,
            deflection_yaw_deg=self._scan.deflection_yaw_deg,
            deflection_pitch_deg=self._scan.deflection_pitch_deg,
            deflection_sigma_deg=self._scan.deflection_sigma_deg,
            limits=self._scan.limits.record,
            temperature_c=self._scan.temperature_c,
            note=note,
            made_by=MADE_BY,
            start=start,
        )
        self._first_ns = frame_sets[0].t_ns
        if state.table_bytes:
            self._writer = RecordingWriter(self.path, header, state.table_bytes)
            # the pause, if both start times are known
            paused_s = (start - state.start).total_seconds() if start and state.start else 0.0
            self._first_s = max(paused_s, state.last_t_s + 1 / FPS)
        else:
            self._writer = RecordingWriter(self.path, header)
            state.start = start
            self.commit()
        return self._writer

    def _t_s(self, t_ns: int) -> float:
        assert self._first_ns is not None  # noqa: S101  set with the writer
        return max(self._first_s + (t_ns - self._first_ns) * 1e-9, self.state.last_t_s)


def _shown(value: object) -> str:
    return "not set" if value is None else json.dumps(value)
