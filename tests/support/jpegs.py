"""Pictures as a compressing camera sends them."""

import cv2
import numpy as np

WIDTH, HEIGHT = 96, 64
_ROWS, _COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
SMOOTH = np.rint(20 + 200 * np.exp(-((_COLUMNS - 30) ** 2 + (_ROWS - 20) ** 2) / 80)).astype(np.uint8)


def jpeg(picture: np.ndarray, *options: int) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95, *options])[1].tobytes()


WHOLE = jpeg(SMOOTH)
SENT = [WHOLE, WHOLE[: len(WHOLE) // 2], jpeg(SMOOTH[:, ::-1]), jpeg(SMOOTH[:, :64]), jpeg(SMOOTH[::-1])]
"""Frames one after the other; one that is cut off and one of another size are none."""
