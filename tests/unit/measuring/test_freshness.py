from dataclasses import replace

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.measuring.freshness import MAX_COMPARED_FRAMES, FreshnessCheck
from altd.records import Frame

SPOT = light(Blob(300.0, 200.0))
PERIOD_NS = 50_000_000


def live(count: int, seed: int = 0, bits: int = 8, noise: float = 2.0, dark: float = 8.0) -> list[Frame]:
    """Frames of a beam at rest, as a camera delivers them."""
    rng = np.random.default_rng(seed)
    image = SPOT * (1 << bits) / 256
    return [frame(image, rng, noise, dark, bits, sequence=n, t_ns=n * PERIOD_NS) for n in range(count)]


def again(old: Frame, sequence: int, pixels: np.ndarray | None = None) -> Frame:
    """A picture with a new number and time."""
    shown = old.pixels if pixels is None else pixels
    return replace(old, sequence=sequence, t_ns=sequence * PERIOD_NS, pixels=shown)


def repeats(frames: list[Frame]) -> list[int]:
    check = FreshnessCheck()
    return [frame.sequence for frame in frames if check.repeated(frame)]


@pytest.mark.parametrize("value", [0, 40, 255])
def test_a_picture_of_one_value_says_nothing(value: int) -> None:
    even = Frame("front", 0, 0, np.full((HEIGHT, WIDTH), value, np.uint8))
    assert repeats([again(even, n) for n in range(10)]) == []


@pytest.mark.parametrize("bits", [8, 12])
def test_a_frozen_camera_is_seen_in_its_first_frame_that_is_not_new(bits: int) -> None:
    frames = live(10, bits=bits)
    frozen = [again(frames[-1], n) for n in range(10, 40)]
    assert repeats(frames + frozen) == list(range(10, 40))


@pytest.mark.parametrize("length", [1, 2, 3, 7, 60, MAX_COMPARED_FRAMES])
def test_a_loop_of_frames_is_seen_from_its_second_turn_on(length: int) -> None:
    loop = live(length)
    played = [again(loop[n % length], n) for n in range(2 * length)]
    assert repeats(played) == list(range(length, 2 * length))


def test_frames_that_come_twice_are_seen_once_each() -> None:
    doubled = [again(taken, 2 * n + k) for n, taken in enumerate(live(20)) for k in (0, 1)]
    assert repeats(doubled) == list(range(1, 40, 2))


def test_a_few_equal_pixels_are_chance() -> None:
    """Three blocks of 94 pixels are those of an earlier frame."""
    frames = live(6)
    frames[-1].pixels[0, :282] = frames[0].pixels[0, :282]
    assert repeats(frames) == []


def spoilt(kind: str, old: np.ndarray, new: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An old picture of which only a part is new."""
    picture = old.copy()
    if kind == "counter":
        picture[:24, :200] = rng.integers(0, 2, (24, 200)) * 255
    elif kind == "few pixels":
        picture = np.where(rng.random(old.shape) < 0.01, new, old)
    elif kind == "upper half":
        picture[: HEIGHT // 2] = new[: HEIGHT // 2]
    elif kind == "left half":
        picture[:, : WIDTH // 2] = new[:, : WIDTH // 2]
    elif kind == "odd rows":
        picture[1::2] = new[1::2]
    elif kind == "even rows":
        picture[0::2] = new[0::2]
    elif kind == "all but the spot":
        old_spot = old[170:230, 270:330].copy()
        picture = new.copy()
        picture[170:230, 270:330] = old_spot
        picture[170:230, 188:376] = old[170:230, 188:376]
    return picture


@pytest.mark.parametrize(
    "kind", ["counter", "few pixels", "upper half", "left half", "odd rows", "even rows", "all but the spot"]
)
def test_a_picture_of_which_a_part_stands_still_is_seen(kind: str) -> None:
    rng = np.random.default_rng(3)
    frames = live(20)
    shown = frames[:10] + [
        again(frames[n], n, spoilt(kind, frames[9].pixels, frames[n].pixels, rng)) for n in range(10, 20)
    ]
    assert repeats(shown) == list(range(10, 20))


def test_it_is_told_how_much_comes_again_and_of_which_exposure() -> None:
    frames = live(5)
    check = FreshnessCheck()
    for taken in frames:
        assert check.repeated(taken) == ""
    assert check.repeated(again(frames[2], 5)) == "100% of the picture is that of exposure 2, 0.15 s before"


def test_a_recording_that_is_played_again_is_meant_to_and_one_that_stood_still_is_not() -> None:
    frames = live(8)
    turns = [
        replace(again(f, 8 * turn + n), playthrough=turn) for turn in range(3) for n, f in enumerate(frames)
    ]
    assert repeats(turns) == []
    frames[5] = again(frames[4], 5)
    turns = [
        replace(again(f, 8 * turn + n), playthrough=turn) for turn in range(3) for n, f in enumerate(frames)
    ]
    assert repeats(turns) == [5, 13, 21]


@pytest.mark.parametrize("shape", [(16, 16), (64, 64), (61, 75), (1080, 1440)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_of_any_size_are_compared(shape: tuple[int, int], kind: type) -> None:
    rng = np.random.default_rng(1)
    frames = [
        Frame("front", n, n * PERIOD_NS, rng.normal(100, 3, shape).astype(kind), 8 * kind(0).itemsize)
        for n in range(6)
    ]
    assert repeats(frames) == []
    if shape[0] > 16:  # 256 pixels, of which a row's last few are not looked at
        assert repeats([*frames, again(frames[3], 6)]) == [6]
