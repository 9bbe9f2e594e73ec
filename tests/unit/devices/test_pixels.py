"""Pixel formats against bytes that were written out by hand from the formats' tables."""

import contextlib
import struct

import cv2
import numpy as np
import pytest
from support.jpegs import HEIGHT, SMOOTH, WHOLE, WIDTH, jpeg

from altd.devices import aravis, v4l2
from altd.devices.pixels import PIXEL_FORMATS

FOUR_OF_TEN = (0x2A7, 0x1D3, 0x0E9, 0x3F4)
TWO_OF_TWELVE = (0xA5C, 0x3E7)
VECTORS = {
    # name: line of padding 2, width, values. The bytes are those of the tables of each format:
    # Linux Media Infrastructure userspace API, "Luma-Only Formats"; PFNC 2.4, 4.2; GigE Vision 2.0, 26.3
    "GREY": ((1, 2, 250), 3, (1, 2, 250)),
    "Mono8": ((1, 2, 250), 3, (1, 2, 250)),
    "Y10": ((0x34, 0x02, 0xFF, 0x00), 2, (0x234, 0xFF)),
    "Y12": ((0x34, 0x0A, 0xFF, 0x00), 2, (0xA34, 0xFF)),
    "Y16": ((0x34, 0xFA, 0xFF, 0x00), 2, (0xFA34, 0xFF)),
    "Mono10": ((0x34, 0x02, 0xFF, 0x00), 2, (0x234, 0xFF)),
    "Mono12": ((0x34, 0x0A, 0xFF, 0x00), 2, (0xA34, 0xFF)),
    "Mono16": ((0x34, 0xFA, 0xFF, 0x00), 2, (0xFA34, 0xFF)),
    # bits 9 to 2 of each pixel, then 1 and 0 of all four, the first pixel lowest
    "Y10P": ((0xA9, 0x74, 0x3A, 0xFD, 0b00_01_11_11), 4, FOUR_OF_TEN),
    # bits 11 to 4 of both, then 3 to 0, the first pixel lowest
    "Y12P": ((0xA5, 0x3E, 0x7C), 2, TWO_OF_TWELVE),
    # pixels one after the other from the lowest bit of the first byte
    "Mono10p": ((0xA7, 0b010011_10, 0b1001_0111, 0b00_001110, 0b11111101), 4, FOUR_OF_TEN),
    "Mono12p": ((0x5C, 0x7A, 0x3E), 2, TWO_OF_TWELVE),
    # high bits of the first, low bits of both, high bits of the second
    "Mono10Packed": ((0xA9, 0b00_11_00_11, 0x74), 2, FOUR_OF_TEN[:2]),
    "Mono12Packed": ((0xA5, 0x7C, 0x3E), 2, TWO_OF_TWELVE),
    "NV12": ((16, 128, 234), 3, (16, 128, 234)),
    "YUYV": ((16, 90, 128, 91, 234, 92), 3, (16, 128, 234)),
    "UYVY": ((90, 16, 91, 128, 92, 234), 3, (16, 128, 234)),
}


def test_every_format_is_tested_and_belongs_to_a_driver() -> None:
    assert {*VECTORS, "MJPG"} == set(PIXEL_FORMATS)
    assert {*v4l2.PIXEL_FORMAT_NAMES, *aravis.PIXEL_FORMAT_NAMES} == set(PIXEL_FORMATS)


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize("is_lent", [True, False])
def test_two_lines_with_padding_have_the_values_of_the_table(name: str, is_lent: bool) -> None:
    line, width, values = VECTORS[name]
    of = PIXEL_FORMATS[name]
    assert of.line_bytes(width) == len(line)
    buffer = bytearray([*line, 77, 77, *line])
    assert of.frame_bytes(width, 2, len(line) + 2) == len(buffer)
    pixels = of.pixels(memoryview(buffer), width, 2, len(line) + 2, is_lent=is_lent)
    assert pixels.tolist() == [list(values)] * 2
    assert pixels.dtype == (np.uint8 if of.bits == 8 else np.uint16)
    assert not pixels.flags.writeable
    if is_lent:
        buffer[:] = bytes(len(buffer))
        assert pixels.tolist() == [list(values)] * 2
    with pytest.raises((TypeError, ValueError)):
        of.pixels(memoryview(buffer)[:-1], width, 2, len(line) + 2)


