"""Writes altd-recording/1 folders: recording.json, frames.csv, one PNG for each frame."""

import csv
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import cv2

from altd.errors import BadInputError
from hw_sim.beam import BeamPose
from hw_sim.lens import HEIGHT_PX, WIDTH_PX
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit

COLUMNS = ("sequence", "t_s", "camera", "file", "leds", "x_mm", "y_mm")

STORED = (cv2.IMWRITE_PNG_COMPRESSION, 0, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
"""PNG without compression: three times the size, a tenth of the time to write and to read."""

Progress = Callable[[int, int], None]
"""Called after each frame set with the number made and the number planned."""


class Recorder:
    """Exposes both cameras of a unit at its rate and writes the frames."""

    def __init__(
        self,
        folder: Path,
        table: TextIO,
        unit: Unit,
        planned: int,
        progress: Progress,
        png: Sequence[int] = STORED,
    ) -> None:
        self._folder = folder
        self._png = png
        self._table = csv.writer(table, lineterminator="\n")
        self._table.writerow(COLUMNS)
        self._unit = unit
        self._planned = planned
        self._progress = progress
        self._sequence = 0

    @property
    def t_ns(self) -> int:
        """Middle of the next frame set's exposure."""
        return self._sequence * self._unit.config.period_ns

    def expose(
        self,
        pose: BeamPose,
        *,
        leds_on: bool = False,
        stage_mm: tuple[float, float] | None = None,
        even_mw_per_mm2: float = 0.0,
        cameras: tuple[str, ...] = CAMERAS,
    ) -> None:
        """Record one frame of each camera, exposed at the same time; ``stage_mm`` is the stage's position.

        With even light on the targets, for a flat field, the row has ``leds`` on.
        """
        self._unit.place(pose)
        self._unit.leds_on = leds_on
        self._unit.even_mw_per_mm2 = even_mw_per_mm2
        at = ("", "") if stage_mm is None else tuple(f"{value:.4f}" for value in stage_mm)
        for camera in cameras:
            if self._unit.is_silent(camera) or self._unit.drops(camera, self._sequence):
                continue
            t_ns = self.t_ns + self._unit.lag_ns(camera)
            frame = self._unit.expose(camera, self._sequence, t_ns, exact=True)
            file = f"{camera}/{self._sequence:06d}.png"
            (self._folder / file).write_bytes(cv2.imencode(".png", frame.pixels, self._png)[1].tobytes())
            leds = "on" if frame.leds_on or even_mw_per_mm2 > 0.0 else "off"
            self._table.writerow((self._sequence, f"{t_ns * 1e-9:.6f}", camera, file, leds, *at))
        self._sequence += 1
        self._progress(self._sequence, self._planned)


@contextmanager
def recording(
    folder: Path,
    unit: Unit,
    kind: str,
    planned: int,
    progress: Progress,
    extra_header: Mapping[str, object] | None = None,
) -> Iterator[Recorder]:
    """Yield a recorder whose frames become the recording ``folder`` at the end, or nothing after an error.

    ``extra_header`` adds to the header or replaces its entries.

    Raises BadInputError if the folder is not empty or cannot be made.
    """
    folder = folder.resolve()
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise BadInputError(folder, "exists and is not an empty folder")
    draft = folder.with_name(f".{folder.name}.{os.getpid()}.draft")
    try:
        for camera in CAMERAS:
            (draft / camera).mkdir(parents=True)
        with (draft / "frames.csv").open("w", newline="") as table:
            png = () if kind == "flat" else STORED  # a flat made with the laser has thousands of frames
            yield Recorder(draft, table, unit, planned, progress, png)
        (draft / "recording.json").write_text(
            json.dumps({**_header(unit, kind), **(extra_header or {})}, indent=1) + "\n"
        )
        draft.replace(folder)
    except OSError as error:
        raise BadInputError(folder, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _header(unit: Unit, kind: str) -> dict[str, object]:
    config = unit.config
    note = f"hw_sim, seed {config.seed}"
    if unit.faults:
        note += f", faults {', '.join(sorted(unit.faults))}"
    size = {"width": WIDTH_PX, "height": HEIGHT_PX, "bits": config.bits, "origin": "simulated"}
    glass = {"glass_mm": config.glass_mm, "glass_index": config.glass_index}
    targets = [
        {"name": FRONT, "z_mm": 0.0, "camera": FRONT, **glass},
        {"name": REAR, "z_mm": config.target_distance_mm, "camera": REAR},
    ]
    return {
        "format": "altd-recording/1",
        "kind": kind,
        "fps": config.fps,
        "cameras": dict.fromkeys(CAMERAS, size),
        "unit": {"serial": config.serial, "target_distance_mm": config.target_distance_mm},
        "note": note,
        "targets": targets,
    }
