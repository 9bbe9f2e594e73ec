"""Ways by faults of electronics and transfer: changed grey values, and whole frames out of order."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike

from altd.records import PixelArray
from benchmarks.campaign.way import (
    CAMERAS,
    Draw,
    Registry,
    Shot,
    Spoil,
    drawn,
    log,
    names_of,
    of,
    showing,
    uniform,
    whole,
)
from hw_sim.image import Image

WAYS = Registry("frames")


class _Column:
    """Column from which a change is, as a share of the width."""

    def __init__(self, draw: Draw) -> None:
        self._word = draw.of("everywhere", "from a column on")
        self.share = 0.0 if self._word == "everywhere" else draw.uniform(0.2, 0.8)

    def __str__(self) -> str:
        return self._word


class _Often:
    """Whether all or some frames are disturbed."""

    def __init__(self, draw: Draw) -> None:
        self._share = 1.0 if draw.rng.random() < 0.5 else draw.uniform(0.1, 0.9)
        self._rng = np.random.default_rng(draw.seed())

    def is_now(self) -> bool:
        """Whether the next frame is disturbed."""
        return bool(self._rng.random() < self._share)

    def __str__(self) -> str:
        return f", {self._share:.0%} of the frames" if self._share < 1 else ""


def _generator(draw: Draw) -> np.random.Generator:
    """Random numbers that continue from frame to frame."""
    return np.random.default_rng(draw.seed())


def _counts(pixels: PixelArray) -> Image:
    return pixels.astype(np.float32)


def _whole(counts: Image, bits: int) -> Image:
    """Whole grey values within the scale."""
    return np.clip(np.rint(counts), 0, _full(bits))


def _full(bits: int) -> int:
    return (1 << bits) - 1


@WAYS.add(moving=True)
def torn(draw: Draw) -> Spoil:
    """The upper part is from the frame before; the tear crosses the spot.

    A tear below the spot leaves it whole and late by a frame: that is ``one_camera_late``.
    """
    beside_px, often = draw.uniform(-15.0, 15.0), _Often(draw)

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        if not often.is_now() or before is None:
            return pixels
        brightest = int(cv2.GaussianBlur(pixels, (0, 0), 4.0).max(axis=1).argmax())
        cut = max(0, brightest + round(beside_px))
        return np.concatenate([before[:cut], pixels[cut:]])

    return Spoil(f"{beside_px:+.0f} px beside{often}", pixels=change, cameras=draw.targets())


@WAYS.on_pixels("{rows:.0f} rows{often}")
@drawn(uniform(0.0, 1.0), log(1, 200), _Often)
def zeroed_rows(pixels: PixelArray, bits: int, first: float, rows: float, often: _Often) -> PixelArray:
    """Some rows are lost and read 0."""
    if often.is_now():
        start = int(first * (len(pixels) - rows))
        pixels[max(start, 0) : start + int(rows)] = 0
    return pixels


@WAYS.on_pixels("{rows} rows{often}")
@drawn(uniform(0.1, 0.9), whole(2, 120), _Often)
def repeated_rows(pixels: PixelArray, bits: int, first: float, rows: int, often: _Often) -> PixelArray:
    """One row is repeated in many rows below."""
    if often.is_now():
        start = int(first * len(pixels))
        pixels[start : start + rows] = pixels[start].copy()
    return pixels


@WAYS.on_pixels("{by} px{often}")
@drawn(uniform(0.0, 0.9), lambda draw: draw.sign() * round(draw.log(1, 300)), _Often)
def row_shift(pixels: PixelArray, bits: int, first: float, by: int, often: _Often) -> PixelArray:
    """From one row on, the picture is shifted by some pixels."""
    if often.is_now():
        shifted = pixels.reshape(-1)[int(first * pixels.size) :]
        shifted[:] = np.roll(shifted, by)
    return pixels


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


WAYS.row("packets_zero", "Lost packets of 1 to 9 kB read 0.", lambda draw: _packets_lost(draw, 20, False))
WAYS.row(
    "packets_old",
    "Lost packets show the frame before.",
    lambda draw: _packets_lost(draw, 60, True),
    moving=True,
)


@WAYS.on_pixels("bit at {place:.0%} of the word is {one}")
@drawn(uniform(0, 1), of("0", "1"))
def stuck_bit(pixels: PixelArray, bits: int, place: float, one: str) -> PixelArray:
    """One bit of every pixel is always 0 or always 1."""
    bit = pixels.dtype.type(1 << int(place * bits))
    return pixels | bit if one == "1" else pixels & ~bit


@WAYS.on_pixels("everywhere")
@drawn()
def swapped_bytes(pixels: PixelArray, bits: int) -> ArrayLike:
    """Neighbouring bytes exchanged."""
    if pixels.dtype == np.uint16:
        return np.minimum(pixels.byteswap(), _full(bits))
    rows, columns = pixels.shape
    return pixels.reshape(rows, columns // 2, 2)[:, :, ::-1].reshape(rows, columns)


@WAYS.on_pixels("{share:.2%} of the pixels")
@drawn(log(1e-5, 3e-2), _generator)
def bit_errors(pixels: PixelArray, bits: int, share: float, rng: np.random.Generator) -> PixelArray:
    """Single inverted bits anywhere."""
    where = rng.integers(0, pixels.size, int(share * pixels.size))
    pixels.reshape(-1)[where] ^= (1 << rng.integers(0, bits, len(where))).astype(pixels.dtype)
    return pixels


@WAYS.on_pixels("{gain:.2f} times from {at:.0%} on")
@drawn(log(0.7, 1.4), uniform(0.2, 0.8))
def gain_step(pixels: PixelArray, bits: int, gain: float, at: float) -> ArrayLike:
    """Different gain in the left and right half of the chip."""
    counts = _counts(pixels)
    counts[:, int(at * pixels.shape[1]) :] *= np.float32(gain)
    return _whole(counts, bits)


@WAYS.on_pixels("{level:+.0%} {at}")
@drawn(uniform(-0.05, 0.3), _Column)
def black_step(pixels: PixelArray, bits: int, level: float, at: _Column) -> ArrayLike:
    """Another black level, everywhere or from one column on."""
    counts = _counts(pixels)
    counts[:, int(at.share * pixels.shape[1]) :] += np.float32(level * _full(bits))
    return _whole(counts, bits)


@WAYS.on_pixels("power {power:.2f}")
@drawn(log(0.4, 2.2))
def gamma(pixels: PixelArray, bits: int, power: float) -> ArrayLike:
    """Grey values not proportional to the light."""
    full = np.float32(_full(bits))
    return _whole(full * (_counts(pixels) / full) ** np.float32(power), bits)


@WAYS.on_pixels("everywhere")
@drawn()
def inverted(pixels: PixelArray, bits: int) -> ArrayLike:
    """A negative."""
    return _full(bits) - pixels


@WAYS.on_pixels("{count}, {level:.0%} of full scale")
@drawn(log(0.02, 1.0), whole(1, 20), Draw.seed)
def hot_columns(pixels: PixelArray, bits: int, level: float, count: int, seed: int) -> ArrayLike:
    """Columns bright from top to bottom."""
    counts = _counts(pixels)
    columns = np.random.default_rng(seed).integers(0, pixels.shape[1], count)
    counts[:, columns] += np.float32(level * _full(bits))
    return _whole(counts, bits)


@WAYS.on_pixels("quality {quality}")
@drawn(whole(3, 80))
def jpeg(pixels: PixelArray, bits: int, quality: int) -> ArrayLike:
    """Lossy compression."""
    shift = max(bits - 8, 0)
    _, data = cv2.imencode(".jpg", (pixels >> shift).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint16) << shift


@WAYS.on_pixels("{by} × {by}, {where}")
@drawn(whole(2, 4), of("blocks", "corner"))
def binned(pixels: PixelArray, bits: int, by: int, where: str) -> ArrayLike:
    """Blocks of pixels with one value, or a binned picture in a corner of the frame."""
    rows, columns = pixels.shape
    small = cv2.resize(pixels, (columns // by, rows // by), interpolation=cv2.INTER_AREA)
    if where == "blocks":
        return cv2.resize(small, (columns, rows), interpolation=cv2.INTER_NEAREST)
    copy = np.full_like(pixels, np.median(pixels[::8, ::8]))
    copy[: rows // by, : columns // by] = small
    return copy


@WAYS.on_pixels("at {level:.0%} of full scale")
@drawn(uniform(0.1, 0.9))
def clipped_grey(pixels: PixelArray, bits: int, level: float) -> PixelArray:
    """Grey values end below full scale."""
    return np.minimum(pixels, pixels.dtype.type(level * _full(bits)))


@WAYS.on_pixels("{share:.2%} of the pixels")
@drawn(log(1e-4, 0.1), _generator)
def salt_noise(pixels: PixelArray, bits: int, share: float, rng: np.random.Generator) -> PixelArray:
    """White and black pixels, at random in each frame."""
    where = rng.integers(0, pixels.size, int(share * pixels.size))
    pixels.reshape(-1)[where] = rng.choice([0, _full(bits)], len(where)).astype(pixels.dtype)
    return pixels


@WAYS.on_pixels("{level:.1%} of full scale")
@drawn(log(0.003, 0.05), whole(0, 1), _generator)
def row_noise(pixels: PixelArray, bits: int, level: float, axis: int, rng: np.random.Generator) -> ArrayLike:
    """Rows or columns vary together, as from a disturbed supply."""
    size = (pixels.shape[0], 1) if axis == 0 else (1, pixels.shape[1])
    jumps = np.float32(level * _full(bits)) * rng.standard_normal(size, dtype=np.float32)
    return _whole(_counts(pixels) + jumps, bits)


def _shown(note: str, cameras: frozenset[str], source: Callable[[int, int], int]) -> Spoil:
    """Exposure k of some cameras shows the picture of exposure ``source(k, onset)``."""

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        first = min(shot.k for shot in shots)

        def shown(shot: Shot) -> tuple[str, int]:
            return shot.camera, max(source(shot.k, onset), first) if shot.camera in cameras else shot.k

        return showing(shots, onset, shown)

    return Spoil(note, stream=stream)


@WAYS.add(moving=True)
def frozen(draw: Draw) -> Spoil:
    """The same picture with new numbers and times."""
    cameras = draw.targets()
    return _shown(names_of(cameras), cameras, lambda k, onset: onset - 1)


@WAYS.add(moving=True)
def loop(draw: Draw) -> Spoil:
    """The last pictures before the onset, repeated."""
    length, cameras = draw.whole(2, 4), draw.targets()
    return _shown(f"of {length} frames", cameras, lambda k, onset: onset - length + (k - onset) % length)


@WAYS.add(moving=True)
def every_second_repeated(draw: Draw) -> Spoil:
    """Every second frame repeats the one before."""
    cameras = draw.targets()
    return _shown(names_of(cameras), cameras, lambda k, onset: k - (k - onset) % 2)


@WAYS.add(
    moving=True,
    invisible="one late camera differs from a yaw only by the machine's vibration, which takes some 5 s to "
    "detect; until then speed × delay: up to 0.75 mm at 5 mm/s and three frames",
)
def one_camera_late(draw: Draw) -> Spoil:
    """One camera shows frames of the past with current number and time."""
    late, cameras = draw.whole(1, 3), draw.one()
    return _shown(f"{names_of(cameras)} {late} late", cameras, lambda k, onset: k - late)


@WAYS.add(
    moving=True,
    invisible="frames that are late from both cameras with current stamps are a steady delay: 50 to 150 ms, "
    "up to 1 mm at 5 mm/s",
)
def both_cameras_late(draw: Draw) -> Spoil:
    """Both cameras show frames of the past with current number and time."""
    late = draw.whole(1, 3)
    return _shown(f"{late} late", frozenset(CAMERAS), lambda k, onset: k - late)


@WAYS.add(moving=True)
def played_backwards(draw: Draw) -> Spoil:
    """Pairs of pictures in exchanged order."""
    cameras = draw.targets()
    return _shown(names_of(cameras), cameras, lambda k, onset: k + 1 - 2 * ((k - onset) % 2))
