"""Small recordings with known truth, written here and not by altd."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

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


def write(path: Path, kind: str, shots: Iterable[Shot], serial: str = "TEST-1", **more: object) -> Path:
    rng = np.random.default_rng(0)
    path.mkdir(parents=True)
    (path / "recording.json").write_text(json.dumps(header(kind, serial, **more)))
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm,remark"]
    for sequence, (front, rear, stage) in enumerate(shots):
        for target, spot in (("front", front), ("rear", rear)):
            name = f"{target}{sequence:04d}.png"
            image = np.full((HEIGHT, WIDTH), 8, np.uint8) if spot is None else picture(target, *spot, rng)
            cv2.imwrite(str(path / name), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            x, y = stage or ("", "")
            rows.append(f"{sequence},{sequence / 20:.6f},{target},{name},off,{x},{y},")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def write_scan(path: Path, serial: str = "TEST-1", columns: int = 6, rows: int = 5) -> Path:
    places = [
        (25.0 * (i - (columns - 1) / 2), 25.0 * (j - (rows - 1) / 2))
        for j in range(rows)
        for i in range(columns)
    ]
    return write(path, "scan", [(p, p, p) for p in places], serial)


def write_beams(path: Path, beams: Iterable[tuple[float, float, float, float]], exposures: int = 4) -> Path:
    """A measurement recording of beams (x, y, slope x, slope y)."""
    shots: list[Shot] = []
    for x, y, sx, sy in beams:
        shots += [((x, y), (x + 280 * sx, y + 280 * sy), None)] * exposures
    return write(path, "measurement", shots)
