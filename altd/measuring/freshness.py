"""Detection of repeated pictures: noise is never the same twice, so a repeat was not exposed again."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from altd.records import Frame, PixelArray

MAX_COMPARED_FRAMES = 128
"""Number of earlier frames that a new one is compared with: 6.4 s at 20 per second."""
_SAMPLED_ROWS = 60
_ROW_STEP = 3
"""Odd, so that even and odd rows are sampled and a frozen field of an interlaced picture is among them."""
_BLOCKS_PER_ROW = 8
_LANE_BYTES = 8
_MIN_REPEATED_PIXELS = 400
"""Minimum number of pixels that repeat at once. A value between two counts flips with a probability of about
1.1 times the noise in counts. At a noise of 0.1 counts, less than any sensor has in light, a block of 94
pixels is unchanged with a probability of 3e-5, and five of 480 at once in one of 128 frames with 1e-9."""
_MIN_DIFFERING_SHARE = 0.25
"""Minimum share of neighbouring pixels of a block that differ. A block at one value, black or at full scale,
hides its noise and is no evidence; a few hot pixels in it do not change that."""


class _EarlierFrame(NamedTuple):
    sequence: int
    t_ns: int


class FreshnessCheck:
    """Compares each frame of one camera with the last ``MAX_COMPARED_FRAMES``, block by block.

    The blocks are 60 rows of the picture, each cut into eight. A digest of each block is kept: the upper half
    of the sum of its eight-byte words times random odd numbers, modulo 2⁶⁴ (multilinear hashing). Two blocks
    with different noise have the same digest with a probability of 2⁻³². Blocks also detect a picture of
    which only a part is frozen, and a frozen one into which a clock is written.

    Not detected: a repeat of an older picture, or of one that was dropped before this check; a picture in
    which an averaging camera mixes old and new light; frames with added noise; black and saturated parts.
    """

    def __init__(self) -> None:
        self._shape: tuple[int, ...] = ()
        self._playthrough = 0
        self._earlier: dict[int, _EarlierFrame] = {}
        self._next = 0

    def repeated(self, frame: Frame) -> str:
        """Return as text which earlier picture, or part of it, is repeated; empty if all of it is new."""
        shape = (*frame.pixels.shape, frame.pixels.itemsize)
        if shape != self._shape or frame.playthrough != self._playthrough:
            self._begin(frame, shape)
        sample = self._sample(frame.pixels)
        digests = self._digests(sample)
        same = self._known == digests
        match, share = -1, 0.0
        if same.any():
            match, share = self._best_match(same, sample)
        earlier = self._earlier[match] if match >= 0 else None
        self._known[self._next] = digests
        self._earlier[self._next] = _EarlierFrame(frame.sequence, frame.t_ns)
        self._next = (self._next + 1) % MAX_COMPARED_FRAMES
        if earlier is None:
            return ""
        age_s = (frame.t_ns - earlier.t_ns) * 1e-9
        return f"{share:.0%} of the picture is that of exposure {earlier.sequence}, {age_s:.2f} s before"

    def _begin(self, frame: Frame, shape: tuple[int, ...]) -> None:
        """Forget the earlier frames, because the frame size changed or a recording is played again."""
        height, width = frame.pixels.shape
        self._shape = shape
        self._playthrough = frame.playthrough
        rows = min(_SAMPLED_ROWS, height)
        spacing = height // rows
        number = np.arange(rows)
        self._rows = number * spacing + number * _ROW_STEP % spacing
        words = width * frame.pixels.itemsize // _LANE_BYTES
        self._width = words * _LANE_BYTES // frame.pixels.itemsize
        self._first_words = np.arange(_BLOCKS_PER_ROW) * words // _BLOCKS_PER_ROW
        self._first_pixels = self._first_words * _LANE_BYTES // frame.pixels.itemsize
        self._sizes = np.diff(np.append(self._first_pixels, self._width))
        self._random = np.random.default_rng()
        factors = self._random.integers(0, 2**63, (rows, words), dtype=np.uint64)
        self._factors = factors * np.uint64(2) + np.uint64(1)
        lane_of_ones = np.ones(_LANE_BYTES // frame.pixels.itemsize, frame.pixels.dtype).view(np.uint64)
        self._uniform_sums = np.add.reduceat(self._factors * lane_of_ones, self._first_words, axis=1)
        self._known = np.zeros((MAX_COMPARED_FRAMES, rows, _BLOCKS_PER_ROW), dtype=np.uint32)
        self._earlier.clear()
        self._next = 0

    def _sample(self, pixels: PixelArray) -> npt.NDArray[Any]:
        return np.ascontiguousarray(pixels[self._rows, : self._width])

    def _digests(self, sample: npt.NDArray[Any]) -> npt.NDArray[np.uint32]:
        """Return the digest of each block, (rows, columns); a random number for a block at one value."""
        words = sample.view(np.uint64)
        sums = np.add.reduceat(words * self._factors, self._first_words, axis=1)
        is_uniform = sums == sample[:, self._first_pixels] * self._uniform_sums
        digests: npt.NDArray[np.uint32] = (sums >> np.uint64(32)).astype(np.uint32)
        digests[is_uniform] = self._random.integers(0, 2**32, np.count_nonzero(is_uniform), dtype=np.uint32)
        return digests

    def _best_match(self, same: npt.NDArray[np.bool_], sample: npt.NDArray[Any]) -> tuple[int, float]:
        """Return the place of the frame with most in common with this one, and the share; −1 if too little.

        ``same`` is (frames, rows, columns).
        """
        differs = np.zeros(sample.shape, dtype=np.bool_)
        np.not_equal(sample[:, 1:], sample[:, :-1], out=differs[:, 1:])
        count = np.add.reduceat(differs.view(np.uint8), self._first_pixels, axis=1, dtype=np.uint32)
        is_usable = count >= _MIN_DIFFERING_SHARE * self._sizes
        sizes = np.broadcast_to(self._sizes, is_usable.shape)[is_usable]
        pixels = same[:, is_usable] @ sizes
        most = int(pixels.argmax())
        if pixels[most] < _MIN_REPEATED_PIXELS or most not in self._earlier:
            return -1, 0.0
        return most, float(pixels[most] / sizes.sum())
