"""Compare two pictures of a running program, whose numbers, clock and noise are never the same."""

import re

import cv2
import numpy as np

MIN_DIFFERENCE = 48
"""Of a pixel that differs, of 255: more than the noise of a simulated camera."""
_NUMBER = re.compile(rb"[-+]?\d[\d.]*")


def shows_the_same(before: bytes, after: bytes, max_share: float) -> bool:
    """Whether SVG files have the same lines but for numbers, PNG files no larger share of other pixels."""
    if not after.startswith(b"\x89PNG"):
        return _lines(before) == _lines(after)
    one, other = (
        np.asarray(cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)) for file in (before, after)
    )
    if one.shape != other.shape:
        return False
    return float(np.mean(cv2.absdiff(one, other).max(axis=2) >= MIN_DIFFERENCE)) <= max_share


def _lines(svg: bytes) -> set[bytes]:
    """Different lines without their numbers: an animation shows more or fewer of each."""
    return {b" ".join(_NUMBER.sub(b"", line).split()) for line in svg.splitlines()}
