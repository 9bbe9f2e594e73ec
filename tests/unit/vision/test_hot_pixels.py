import numpy as np
import pytest
from support.frames import Blob, frame, light

from altd.vision.hot_pixels import HotPixelCount, HotPixels, SensorMatch, hot_pixels

PLACES = [(40, 30), (700, 20), (333, 222), (90, 400), (500, 450), (610, 250), (200, 100), (420, 60)]
"""Pixels (u, v) that shine, clear of the spot."""


def picture(rng: np.random.Generator, places: list[tuple[int, int]], counts: float = 80.0) -> np.ndarray:
    image = light(Blob(375, 240))
    for u, v in places:
        image[v, u] += counts
    return frame(image, rng).pixels


@pytest.fixture(scope="module")
def known() -> HotPixels:
    rng = np.random.default_rng(0)
    count = HotPixelCount()
    for _ in range(10):
        count.add(picture(rng, PLACES))
    return count.result()


def compared(known: HotPixels, pixels: np.ndarray) -> SensorMatch:
    return known.compare(np.ascontiguousarray(pixels))


def test_those_that_shine_in_every_frame_are_found_and_no_others(known: HotPixels) -> None:
    assert sorted(map(tuple, known.permanent.tolist())) == sorted(PLACES)
    assert known.intermittent.shape == (0, 2)


def test_they_are_found_in_each_row_but_the_first_and_the_last() -> None:
    image = np.zeros((480, 752))
    places = [(5 + 31 * row % 740, row) for row in range(480)]
    for u, v in places:
        image[v, u] = 80.0
    found = hot_pixels(frame(image, np.random.default_rng(9)).pixels)
    assert list(map(tuple, found.tolist())) == places[1:-1]


def test_what_a_lens_images_is_none_however_small() -> None:
    """A point of light behind a blur of 0.6 px; printed dots are larger."""
    v, u = np.mgrid[:480, :752]
    dots = sum(120 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 0.6**2)) for x, y in PLACES)
    assert len(hot_pixels(frame(dots, np.random.default_rng(1)).pixels)) == 0


def test_noise_alone_has_none_in_a_thousand_million_pixels() -> None:
    """Scaled to what a test can wait for: 40 frames, 14 million pixels, where 7 sigma are expected never."""
    rng = np.random.default_rng(2)
    assert sum(len(hot_pixels(frame(np.zeros((480, 752)), rng).pixels)) for _ in range(40)) == 0


@pytest.mark.parametrize("seed", range(1, 9))
def test_a_hot_pixel_is_what_its_eight_neighbours_say_one_by_one(seed: int) -> None:
    """Looked at pixel by pixel: noise, steps, single points, 8 and 16 bits, odd sizes, in all of a frame."""
    rng = np.random.default_rng(seed)
    rows, columns = (int(size) for size in rng.integers(3, 48, 2))
    full_scale = 255 if seed % 2 else 65535
    image = rng.normal(0.2, 0.02 * (seed // 4), (rows, columns))
    image += 0.3 * (rng.random(columns) < 0.05)
    image[rng.random((rows, columns)) < 0.02] += 0.4
    pixels = np.clip(full_scale * image, 0, full_scale).astype(np.uint8 if seed % 2 else np.uint16)

    grey = pixels.astype(int)

    def neighbours(v: int, u: int) -> list[int]:
        around = [(v + dv, u + du) for dv in (-1, 0, 1) for du in (-1, 0, 1) if dv or du]
        return [int(grey[at]) for at in around if 0 <= at[0] < rows and 0 <= at[1] < columns]

    ranges = [
        max(around) - min(around)
        for v in range(0, rows, 9)
        for u in range(0, columns, 9)
        if (around := neighbours(v, u))
    ]
    hot = [
        [u, v]
        for v in range(1, rows - 1)
        for u in range(1, columns - 1)
        if (around := neighbours(v, u))
        and grey[v, u] - min(around) > 5 * max(max(around) - min(around), int(np.median(ranges))) + 3
    ]
    assert hot_pixels(pixels).tolist() == hot != []


def test_the_same_sensor_is_known_again_in_another_light(known: HotPixels) -> None:
    seen = compared(known, picture(np.random.default_rng(3), PLACES, counts=160.0))
    assert (seen.is_same, seen.is_other, seen.foreign) == (True, False, 0)


@pytest.mark.parametrize("turn", ["mirrored", "upside down", "another sensor"])
def test_other_hot_pixels_are_another_sensor(known: HotPixels, turn: str) -> None:
    rng = np.random.default_rng(4)
    pixels = picture(rng, PLACES)
    if turn == "mirrored":
        pixels = pixels[:, ::-1]
    elif turn == "upside down":
        pixels = pixels[::-1]
    else:
        pixels = picture(rng, [(int(u), int(v)) for u, v in rng.integers((9, 9), (740, 150), (8, 2))])
    seen = compared(known, pixels)
    assert (seen.is_same, seen.is_other, seen.offset_px) == (False, True, None)


@pytest.mark.parametrize("by", [(1, 0), (0, -1), (4, 3), (-12, 5)])
def test_another_part_of_the_sensor_is_told_with_its_offset(known: HotPixels, by: tuple[int, int]) -> None:
    pixels = np.roll(picture(np.random.default_rng(5), PLACES), by, axis=(1, 0))
    seen = compared(known, pixels)
    assert (seen.is_other, seen.offset_px) == (True, by)


def test_a_cold_sensor_whose_hot_pixels_faded_is_neither(known: HotPixels) -> None:
    seen = compared(known, picture(np.random.default_rng(6), []))
    assert (seen.is_same, seen.is_other) == (False, False)


def test_an_aged_sensor_with_as_many_new_ones_is_the_same(known: HotPixels) -> None:
    new = [(60 + 70 * n, 130) for n in range(8)]
    seen = compared(known, picture(np.random.default_rng(7), PLACES + new))
    assert (seen.is_same, seen.is_other) == (True, False)


@pytest.mark.parametrize("lost_px", [-300, -1, 3, 20])
def test_a_picture_of_which_bytes_were_lost_is_not_as_it_was_read(known: HotPixels, lost_px: int) -> None:
    """The rows after the loss are displaced, row by row; those before it are in their place."""
    pixels = picture(np.random.default_rng(8), PLACES)
    row = 210
    pixels.reshape(-1)[row * 752 :] = np.roll(pixels.reshape(-1)[row * 752 :], lost_px)
    seen = compared(known, pixels)
    assert (seen.present, seen.displaced) == (4, 4)
    assert seen.is_other
