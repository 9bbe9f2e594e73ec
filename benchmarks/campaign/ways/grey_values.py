"""Ways by faults of the electronics, which change the grey values of a frame during transfer."""

from __future__ import annotations

import cv2
import numpy as np

from altd.records import PixelArray
from benchmarks.campaign.way import Draw, OnPixels, Registry, Spoil, grey

WAYS = Registry("frames")


def _sometimes(share: float, seed: int, change: OnPixels) -> OnPixels:
    """Apply the change to a share of the frames."""
    rng = np.random.default_rng(seed)

    def maybe(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        return change(pixels, before, bits) if rng.random() < share else pixels

    return maybe


def _often(draw: Draw) -> tuple[float, str]:
    """Draw the share of disturbed frames, all or some, with its text."""
    share = 1.0 if draw.rng.random() < 0.5 else draw.uniform(0.1, 0.9)
    return share, f", {share:.0%} of the frames" if share < 1 else ""


@WAYS.add(moving=True)
def torn(draw: Draw) -> Spoil:
    """The upper part is from the frame before; the tear crosses the spot.

    A tear below the spot leaves it whole and late by a frame: that is ``one_camera_late``.
    """
    beside_px, (share, words) = draw.uniform(-15.0, 15.0), _often(draw)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        if before is None:
            return pixels
        brightest = int(cv2.GaussianBlur(pixels, (0, 0), 4.0).max(axis=1).argmax())
        cut = max(0, brightest + round(beside_px))
        copy = pixels.copy()
        copy[:cut] = before[:cut]
        return copy

    return Spoil(
        f"{beside_px:+.0f} px beside{words}",
        pixels=_sometimes(share, draw.seed(), change),
        cameras=draw.targets(),
    )


@WAYS.add()
def zeroed_rows(draw: Draw) -> Spoil:
    """Some rows are lost and read 0."""
    first, rows, (share, words) = draw.uniform(0.0, 1.0), draw.log(1, 200), _often(draw)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        start, copy = int(first * (len(pixels) - rows)), pixels.copy()
        copy[max(start, 0) : start + int(rows)] = 0
        return copy

    return Spoil(
        f"{rows:.0f} rows{words}", pixels=_sometimes(share, draw.seed(), change), cameras=draw.targets()
    )


@WAYS.add()
def repeated_rows(draw: Draw) -> Spoil:
    """One row is repeated in many rows below."""
    first, rows, (share, words) = draw.uniform(0.1, 0.9), draw.whole(2, 120), _often(draw)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        start, copy = int(first * len(pixels)), pixels.copy()
        copy[start : start + rows] = copy[start]
        return copy

    return Spoil(f"{rows} rows{words}", pixels=_sometimes(share, draw.seed(), change), cameras=draw.targets())


@WAYS.add()
def row_shift(draw: Draw) -> Spoil:
    """From one row on, the picture is shifted by some pixels."""
    first, by, (share, words) = draw.uniform(0.0, 0.9), draw.sign() * round(draw.log(1, 300)), _often(draw)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        start, copy = int(first * pixels.size), pixels.copy()
        copy.reshape(-1)[start:] = np.roll(pixels.reshape(-1)[start:], by)
        return copy

    return Spoil(f"{by} px{words}", pixels=_sometimes(share, draw.seed(), change), cameras=draw.targets())


def _packets_lost(draw: Draw, most: int, shows_the_frame_before: bool) -> Spoil:
    """Loss of up to ``most`` packets of 1 to 9 kB."""
    size, count, seed = draw.whole(1400, 9000), draw.whole(1, most), draw.seed()
    rng = np.random.default_rng(seed)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        instead = before if shows_the_frame_before else np.zeros_like(pixels)
        if instead is None:
            return pixels
        copy, step = pixels.copy(), max(1, size // pixels.itemsize)
        for packet in rng.integers(0, copy.size // step + 1, count):
            lost = slice(packet * step, (packet + 1) * step)
            copy.reshape(-1)[lost] = instead.reshape(-1)[lost]
        return copy

    return Spoil(f"{count} of {size} bytes", pixels=change, cameras=draw.targets())


@WAYS.add()
def packets_zero(draw: Draw) -> Spoil:
    """Lost packets of 1 to 9 kB read 0."""
    return _packets_lost(draw, 20, False)


@WAYS.add(moving=True)
def packets_old(draw: Draw) -> Spoil:
    """Lost packets show the frame before."""
    return _packets_lost(draw, 60, True)


@WAYS.add()
def stuck_bit(draw: Draw) -> Spoil:
    """One bit of every pixel is always 0 or always 1."""
    place, one = draw.uniform(0, 1), draw.of("0", "1")

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        bit = pixels.dtype.type(1 << int(place * bits))
        return pixels | bit if one == "1" else pixels & ~bit

    return Spoil(f"bit at {place:.0%} of the word is {one}", pixels=change, cameras=draw.targets())


@WAYS.add()
def swapped_bytes(draw: Draw) -> Spoil:
    """Neighbouring bytes exchanged."""

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        if pixels.dtype == np.uint16:
            return np.asarray(np.minimum(pixels.byteswap(), (1 << bits) - 1), np.uint16)
        rows, columns = pixels.shape
        swapped = pixels.reshape(rows, columns // 2, 2)[:, :, ::-1].reshape(rows, columns)
        return np.asarray(swapped, np.uint8)

    return Spoil("everywhere", pixels=change, cameras=draw.targets())


@WAYS.add()
def bit_errors(draw: Draw) -> Spoil:
    """Single inverted bits anywhere."""
    share, seed = draw.log(1e-5, 3e-2), draw.seed()
    rng = np.random.default_rng(seed)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        copy = pixels.copy()
        where = rng.integers(0, copy.size, int(share * copy.size))
        copy.reshape(-1)[where] ^= (1 << rng.integers(0, bits, len(where))).astype(copy.dtype)
        return copy

    return Spoil(f"{share:.2%} of the pixels", pixels=change, cameras=draw.targets())


def _recounted(pixels: PixelArray, counts: np.ndarray, bits: int) -> PixelArray:
    recounted: PixelArray = np.clip(np.rint(counts), 0, (1 << bits) - 1).astype(pixels.dtype)
    return recounted


@WAYS.add()
def gain_step(draw: Draw) -> Spoil:
    """Different gain in the left and right half of the chip."""
    gain, at = draw.log(0.7, 1.4), draw.uniform(0.2, 0.8)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        counts = pixels.astype(np.float32)
        counts[:, int(at * pixels.shape[1]) :] *= np.float32(gain)
        return _recounted(pixels, counts, bits)

    return Spoil(f"{gain:.2f} times from {at:.0%} on", pixels=change, cameras=draw.targets())


@WAYS.add()
def black_step(draw: Draw) -> Spoil:
    """Another black level, everywhere or from one column on."""
    level, at = draw.uniform(-0.05, 0.3), draw.of("everywhere", "from a column on")
    column = 0.0 if at == "everywhere" else draw.uniform(0.2, 0.8)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        counts = pixels.astype(np.float32)
        counts[:, int(column * pixels.shape[1]) :] += np.float32(level * ((1 << bits) - 1))
        return _recounted(pixels, counts, bits)

    return Spoil(f"{level:+.0%} {at}", pixels=change, cameras=draw.targets())


@WAYS.add()
def gamma(draw: Draw) -> Spoil:
    """Grey values not proportional to the light."""
    power = draw.log(0.4, 2.2)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        full = np.float32((1 << bits) - 1)
        return _recounted(pixels, full * (pixels / full) ** np.float32(power), bits)

    return Spoil(f"power {power:.2f}", pixels=change, cameras=draw.targets())


@WAYS.add()
def inverted(draw: Draw) -> Spoil:
    """A negative."""
    return Spoil(
        "everywhere",
        pixels=lambda pixels, before, bits: np.asarray((1 << bits) - 1 - pixels, pixels.dtype),
        cameras=draw.targets(),
    )


@WAYS.add()
def hot_columns(draw: Draw) -> Spoil:
    """Columns bright from top to bottom."""
    level, count, seed = draw.log(0.02, 1.0), draw.whole(1, 20), draw.seed()

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        counts = pixels.astype(np.float32)
        columns = np.random.default_rng(seed).integers(0, pixels.shape[1], count)
        counts[:, columns] += np.float32(level * ((1 << bits) - 1))
        return _recounted(pixels, counts, bits)

    return Spoil(f"{count}, {level:.0%} of full scale", pixels=change, cameras=draw.targets())


@WAYS.add()
def jpeg(draw: Draw) -> Spoil:
    """Lossy compression."""
    quality = draw.whole(3, 80)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        shift = max(bits - 8, 0)
        _, data = cv2.imencode(
            ".jpg", (pixels >> shift).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )
        decoded = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        return _recounted(pixels, np.asarray(decoded, np.float32) * np.float32(1 << shift), bits)

    return Spoil(f"quality {quality}", pixels=change, cameras=draw.targets())


@WAYS.add()
def binned(draw: Draw) -> Spoil:
    """Blocks of pixels with one value, or a binned picture in a corner of the frame."""
    by, corner = draw.whole(2, 4), draw.of("blocks", "corner")

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        rows, columns = pixels.shape
        small = cv2.resize(pixels, (columns // by, rows // by), interpolation=cv2.INTER_AREA)
        if corner == "blocks":
            return grey(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_NEAREST), pixels)

        copy = np.full_like(pixels, np.median(pixels[::8, ::8]))
        copy[: rows // by, : columns // by] = small
        return copy

    return Spoil(f"{by} × {by}, {corner}", pixels=change, cameras=draw.targets())


@WAYS.add()
def clipped_grey(draw: Draw) -> Spoil:
    """Grey values end below full scale."""
    level = draw.uniform(0.1, 0.9)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        return np.minimum(pixels, pixels.dtype.type(level * ((1 << bits) - 1)))

    return Spoil(f"at {level:.0%} of full scale", pixels=change, cameras=draw.targets())


@WAYS.add()
def salt_noise(draw: Draw) -> Spoil:
    """White and black pixels, at random in each frame."""
    share, seed = draw.log(1e-4, 0.1), draw.seed()
    rng = np.random.default_rng(seed)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        copy = pixels.copy()
        where = rng.integers(0, copy.size, int(share * copy.size))
        copy.reshape(-1)[where] = rng.choice([0, (1 << bits) - 1], len(where)).astype(copy.dtype)
        return copy

    return Spoil(f"{share:.2%} of the pixels", pixels=change, cameras=draw.targets())


@WAYS.add()
def row_noise(draw: Draw) -> Spoil:
    """Rows or columns vary together, as from a disturbed supply."""
    level, axis, seed = draw.log(0.003, 0.05), draw.whole(0, 1), draw.seed()
    rng = np.random.default_rng(seed)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        size = (pixels.shape[0], 1) if axis == 0 else (1, pixels.shape[1])
        jumps = rng.standard_normal(size, dtype=np.float32)
        return _recounted(pixels, pixels + np.float32(level * ((1 << bits) - 1)) * jumps, bits)

    return Spoil(f"{level:.1%} of full scale", pixels=change, cameras=draw.targets())
