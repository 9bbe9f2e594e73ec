"""Ways with a wrong camera, or a camera that has moved since its calibration."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np

from altd.records import PixelArray
from benchmarks.campaign.detectability import on_a_plate
from benchmarks.campaign.way import CAMERAS, Draw, OnStream, Registry, Shot, Spoil, drawn, grey, showing

WAYS = Registry("cameras")
_MIDDLE = 375.5, 239.5
"""Centre of a picture, u and v in px."""


@WAYS.add()
def exchanged(draw: Draw) -> Spoil:
    """Front and rear camera exchanged."""
    other = {"front": "rear", "rear": "front"}
    return Spoil("front and rear", stream=_showing_cameras(other))


@WAYS.add()
def one_for_both(draw: Draw) -> Spoil:
    """One camera delivers the frames of both."""
    (only,) = draw.one()
    return Spoil(f"{only} only", stream=_showing_cameras(dict.fromkeys(CAMERAS, only)))


def _showing_cameras(source: Mapping[str, str]) -> OnStream:
    """A stream in which each camera shows the pictures of another one."""
    return lambda shots, onset: showing(shots, onset, lambda shot: (source[shot.camera], shot.k))


@WAYS.on_pixels("left for right")
@drawn()
def mirrored(pixels: PixelArray, bits: int) -> PixelArray:
    """Left and right exchanged."""
    return pixels[:, ::-1]


@WAYS.on_pixels("top for bottom")
@drawn()
def flipped(pixels: PixelArray, bits: int) -> PixelArray:
    """Top and bottom exchanged."""
    return pixels[::-1]


@WAYS.on_pixels("half a turn")
@drawn()
def upside_down(pixels: PixelArray, bits: int) -> PixelArray:
    """Rotated by 180°."""
    return pixels[::-1, ::-1]


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
    directions = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1))
    right, down = (by_px * one for one in directions[draw.whole(0, 5)])
    return Spoil(
        f"{right}, {down} px",
        pixels=lambda pixels, before, bits: np.roll(pixels, (down, right), (0, 1)),
        cameras=draw.targets(),
    )


WAYS.row("shifted_1_px", "Picture shifted by 1 px.", lambda draw: _shifted(draw, 1))
WAYS.row("shifted_2_px", "Picture shifted by 2 px.", lambda draw: _shifted(draw, 2))
WAYS.row("shifted_4_px", "Picture shifted by 4 px.", lambda draw: _shifted(draw, 4))
WAYS.row("shifted_far", "Picture shifted by 8 to 64 px.", lambda draw: _shifted(draw, round(draw.log(8, 64))))


@WAYS.add()
def turned(draw: Draw) -> Spoil:
    """Camera rotated about its axis."""
    degrees = draw.sign() * draw.log(0.1, 1.0)
    return _moved(draw, f"{degrees:+.2f}°", cv2.getRotationMatrix2D(_MIDDLE, degrees, 1.0))


@WAYS.add()
def scaled(draw: Draw) -> Spoil:
    """Picture slightly larger or smaller."""
    scale = 1.0 + draw.sign() * draw.log(0.001, 0.01)
    return _moved(draw, f"{scale - 1:+.2%}", cv2.getRotationMatrix2D(_MIDDLE, 0.0, scale))


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
        lambda n: cv2.getRotationMatrix2D(_MIDDLE, 0.0, 1.0 + rate * n),
    )


@WAYS.add()
def target_loose(draw: Draw) -> Spoil:
    """A loose target or camera rattles: the picture is elsewhere at each exposure, by 0.5 to 8 px."""
    px, seed = draw.log(0.5, 8.0), draw.seed()

    def matrix_of(n: int) -> np.ndarray:
        right, down = np.random.default_rng([seed, n]).normal(0.0, px, 2)
        return np.array([[1, 0, right], [0, 1, down]])

    return _moving(draw, f"by {px:.1f} px", matrix_of)
