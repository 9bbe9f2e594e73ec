"""Ways with a wrong camera, or a camera that has moved since its calibration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from altd.records import PixelArray
from benchmarks.campaign.detectability import on_a_plate
from benchmarks.campaign.way import Draw, Registry, Shot, Spoil, grey, showing

WAYS = Registry("cameras")


@WAYS.add()
def exchanged(draw: Draw) -> Spoil:
    """Front and rear camera exchanged."""
    other = {"front": "rear", "rear": "front"}

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        return showing(shots, onset, lambda shot: (other[shot.camera], shot.k))

    return Spoil("front and rear", stream=stream)


@WAYS.add()
def one_for_both(draw: Draw) -> Spoil:
    """One camera delivers the frames of both."""
    (only,) = draw.one()

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        return showing(shots, onset, lambda shot: (only, shot.k))

    return Spoil(f"{only} only", stream=stream)


def _turned_over(draw: Draw, axis: int, words: str) -> Spoil:
    return Spoil(
        words,
        pixels=lambda pixels, before, bits: np.ascontiguousarray(
            pixels[::-1, ::-1] if axis < 0 else np.flip(pixels, axis)
        ),
        cameras=draw.targets(),
    )


@WAYS.add()
def mirrored(draw: Draw) -> Spoil:
    """Left and right exchanged."""
    return _turned_over(draw, 1, "left for right")


@WAYS.add()
def flipped(draw: Draw) -> Spoil:
    """Top and bottom exchanged."""
    return _turned_over(draw, 0, "top for bottom")


@WAYS.add()
def upside_down(draw: Draw) -> Spoil:
    """Rotated by 180°."""
    return _turned_over(draw, -1, "half a turn")


def _mapped(pixels: PixelArray, matrix: np.ndarray, bits: int) -> PixelArray:
    """A picture after an affine map."""
    rows, columns = pixels.shape
    warped = cv2.warpAffine(
        pixels, matrix, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return grey(np.minimum(warped, (1 << bits) - 1), pixels)


def _moved(draw: Draw, note: str, matrix: np.ndarray) -> Spoil:
    """Pictures of some cameras after an affine map."""
    cameras = draw.targets()
    return Spoil(
        note,
        pixels=lambda pixels, before, bits: _mapped(pixels, matrix, bits),
        cameras=cameras,
        undetectable=on_a_plate(cameras),
    )


def _moving(draw: Draw, note: str, matrix_of: Callable[[int], np.ndarray]) -> Spoil:
    """Pictures of some cameras after a map that changes with each exposure since the onset."""
    cameras = draw.targets()

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        return [
            replace(shot, pixels=_mapped(shot.pixels, matrix_of(shot.k - onset), shot.bits))
            if shot.k >= onset and shot.camera in cameras
            else shot
            for shot in shots
        ]

    return Spoil(note, stream=stream, cameras=cameras, undetectable=on_a_plate(cameras))


def _shifted(draw: Draw, by_px: int) -> Spoil:
    """Shift by whole pixels, as when another region of the sensor is read."""
    right, down = ((by_px, 0), (0, by_px), (-by_px, 0), (0, -by_px), (by_px, by_px), (-by_px, by_px))[
        draw.whole(0, 5)
    ]

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        return np.roll(pixels, (down, right), (0, 1))

    return Spoil(f"{right}, {down} px", pixels=change, cameras=draw.targets())


@WAYS.add()
def shifted_1_px(draw: Draw) -> Spoil:
    """Picture shifted by 1 px."""
    return _shifted(draw, 1)


@WAYS.add()
def shifted_2_px(draw: Draw) -> Spoil:
    """Picture shifted by 2 px."""
    return _shifted(draw, 2)


@WAYS.add()
def shifted_4_px(draw: Draw) -> Spoil:
    """Picture shifted by 4 px."""
    return _shifted(draw, 4)


@WAYS.add()
def shifted_far(draw: Draw) -> Spoil:
    """Picture shifted by 8 to 64 px."""
    return _shifted(draw, round(draw.log(8, 64)))


@WAYS.add()
def turned(draw: Draw) -> Spoil:
    """Camera rotated about its axis."""
    degrees = draw.sign() * draw.log(0.1, 1.0)
    matrix = cv2.getRotationMatrix2D((375.5, 239.5), degrees, 1.0)
    return _moved(draw, f"{degrees:+.2f}°", matrix)


@WAYS.add()
def scaled(draw: Draw) -> Spoil:
    """Picture slightly larger or smaller."""
    scale = 1.0 + draw.sign() * draw.log(0.001, 0.01)
    matrix = cv2.getRotationMatrix2D((375.5, 239.5), 0.0, scale)
    return _moved(draw, f"{scale - 1:+.2%}", matrix)


@WAYS.add()
def tilted(draw: Draw) -> Spoil:
    """Camera tilted: one side of the picture is stretched."""
    lean, angle = draw.log(0.002, 0.02), draw.angle()

    def change(pixels: PixelArray, before: PixelArray | None, bits: int) -> PixelArray:
        rows, columns = pixels.shape
        half = max(rows, columns) / 2
        to_middle = np.array([[1, 0, -columns / 2], [0, 1, -rows / 2], [0, 0, 1.0]])
        bent = np.array(
            [[1, 0, 0], [0, 1, 0], [lean * math.cos(angle) / half, lean * math.sin(angle) / half, 1.0]]
        )
        matrix = np.linalg.inv(to_middle) @ bent @ to_middle
        warped = cv2.warpPerspective(pixels, matrix, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
        return grey(warped, pixels)

    cameras = draw.one()
    return Spoil(f"by {lean:.3f}", pixels=change, cameras=cameras, undetectable=on_a_plate(cameras))


@WAYS.add()
def slow_drift(draw: Draw) -> Spoil:
    """A camera's mount gives way: its picture creeps by 0.3 to 3 px a second."""
    px, angle = draw.log(0.3, 3.0) / 20, draw.angle()
    right, down = px * math.cos(angle), px * math.sin(angle)
    return _moving(
        draw, f"{20 * px:.1f} px a second", lambda n: np.array([[1, 0, right * n], [0, 1, down * n]])
    )


@WAYS.add()
def thermal_growth(draw: Draw) -> Spoil:
    """Lens and mount warm up: the picture grows or shrinks by 0.01 to 0.3 % a second."""
    rate = draw.sign() * draw.log(0.0001, 0.003) / 20
    return _moving(
        draw,
        f"{20 * rate:+.2%} a second",
        lambda n: cv2.getRotationMatrix2D((375.5, 239.5), 0.0, 1.0 + rate * n),
    )


@WAYS.add()
def target_loose(draw: Draw) -> Spoil:
    """A loose target or camera rattles: the picture is elsewhere at each exposure, by 0.5 to 8 px."""
    px, seed = draw.log(0.5, 8.0), draw.seed()

    def matrix_of(n: int) -> np.ndarray:
        right, down = np.random.default_rng([seed, n]).normal(0.0, px, 2)
        return np.array([[1, 0, right], [0, 1, down]])

    return _moving(draw, f"by {px:.1f} px", matrix_of)
