"""Corrupted PNG files with right checksums, so that the parser behind them is reached."""

import struct
import zlib

from fuzz.spoil import EXTREME_NUMBERS, spoilt_bytes
from hypothesis import strategies as st
from support.pngs import SIGNATURE, chunk

SIZES = tuple(sorted({each for each in EXTREME_NUMBERS if isinstance(each, int) and 0 <= each < 2**32}))


def _chunks(png: bytes) -> list[tuple[bytes, bytes]]:
    found, at = dict[bytes, bytes](), len(SIGNATURE)
    while at < len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        found[kind] = found.get(kind, b"") + png[at + 8 : at + 8 + length]  # of all IDATs one
        at += 12 + length
    return list(found.items())


@st.composite
def _rebuilt(draw: st.DrawFn, valid: st.SearchStrategy[bytes]) -> bytes:
    """Another size, depth or colour, corrupted pixels, chunks left out and doubled; each with a good CRC."""
    parts = []
    for kind, data in _chunks(draw(valid)):
        if kind == b"IHDR" and draw(st.booleans()):
            width, height, *rest = struct.unpack(">IIBBBBB", data)
            width, height = (draw(st.sampled_from((side, side, *SIZES, 40_000))) for side in (width, height))
            if draw(st.integers(0, 3)) == 0:
                rest = [draw(st.sampled_from((value, 0, 1, 2, 3, 4, 6, 16, 255))) for value in rest]
            data = struct.pack(">IIBBBBB", width, height, *rest)
        elif kind == b"IDAT" and draw(st.booleans()):
            raw = draw(spoilt_bytes(st.just(zlib.decompress(data))))
            data = zlib.compress(raw) if draw(st.booleans()) else draw(spoilt_bytes(st.just(data)))
        elif draw(st.integers(0, 9)) == 0:
            kind = draw(
                st.sampled_from(
                    (kind, b"tEXt", b"PLTE", b"tRNS", b"gAMA", b"acTL", b"iCCP", b"eXIf", b"\0\0\0\0")
                )
            )
        parts += [chunk(kind, data)] * draw(st.sampled_from((1, 1, 1, 1, 0, 2)))
    return SIGNATURE + b"".join(parts)


def spoilt_png(valid: st.SearchStrategy[bytes]) -> st.SearchStrategy[bytes]:
    """A PNG corrupted in its bytes, or in their meaning."""
    return spoilt_bytes(valid) | _rebuilt(valid)
