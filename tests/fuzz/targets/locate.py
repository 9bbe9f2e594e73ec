"""Pictures that a person gives to ``altd locate``, in the formats that OpenCV reads."""

import math

import cv2
import numpy as np
from fuzz.folder import folder, one_line
from fuzz.pngs import spoilt_png
from fuzz.spoil import SCRAPS, spoilt_bytes
from hypothesis import strategies as st

from altd.errors import BadInputError
from altd.files.picture import read_picture
from altd.records import Frame, Spot
from altd.vision.localise import locate, locate_ellipse

NAME = "locate"

V, U = np.mgrid[:96, :128]
SPOT = 8 + 200 * np.exp(-2 * ((U - 60.3) ** 2 + (V - 45.7) ** 2) / 18**2)
SPOT += np.random.default_rng(0).normal(0, 1.5, SPOT.shape)
PICTURES = {
    suffix: tuple(
        cv2.imencode(suffix, np.clip(SPOT * scale, 0, 256 * scale - 1).astype(depth))[1].tobytes()
        for depth, scale in ((np.uint8, 1), (np.uint16, 256))[: 1 if suffix in (".jpg", ".bmp") else 2]
    )
    for suffix in (".png", ".pgm", ".tif", ".bmp", ".jpg")
}
SCRAPS_OF_PICTURES = (*SCRAPS, b"P5\n60000 60000\n255\n", b"P5 1 1 65535 ", b"II*\0", b"\xff\xd8\xff\xe0")
EXAMPLES = spoilt_png(st.sampled_from(PICTURES[".png"])) | spoilt_bytes(
    st.sampled_from([data for suffix in (".pgm", ".tif", ".bmp", ".jpg") for data in PICTURES[suffix]]),
    SCRAPS_OF_PICTURES,
)


def check(example: bytes) -> None:
    """A spot that is found lies in the picture, with a finite sigma."""
    path = folder(NAME) / "picture"
    path.write_bytes(example)
    try:
        pixels, bits = read_picture(path)
    except BadInputError as error:
        one_line(error)
        return
    frame = Frame("picture", 0, 0, pixels, bits)
    rows, columns = pixels.shape
    spot = locate(frame)
    for found in (spot, locate_ellipse(frame)) if isinstance(spot, Spot) else ():
        if found is not None:
            assert -1 < found.u_px < columns
            assert -1 < found.v_px < rows
            assert math.isfinite(found.sigma_px)
