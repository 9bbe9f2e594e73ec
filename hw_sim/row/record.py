"""Recordings of a row: a scan of each target, and monitoring in rounds."""

import csv
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.records import PixelArray
from hw_sim.recording import STORED
from hw_sim.row.row import FPS, HEIGHT_PX, WIDTH_PX, Row, at_rest
from hw_sim.stage import STAGE_SIGMA_MM

COLUMNS = ("sequence", "t_s", "camera", "file", "leds", "x_mm", "y_mm", "opaque")
SETTLE_S = 0.5
"""Time from switching a glass to its first exposure: eight time constants."""


class _Recorder:
    """Writes rows and frames, and counts the time."""

    def __init__(self, folder: Path, row: Row, kind: str, targets: Sequence[str], note: str) -> None:
        if folder.exists() and any(folder.iterdir()):
            raise BadInputError(folder, "exists and is not an empty folder")
        self.folder, self.row = folder, row
        self.sequence, self.t_s = 0, 0.0
        for name in targets:
            (folder / name).mkdir(parents=True)
        config = row.config
        camera = {"width": WIDTH_PX, "height": HEIGHT_PX, "bits": 8, "origin": "simulated"}
        header = {
            "format": "altd-recording/1",
            "kind": kind,
            "fps": FPS,
            "cameras": {name: camera | {"serial": f"{config.serial}-{name}"} for name in targets},
            "unit": {"serial": config.serial},
            "targets": [
                {"name": name, "z_mm": z_mm, "camera": name}
                for name, z_mm in zip(config.names, config.z_mm, strict=True)
                if name in targets
            ],
            "note": note,
        }
        if kind == "scan":
            header["limits"] = {"stage_mm": STAGE_SIGMA_MM}
        (folder / "recording.json").write_text(json.dumps(header, indent=1) + "\n")
        self._file = (folder / "frames.csv").open("w", newline="")
        self._table = csv.writer(self._file, lineterminator="\n")
        self._table.writerow(COLUMNS)

    def write(self, camera: str, pixels: PixelArray, at: tuple[object, object], opaque: str) -> None:
        """Write one frame of the current exposure."""
        file = f"{camera}/{self.sequence:06d}.png"
        png = cv2.imencode(".png", np.asarray(pixels), STORED)[1]
        (self.folder / file).write_bytes(png.tobytes())
        self._table.writerow((self.sequence, f"{self.t_s:.6f}", camera, file, "off", *at, opaque))

    def advance(self, s: float = 1.0 / FPS) -> None:
        """Proceed to the next exposure."""
        self.sequence += 1
        self.t_s += s

    def close(self) -> None:
        """Close the table."""
        self._file.close()


@contextmanager
def _recorder(folder: Path, row: Row, kind: str, targets: Sequence[str], note: str) -> Iterator[_Recorder]:
    recorder = _Recorder(folder, row, kind, targets, note)
    try:
        yield recorder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        recorder.close()


def record_scans(folder: Path, row: Row) -> list[Path]:
    """Record a scan of each target, 7 × 5 nodes of two exposures on 72 × 48 mm; folders in beam order."""
    rng = np.random.default_rng([row.config.seed, 28])
    paths = []
    for name in row.config.names:
        path = folder / f"scan-{name}"
        with _recorder(path, row, "scan", (name,), f"hw_sim chain, seed {row.config.seed}") as recorder:
            for y_mm in np.linspace(-24.0, 24.0, 5).tolist():
                for x_mm in np.linspace(-36.0, 36.0, 7).tolist():
                    error_mm = rng.normal(0.0, STAGE_SIGMA_MM, 2)
                    spot_mm = (x_mm + float(error_mm[0]), y_mm + float(error_mm[1]))
                    for _ in range(2):
                        pixels = row.picture(name, spot_mm, 1.0)
                        recorder.write(name, pixels, (f"{x_mm:.4f}", f"{y_mm:.4f}"), "")
                        recorder.advance()
        paths.append(path)
    return paths


def record_rounds(  # noqa: PLR0913  the timing of a round
    folder: Path,
    row: Row,
    rounds: int,
    exposures: int = 4,
    pause_s: float = 0.0,
    settle_s: float = SETTLE_S,
    own_only: bool = False,
) -> dict[str, list[dict[str, tuple[float, float]]]]:
    """Record ``rounds`` visits of all targets, with frames of all cameras in every exposure.

    ``own_only``: frames of the opaque target's camera alone. Returns the truth, round by round: the position
    of the beam on each target (``spot``) and the displacement of its place (``moved``), in the middle of its
    exposures.
    """
    names = row.config.names
    truth: list[dict[str, tuple[float, float]]] = []
    moved: list[dict[str, tuple[float, float]]] = []
    with _recorder(folder, row, "measurement", names, f"hw_sim chain, seed {row.config.seed}") as recorder:
        for _ in range(rounds):
            truth.append({})
            moved.append({})
            for name in names:
                row.switch(name, recorder.t_s)
                recorder.t_s += settle_s
                middle_s = recorder.t_s + (exposures - 1) / 2 / FPS
                truth[-1][name] = row.spot_mm(name, middle_s)
                moved[-1][name] = row.config.places.get(name, at_rest)(middle_s)
                for _exposure in range(exposures):
                    for camera in (name,) if own_only else names:
                        recorder.write(camera, row.expose(camera, recorder.t_s), ("", ""), name)
                    recorder.advance()
            recorder.t_s += pause_s
    return {"spot": truth, "moved": moved}
