"""Files that might be calibrations, with a checksum that fits, so that what is behind it is reached."""

import json
from functools import cache
from typing import Any

import numpy as np
from fuzz.folder import folder, one_line
from fuzz.spoil import spoilt_and_sealed
from support import evidence

from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.settings import ShapeReference, SpotReference
from altd.vision.texture import Texture

NAME = "calibration"


@cache
def _valid() -> dict[str, Any]:
    path = folder(NAME) / "valid.json"
    rear = evidence.replace(
        evidence.target("rear"),
        flat=Flat(np.full((480, 752), 200, np.uint8), "recording"),
        spot=SpotReference(0.02, 1.5, 0.03, 0.02, ShapeReference((1.8, 0.0, 0.1, 2.0), (0.1,) * 4)),
    )
    fingerprint = Fingerprint(
        HotPixels(places_of([(3, 4), (700, 400)]), places_of([(20, 30)])),
        Texture(np.zeros((480, 752), np.float32)),
        "scan",
    )
    rear = evidence.replace(rear, fingerprint=fingerprint)
    save_calibration(evidence.calibration(evidence.target("front"), rear), path)
    document: dict[str, Any] = json.loads(path.read_bytes())
    del document["checksum"]
    return document


EXAMPLES = spoilt_and_sealed(_valid)


def check(example: bytes) -> None:
    """A calibration that is taken gives places on its targets with finite sigmas, or none."""
    path = folder(NAME) / "cal.json"
    path.write_bytes(example)
    try:
        calibration = load_calibration(path)
    except BadInputError as error:
        one_line(error)
        return
    for target in calibration.targets:
        for u_px, v_px in ((375.0, 240.0), (100.0, 80.0), (0.0, 0.0), (751.0, 479.0), (1e9, -1e9)):
            point = target.point(u_px, v_px)
            if point is not None:
                assert np.isfinite([point.x_mm, point.y_mm]).all()
                assert np.isfinite(point.covariance_mm2).all()
                assert point.covariance_mm2[0, 0] > 0
                assert point.covariance_mm2[1, 1] > 0
                assert np.isfinite(point.jacobian_mm_per_px).all()
                target.cross_checked(point, u_px, v_px)
