from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.pngs import chunk, png

from altd.errors import BadInputError
from altd.files.picture import decode_png, read_picture

PIXELS = np.random.default_rng(1).integers(0, 255, (48, 64)).astype(np.uint8)
GOOD = cv2.imencode(".png", PIXELS)[1].tobytes()


def complaint(data: bytes, width: int = 64, height: int = 48, bits: int = 8) -> str:
    try:
        decode_png(data, width, height, bits)
    except ValueError as error:
        return str(error)
    pytest.fail("it was decoded")


def test_a_png_is_decoded_whatever_else_is_in_it() -> None:
    assert np.array_equal(decode_png(GOOD, 64, 48, 8), PIXELS)
    comment = chunk(b"tEXt", b"Comment\0x") + chunk(b"gAMA", b"\0\0\0\0")
    assert np.array_equal(decode_png(GOOD[:33] + comment + GOOD[33:], 64, 48, 8), PIXELS)


def test_a_png_of_another_size_is_not_decoded() -> None:
    assert complaint(png(40_000, 40_000)) == "is 40000 × 40000, expected 64 × 48"
    assert "more than 268435456 pixels" in complaint(png(40_000, 40_000), 40_000, 40_000)


def test_a_png_that_is_torn_or_damaged_is_refused_and_libpng_says_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    flipped = bytearray(GOOD)
    flipped[len(GOOD) // 2] ^= 1
    for damaged in (GOOD[:-12], GOOD[: len(GOOD) // 2], bytes(flipped), GOOD[:33] + GOOD[8:]):
        assert complaint(damaged) == "cannot be decoded as a frame: it is torn or damaged"
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (png(40_000, 40_000), "it is 40000 × 40000, more than 268435456 pixels"),
        (png(65_536, 16_385), "it is 65536 × 16385, more than"),  # beyond 2³⁰, where OpenCV raises
        (png(2**31, 1), "more than"),
        (png(0, 5), "its header is not that of a PNG"),
        (png(64, 64, depth=9), "its header is not that of a PNG"),
        (png(64, 64), "Not enough image data"),
        (png(64, 64, data=b"\x09" * 65 * 64), "bad adaptive filter value"),
        (GOOD[:100], "it is torn or damaged"),
        (b"", "of up to"),
        (b"P5\n60000 60000\n255\n" + bytes(100), "of up to"),
        (cv2.imencode(".jpg", PIXELS)[1].tobytes()[:1500] + b"\xff\xd9", "Corrupt JPEG data"),
        (cv2.imencode(".png", np.zeros((64, 64, 3), np.uint8))[1].tobytes(), "is not an 8- or 16-bit grey"),
        (cv2.imencode(".png", np.zeros((16, 64), np.uint8))[1].tobytes(), "is only 64 × 16 pixels"),
    ],
)
def test_a_picture_that_cannot_be_used_is_refused_in_one_line(
    data: bytes, why: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "picture"
    path.write_bytes(data)
    with pytest.raises(BadInputError) as caught:
        read_picture(path)
    assert why in str(caught.value)
    assert str(caught.value).isprintable()
    assert "libpng" not in capfd.readouterr().err
