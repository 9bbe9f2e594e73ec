"""Small recordings with known truth, written here and not by altd."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hw_sim.recording import STORED
from support.frames import HEIGHT, WIDTH, Blob, light

PX_PER_MM = 4.0


def place_px(target: str, x_mm: float, y_mm: float) -> tuple[float, float]:
    """A smooth, slightly curved map; the front camera sees a mirrored picture."""
    mirror = -1 if target == "front" else 1
    bend = 1 + 4e-6 * (x_mm**2 + y_mm**2)
    return 375 + mirror * PX_PER_MM * x_mm * bend, 240 - PX_PER_MM * 0.95 * y_mm * bend


def picture(target: str, x_mm: float, y_mm: float, rng: np.random.Generator) -> np.ndarray:
    u, v = place_px(target, x_mm, y_mm)
    counts = light(Blob(u, v, 40.0)) + 8 + rng.normal(0, 1.5, (HEIGHT, WIDTH))
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def header(kind: str, serial: str = "TEST-1", **more: object) -> dict[str, object]:
    """Of front and rear; ``more`` replaces keys."""
    size = {"width": WIDTH, "height": HEIGHT, "bits": 8}
    return {
        "format": "altd-recording/1",
        "kind": kind,
        "fps": 20.0,
        "cameras": {"front": size, "rear": size},
        "unit": {"serial": serial, "target_distance_mm": 280.0},
        "note": "written by a test",
        "colour": "unknown keys are ignored",
        **more,
    }


Shot = tuple[tuple[float, float] | None, tuple[float, float] | None, tuple[float, float] | None]
"""Front and rear spot in mm (None: dark), and the stage's position."""


def write(
    path: Path,
    kind: str,
    shots: Iterable[Shot],
    serial: str = "TEST-1",
    fps: float = 20.0,
    picture: Callable[[str, float, float, np.random.Generator], np.ndarray] = picture,
    **more: object,
) -> Path:
    rng = np.random.default_rng(0)
    path.mkdir(parents=True)
    (path / "recording.json").write_text(json.dumps(header(kind, serial, fps=fps, **more)))
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm,remark"]
    for sequence, (front, rear, stage) in enumerate(shots):
        for target, spot in (("front", front), ("rear", rear)):
            name = f"{target}{sequence:04d}.png"
            image = np.full((HEIGHT, WIDTH), 8, np.uint8) if spot is None else picture(target, *spot, rng)
            cv2.imwrite(str(path / name), image, STORED)
            x, y = stage or ("", "")
            rows.append(f"{sequence},{sequence / fps:.6f},{target},{name},off,{x},{y},")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def write_scan(path: Path, serial: str = "TEST-1", columns: int = 6, rows: int = 5, **more: Any) -> Path:
    return write(path, "scan", [(p, p, p) for p in grid(columns, rows)], serial, **more)


def write_beams(
    path: Path, beams: Iterable[tuple[float, float, float, float]], exposures: int = 4, fps: float = 20.0
) -> Path:
    """A measurement recording of beams (x, y, slope x, slope y)."""
    shots: list[Shot] = []
    for x, y, sx, sy in beams:
        shots += [((x, y), (x + 280 * sx, y + 280 * sy), None)] * exposures
    return write(path, "measurement", shots, fps=fps)


Spots = Mapping[str, tuple[float, float] | None]
"""The place of the beam on each target, mm; None: dark."""


def seen(name: str, z_mm: float, camera: str) -> dict[str, object]:
    """A target as a header names it."""
    return {"name": name, "z_mm": z_mm, "camera": camera}


def write_targets(
    path: Path,
    kind: str,
    targets: Sequence[Mapping[str, object]],
    shots: Iterable[tuple[Spots, tuple[float, float] | None]],
    serial: str = "TEST-1",
    of_cameras: Mapping[str, object] | None = None,
    seed: int = 0,
    **more: object,
) -> Path:
    """A recording whose header says which ``targets`` it shows; each shot has the stage's position.

    ``of_cameras`` is in every camera's entry.
    """
    rng = np.random.default_rng(seed)
    path.mkdir(parents=True)
    size = {"width": WIDTH, "height": HEIGHT, "bits": 8, **(of_cameras or {})}
    about = header(kind, unit={"serial": serial}, targets=list(targets))
    about |= {"cameras": {str(target["camera"]): size for target in targets}} | more
    (path / "recording.json").write_text(json.dumps(about))
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for sequence, (spots, stage) in enumerate(shots):
        for target in targets:
            name, spot = f"{target['camera']}{sequence:04d}.png", spots[str(target["name"])]
            dark = np.full((HEIGHT, WIDTH), 8, np.uint8)
            image = dark if spot is None else picture(str(target["name"]), *spot, rng)
            cv2.imwrite(str(path / name), image, STORED)
            x, y = stage or ("", "")
            rows.append(f"{sequence},{sequence / 20:.6f},{target['camera']},{name},off,{x},{y}")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def grid(columns: int = 5, rows: int = 4, pitch_mm: float = 25.0) -> list[tuple[float, float]]:
    """The nodes of a scan about the middle."""
    return [
        (pitch_mm * (i - (columns - 1) / 2), pitch_mm * (j - (rows - 1) / 2))
        for j in range(rows)
        for i in range(columns)
    ]


def write_scan_of(path: Path, *targets: Mapping[str, object], exposures: int = 1, **more: Any) -> Path:
    """A scan of these targets on ``grid``; the spots are where the stage is."""
    names = [str(target["name"]) for target in targets]
    shots = [(dict.fromkeys(names, place), place) for place in grid() for _ in range(exposures)]
    return write_targets(path, "scan", targets, shots, **more)


def quiet(_done: int, _planned: int) -> None:
    """No progress."""
