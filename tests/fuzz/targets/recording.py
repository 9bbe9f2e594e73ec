"""Folders that might be recordings: their header, their table, their frames."""

import json
import math
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Any

import cv2
import numpy as np
from fuzz.folder import folder, one_line
from fuzz.pngs import spoilt_png
from fuzz.spoil import SCRAPS, spoilt_bytes, spoilt_document
from hypothesis import strategies as st

from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import open_recording

NAME = "recording"

WIDTH, HEIGHT = 64, 48
CAMERA = {"width": WIDTH, "height": HEIGHT, "bits": 8}
HEADER: dict[str, Any] = {
    "format": "altd-recording/1",
    "kind": "plate",
    "fps": 20.0,
    "cameras": {"front": CAMERA, "rear": {**CAMERA, "bits": 12, "mirrored": True}},
    "unit": {"serial": "A-1", "target_distance_mm": 280.0},
    "note": "made by a test",
    "self_check": {"verdict": "suspect", "reasons": ["rear: it moved"], "notes": []},
    "start": "2026-11-20T08:15:30Z",
    "targets": [
        {"name": "front", "z_mm": 0.0, "camera": "front"},
        {"name": "exit", "z_mm": 280.0, "camera": "rear"},
    ],
    "plate": {"columns": 8, "rows": 6, "pitch_mm": 15.0, "origin_mm": [-52.5, -37.5], "disc_mm": 3.0},
}
TABLE = "".join(
    (
        "sequence,t_s,camera,file,leds,x_mm,y_mm,remark\n",
        *(f"{n},{n / 20:.6f},{name},{name}.png,{led},{at}\n"
          for n, led, at in ((0, "off", ",,"), (1, "on", "1.5,-2.5,\"a, b\""))
          for name in ("front", "rear")),
    )
).encode()  # fmt: skip
PIXELS = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
FRAMES = tuple(
    cv2.imencode(".png", PIXELS.astype(depth) * scale)[1].tobytes()
    for depth, scale in ((np.uint8, 1), (np.uint16, 16))
)
_LONG_CELLS = b"," * 100_000, b'"' + b"x" * 200_000
SCRAPS_OF_CSV = (*SCRAPS, *_LONG_CELLS, b"1e300", b"../", b"/dev/zero", b"front.png\0", TABLE)


@dataclass(frozen=True)
class Folder:
    """The contents of the three kinds of files."""

    header: bytes
    table: bytes
    front: bytes


EXAMPLES = st.builds(
    Folder,
    st.one_of(
        spoilt_document(st.just(HEADER)).map(lambda document: json.dumps(document).encode()),
        spoilt_bytes(st.just(json.dumps(HEADER).encode())),
    ),
    spoilt_bytes(st.just(TABLE), SCRAPS_OF_CSV),
    st.just(FRAMES[0]) | spoilt_png(st.sampled_from(FRAMES)),
)


def check(example: Folder) -> None:
    """Each frame is one of the header's size, at a finite time, or refused."""
    path = folder(NAME)
    (path / "recording.json").write_bytes(example.header)
    (path / "frames.csv").write_bytes(example.table)
    (path / "front.png").write_bytes(example.front)
    (path / "rear.png").write_bytes(FRAMES[1])
    try:
        recording = open_recording(path)
        recording.sha256()
        assert math.isfinite(1 / recording.header.fps)
        shown = recording.header.shown_targets
        assert {target.camera for target in shown} <= set(recording.header.cameras)
        names, cameras = ({target.name for target in shown}, {target.camera for target in shown})
        assert len(names) == len(cameras) == len(shown)
        assert all(after.z_mm > before.z_mm for before, after in pairwise(shown))
        if shown and recording.header.kind in ("scan", "plate"):
            assert [frames.name for frames in target_frames([recording])] == [of.name for of in shown]
        for row in islice(recording.rows, 8):
            frame = recording.frame(row)
            camera = recording.header.cameras[row.camera]
            assert frame.pixels.shape == (camera.height, camera.width)
            assert frame.pixels.dtype == (np.uint8 if camera.bits == 8 else np.uint16)
            assert all(map(math.isfinite, row.position_mm or ()))
            assert abs(frame.t_ns) < 2**63
    except BadInputError as error:
        one_line(error)
