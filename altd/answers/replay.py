"""``altd replay``: measurements as lines on standard output, as a table in a file, or as a drawing."""

from __future__ import annotations

import importlib
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from altd import __version__
from altd.answers.history import Drawn, PlotHistory
from altd.app.planar_replay import PlanarReplay, planar_replay_of
from altd.app.replay import Replay, replay_of
from altd.app.row_replay import RowReplay, open_row_replay
from altd.app.settings import load_settings
from altd.errors import BadInputError
from altd.files.documents import line_of
from altd.files.writing import check_replaceable, replacing
from altd.recording.header import FRAMES_FILE, HEADER_FILE
from altd.recording.reader import gap_lines, open_recording
from altd.records import counted, utc_text
from altd.tables import Format, check_parquet, flat_row, measurement_columns, table_in, text_output

Add = Callable[[Mapping[str, Any]], object]
"""Receives a measurement's object."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of ``altd replay``; ``output`` None: standard output.

    ``config`` defines which targets of a row of switched targets are stable.
    """

    recording: Path
    calibration: Path
    window: int | None
    every: int | None
    form: Format
    output: Path | None
    plot: Path | None
    config: Path | None = None


def answer(
    question: ReplayOptions, warn: Callable[[str], object], progress: Callable[[int, int], None]
) -> None:
    """Measure, and write the requested output.

    ``warn`` receives what the recording lacks and, for a scan, the errors against the known positions.
    Raises BadInputError; a file then stays as it was.
    """
    _check(question)
    replay = _open(question)
    for line in gap_lines(replay.recording):
        warn(line)
    history = PlotHistory(_drawn(replay))
    count, differences_mm = 0, list[tuple[float, float]]()
    with _output(question, replay) as add:
        for measurement in replay.measurements(progress):
            document = replay.as_object(measurement)
            add(document)
            count += 1
            if measurement.valid and replay.knows_places:
                differences_mm.append((document["dx_mm"], document["dy_mm"]))
            if question.plot is not None:
                history.add(measurement.light_ns * 1e-9, document)
        if question.plot is not None:
            _draw(question.plot, history, replay)
    if replay.knows_places:
        warn(_summary(count, differences_mm))


AnyReplay = Replay | PlanarReplay | RowReplay


def _open(question: ReplayOptions) -> AnyReplay:
    """Open the replay; the config, or the recording's kind and columns, determine the instrument."""
    recording = open_recording(question.recording)
    if recording.header.kind == "planar":
        return planar_replay_of(recording, question.calibration, question.window, question.every)
    config = None if question.config is None else load_settings(question.config)
    is_row = recording.rows.has_opaque and not recording.header.is_switched
    if is_row if config is None else config.unit.instrument == "chain":
        if question.plot is not None:
            raise BadInputError("--plot", "the places of a row are not drawn; possible: --format csv")
        return open_row_replay(recording, question.calibration, config, question.config)
    return replay_of(recording, question.calibration, question.window, question.every)


def _summary(count: int, differences_mm: list[tuple[float, float]]) -> str:
    """The errors of the valid measurements of a scan against the known positions."""
    text = f"{len(differences_mm)} of {counted(count, 'measurement')} valid"
    if not differences_mm:
        return text
    x, y = (math.hypot(*column) / math.sqrt(len(column)) for column in zip(*differences_mm, strict=True))
    largest = max(math.hypot(*difference) for difference in differences_mm)
    rms = f"rms x {x:.4f} mm, y {y:.4f} mm, largest {largest:.4f} mm"
    return f"{text}; against the known positions: {rms}"


def _check(question: ReplayOptions) -> None:
    if question.form == "parquet":
        check_parquet(question.output)
    if question.plot is not None:
        if question.plot.suffix.lower() != ".svg":
            raise BadInputError(question.plot, "the plot is written as SVG: name it ….svg")
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # on first use it reports its font cache
        try:
            importlib.import_module("matplotlib")
        except ImportError as error:
            raise BadInputError(
                "--plot", "needs matplotlib, which comes with the extra altd[report]"
            ) from error
    read = [question.calibration, *(question.recording / name for name in (HEADER_FILE, FRAMES_FILE))]
    for path in filter(None, (question.output, question.plot)):
        check_replaceable(path)
        for source in read:
            if source.exists() and path.exists() and path.samefile(source):
                raise BadInputError(path, "is the input")
    files = [path.resolve() for path in (question.output, question.plot) if path is not None]
    if len(set(files)) < len(files):
        raise BadInputError(files[0], "is requested twice, as table and as plot")


@contextmanager
def _output(question: ReplayOptions, replay: AnyReplay) -> Iterator[Add]:
    if question.form == "jsonl":
        with text_output(question.output) as write:
            yield lambda document: write(line_of(document) + "\n")
        return
    columns = measurement_columns(replay.quantities, replay.calibration.target_names, replay.knows_places)
    with table_in(question.output, question.form, columns, _about(question, replay)) as add:
        yield lambda document: add(flat_row(document, replay.quantities.joint))


def _about(question: ReplayOptions, replay: AnyReplay) -> dict[str, Any]:
    """The origin of the numbers, for a reader of the table in ten years."""
    header, calibration = replay.recording.header, replay.calibration
    start = None if header.start is None else utc_text(header.start)
    of_recording = header.model_dump(
        mode="json", exclude_none=True, include={"kind", "fps", "note", "made_by"}
    )
    return {
        "made_by": f"altd {__version__}",
        "unit_serial": header.unit.serial,
        "origin": "simulated" if replay.is_simulated else "camera",
        "recording": {**of_recording, "path": str(question.recording), "start": start},
        "cameras": {
            name: camera.model_dump(mode="json", exclude_none=True) for name, camera in header.cameras.items()
        },
        "calibration": {
            "path": str(question.calibration),
            "created": utc_text(calibration.created),
            "recording_note": calibration.recording_note,
            "recording_sha256": calibration.recording_sha256,
            "origin": "simulated" if calibration.simulated else "camera",
        },
        "window": replay.window_text,
    }


def _drawn(replay: AnyReplay) -> dict[str, Drawn]:
    """Quantities to draw, by their keys in a measurement's object; for a scan the errors of x and y."""
    drawn = {}
    for quantity in replay.quantities.main:
        key, label = quantity.key, quantity.label
        if replay.knows_places and key in ("x_mm", "y_mm"):
            key, label = f"d{key}", f"{label} − known {label}"
        drawn[key] = Drawn(f"{label}, {quantity.unit}", quantity.key)
    return drawn


def _draw(place: Path, history: PlotHistory, replay: AnyReplay) -> None:
    from altd.answers.plot import svg

    header = replay.recording.header
    start = "" if header.start is None else f" · {utc_text(header.start)}"
    title = f"Unit {header.unit.serial} · {header.note or header.kind}{start} · {replay.window_text}"
    joined = replay.positions is None or not replay.positions.is_by_node
    content = svg(history, title, replay.is_simulated, joined)
    with replacing(place) as file:
        file.write(content)
