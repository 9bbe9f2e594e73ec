"""Pictures: their size is checked before they are decoded, because a small file may claim any size."""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from altd.errors import BadInputError
from altd.files.reading import read_file
from altd.records import PixelArray

MAX_PICTURE_PX = 1 << 28
"""Maximum number of pixels: 16384 × 16384, more than any camera has."""
PNG_HEAD_BYTES = 26

_MAX_BYTES = 1 << 30
_MAX_STDERR_BYTES = 1000
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_GREY = 0
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_CRITICAL = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
_PGM_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PGM_HEAD = re.compile(rb"P[25]" + 2 * (_PGM_SPACE + rb"\d+") + _PGM_SPACE + rb"(\d{1,5})\s")
_PGM_HEAD_BYTES = 1 << 16
_TIFF_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_TIFF_BITS, _TIFF_PHOTOMETRIC, _TIFF_ORIENTATION = 258, 262, 274


def check_png_head(head: bytes, width: int, height: int, bits: int) -> None:
    """Check signature, size, depth and colour in the first 26 bytes (PNG specification, 11.2.2).

    ``bits`` is the camera's depth: 8 needs a PNG of 8 bits, 9 to 16 one of 16. Raises ValueError that states
    the mismatch.
    """
    if len(head) < PNG_HEAD_BYTES or not head.startswith(_PNG_SIGNATURE):
        raise ValueError("is not a PNG")
    png_width, png_height, depth, colour = struct.unpack_from(">IIBB", head, 16)
    if (png_width, png_height) != (width, height):
        raise ValueError(f"is {png_width} × {png_height}, expected {width} × {height}")
    if colour != _PNG_GREY or depth != (8 if bits == 8 else 16):
        raise ValueError(f"is not a grey PNG of {bits} bits")


def decode_png(data: bytes, width: int, height: int, bits: int) -> PixelArray:
    """Return the pixels (rows, columns) of a grey PNG of this size; raises ValueError."""
    check_png_head(data, width, height, bits)
    try:
        pixels = _decode(_critical(data))
    except ValueError as error:
        raise ValueError(f"cannot be decoded as a frame: {error}") from error
    if pixels is None or pixels.shape != (height, width):
        raise ValueError("cannot be decoded as a frame")
    return cast("PixelArray", pixels)


def png_bytes(width: int, height: int, bits: int) -> int:
    """Return the largest size of a PNG: twice its uncompressed pixels, plus 1 MiB."""
    return 2 * width * height * (1 if bits == 8 else 2) + (1 << 20)


def read_picture(path: Path) -> tuple[PixelArray, int]:
    """Return the pixels and bits of a grey picture in any format of OpenCV; raises BadInputError.

    The bits are those of the largest value that a PGM states, in other formats 8 or 16.
    For single-threaded commands: output of a decoder on stderr is caught, and the picture is then refused.
    """
    data = read_file(path, _MAX_BYTES)
    try:
        _check_tiff(data)
        with _stderr_caught() as said:
            pixels = _decode(_critical(data) if data.startswith(_PNG_SIGNATURE) else data)
    except ValueError as error:
        raise BadInputError(path, f"is not an image that can be read: {error}") from error
    if said:
        raise BadInputError(path, f"is not an image that can be read: {said[0]}")
    if pixels is None:
        raise BadInputError(path, f"is not an image that can be read, of up to {MAX_PICTURE_PX} pixels")
    if pixels.ndim != 2 or pixels.dtype.name not in ("uint8", "uint16"):
        raise BadInputError(path, "is not an 8- or 16-bit grey image")
    if min(pixels.shape) < 32:
        raise BadInputError(path, f"is only {pixels.shape[1]} × {pixels.shape[0]} pixels")
    head = _PGM_HEAD.match(data, 0, _PGM_HEAD_BYTES)
    bits = max(int(head[1]).bit_length(), 1) if head else 8 * pixels.dtype.itemsize
    return cast("PixelArray", pixels), bits


def _check_tiff(data: bytes) -> None:
    """Raise ValueError for a TIFF (6.0) that OpenCV would turn or invert, or of which it would omit pages.

    OpenCV inverts 8 bits whose zero is white (photometric interpretation 0), and not 16.
    """
    if (order := _TIFF_ORDERS.get(data[:4])) is None:
        return
    try:
        (first,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, first)
        entries = range(first + 2, first + 2 + 12 * count, 12)
        tags = {
            tag: value
            for tag, _, _, value in (struct.unpack_from(order + "HHIH", data, at) for at in entries)
        }
        (following,) = struct.unpack_from(order + "I", data, first + 2 + 12 * count)
    except struct.error:
        raise ValueError("it is torn or damaged") from None
    if (orientation := tags.get(_TIFF_ORIENTATION, 1)) != 1:
        raise ValueError(f"its orientation tag is {orientation}: store the camera's pixels with tag 1")
    if tags.get(_TIFF_PHOTOMETRIC) == 0 and tags.get(_TIFF_BITS, 1) > 8:
        raise ValueError("its zero is white (photometric tag 0): store it with tag 1, zero is black")
    if following:
        raise ValueError("it has several pages: store each as a file")


@contextmanager
def _stderr_caught() -> Iterator[list[str]]:
    """Collect the lines written to the process' stderr meanwhile, also by C libraries."""
    lines: list[str] = []
    with os.fdopen(os.memfd_create("stderr"), "rb") as caught:
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        caught.seek(0)
        lines += caught.read(_MAX_STDERR_BYTES).decode(errors="replace").splitlines()


def _critical(data: bytes) -> bytes:
    """Return a PNG without ancillary chunks; raises ValueError if a chunk is torn, damaged or misplaced.

    libpng reports what it finds itself to stderr, and the other chunks are irrelevant for a frame.
    """
    parts, at = [_PNG_SIGNATURE], len(_PNG_SIGNATURE)
    while len(data) >= at + 12:
        length, kind = struct.unpack_from(">I4s", data, at)
        chunk = data[at : at + 12 + length]
        if len(chunk) < 12 + length or zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:], "big"):
            break
        if (kind == b"IHDR") != (at == len(_PNG_SIGNATURE)):
            break
        if kind in _CRITICAL:
            parts.append(chunk)
        if kind == b"IEND":
            _check_header(data)
            return b"".join(parts)
        at += 12 + length
    raise ValueError("it is torn or damaged")


def _check_header(data: bytes) -> None:
    """Check the header by the PNG specification, 11.2.2."""
    width, height, depth, colour, compression, filtering, interlace = struct.unpack_from(">IIBBBBB", data, 16)
    if width * height > MAX_PICTURE_PX:
        raise ValueError(f"it is {width} × {height}, more than {MAX_PICTURE_PX} pixels")
    if (
        not (width and height and depth in _DEPTHS.get(colour, ()))
        or compression
        or filtering
        or interlace > 1
    ):
        raise ValueError("its header is not that of a PNG")


def _decode(data: bytes) -> npt.NDArray[Any] | None:
    """Decode; None: not a picture, or more pixels than ``OPENCV_IO_MAX_IMAGE_PIXELS`` (see ``cli``)."""
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
