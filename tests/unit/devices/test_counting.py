import pytest
from hypothesis import given
from hypothesis import strategies as st

from altd.devices.counting import FrameCounter

VIDEO4LINUX = (0, 2**32 - 1)
GIGE_VISION = (1, 65535)
RANGES = pytest.mark.parametrize("numbers", [VIDEO4LINUX, GIGE_VISION])


def numbered(numbers: tuple[int, int], *raw: int) -> list[int]:
    counter = FrameCounter(*numbers)
    return [counter.number(number) for number in raw]


@RANGES
def test_frames_are_counted_from_zero_wherever_the_camera_begins(numbers: tuple[int, int]) -> None:
    assert numbered(numbers, 17, 18, 19) == [0, 1, 2]


@RANGES
def test_a_lost_frame_is_a_gap(numbers: tuple[int, int]) -> None:
    assert numbered(numbers, 1, 2, 4, 9) == [0, 1, 3, 8]


def test_gige_vision_goes_on_with_1_after_65535() -> None:
    assert numbered(GIGE_VISION, 65534, 65535, 1, 2) == [0, 1, 2, 3]


def test_video4linux_goes_on_with_0_after_its_32_bits() -> None:
    assert numbered(VIDEO4LINUX, 2**32 - 2, 2**32 - 1, 0, 1) == [0, 1, 2, 3]


@RANGES
def test_frames_lost_over_the_wrap_are_a_gap_of_their_number(numbers: tuple[int, int]) -> None:
    first, largest = numbers
    assert numbered(numbers, largest - 1, first + 1) == [0, 3]


@RANGES
@pytest.mark.parametrize("raw", [3, 500, 501], ids=["fell back", "fell back a little", "stands still"])
def test_numbers_that_do_not_go_on_take_the_next_one(numbers: tuple[int, int], raw: int) -> None:
    assert numbered(numbers, 500, 501, raw, raw + 1) == [0, 1, 2, 3]


def test_a_frame_without_a_number_takes_the_next_one_and_so_does_the_one_after_it() -> None:
    assert numbered(GIGE_VISION, 500, 0, 502, 504) == [0, 1, 2, 4]


@RANGES
def test_a_re_opened_camera_never_runs_backwards(numbers: tuple[int, int]) -> None:
    counter = FrameCounter(*numbers)
    assert [counter.number(raw) for raw in (700, 701)] == [0, 1]
    counter.reopened()
    assert [counter.number(raw) for raw in (1, 2)] == [2, 3]
    counter.reopened()
    assert [counter.number(raw) for raw in (60000, 60002)] == [4, 6]


@given(
    start=st.integers(1, 65535),
    steps=st.lists(st.integers(1, 20000), max_size=50),
    numbers=st.sampled_from([VIDEO4LINUX, GIGE_VISION]),
)
def test_a_camera_that_counts_rightly_is_followed_over_any_number_of_wraps(
    start: int, steps: list[int], numbers: tuple[int, int]
) -> None:
    first, largest = numbers
    exposure, counter = start, FrameCounter(*numbers)
    counter.number(exposure)
    for step in steps:
        exposure += step
        assert counter.number(first + (exposure - first) % (largest - first + 1)) == exposure - start