@pytest.mark.parametrize("name", ["NV12", "YUYV", "UYVY"])
def test_a_luminance_that_is_clipped_at_white_is_saturated(name: str) -> None:
    """Else a spot with a flat top at 235 would seem to be below the full scale of 255."""
    of = PIXEL_FORMATS[name]
    line = bytes([234, 234, 235, 235, 236, 236, 254, 254])
    values = of.pixels(line, of.group_pixels * 8 // of.group_bytes, 1, 8).ravel()
    assert set(values[values > 234].tolist()) == {255}
    assert (values <= 234).sum() * 4 == values.size


@pytest.mark.parametrize("name", ["Y10P", "Mono10p", "Mono10Packed"])
def test_a_line_that_does_not_end_with_a_byte_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"the width of {name} is a multiple of"):
        PIXEL_FORMATS[name].line_bytes(751)


def turned(orientation: int) -> bytes:
    """The JPEG whose Exif data claim an orientation (Exif 2.32, 4.6.4)."""
    exif = b"Exif\0\0MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x112, 3, 1, orientation, 0, 0)
    return WHOLE[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif + WHOLE[2:]


@pytest.mark.parametrize(
    "data", [WHOLE, jpeg(SMOOTH, cv2.IMWRITE_JPEG_RST_INTERVAL, 4), turned(2), turned(3), turned(6)]
)
def test_a_jpeg_is_decoded_as_the_sensor_has_it_whatever_follows_in_the_buffer(data: bytes) -> None:
    data += bytes(9)
    pixels = PIXEL_FORMATS["MJPG"].pixels(memoryview(data), WIDTH, HEIGHT, 0)
    np.testing.assert_allclose(pixels, SMOOTH, atol=4)
    assert not pixels.flags.writeable


def as_claimed(whole: bytes, width: int, height: int) -> bytes:
    """The JPEG with another size in its header."""
    size = struct.pack(">HH", HEIGHT, WIDTH)
    assert whole.count(size) == 1
    return whole.replace(size, struct.pack(">HH", height, width))


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\xd8\xff\xd9",
        WHOLE[: len(WHOLE) // 2],
        WHOLE[:-2],
        WHOLE[2:],
        b"\x00" + WHOLE,
        b"\xff\xd8" + b"\xff\xe0\xff\xff" * 40 + b"\xff\xd9",
        as_claimed(WHOLE, 60000, 60000),
        as_claimed(WHOLE, WIDTH, 2 * HEIGHT),
        jpeg(SMOOTH[:, :64]),
        WHOLE[:200] + b"\xff\xd9",
        WHOLE[: len(WHOLE) // 2] + b"\xff\xd9",
        WHOLE[: len(WHOLE) // 2] + WHOLE[len(WHOLE) // 2 + 40 :],
        WHOLE[: len(WHOLE) // 2] + b"\xff\xd9" + WHOLE,
        WHOLE + WHOLE,
        jpeg(SMOOTH, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        b"\xff\xd8\xff",
        bytes(100),
        np.random.default_rng(2).bytes(3000),
    ],
)
def test_a_jpeg_that_lacks_bytes_is_of_another_size_or_kind_or_none_is_no_frame(data: bytes) -> None:
    with pytest.raises(ValueError, match="JPEG"):
        PIXEL_FORMATS["MJPG"].pixels(data, WIDTH, HEIGHT, 0)


def test_a_jpeg_with_any_other_byte_in_its_header_is_a_picture_of_its_size_or_no_frame() -> None:
    random = np.random.default_rng(7)
    of = PIXEL_FORMATS["MJPG"]
    for at in range(WHOLE.index(b"\xff\xda") + 14):
        for byte in random.integers(0, 256, 3).tolist():
            for data in (WHOLE[:at] + bytes([byte]) + WHOLE[at + 1 :], WHOLE[:at] + bytes([byte])):
                with contextlib.suppress(ValueError):
                    assert of.pixels(data, WIDTH, HEIGHT, 0).shape == (HEIGHT, WIDTH)
