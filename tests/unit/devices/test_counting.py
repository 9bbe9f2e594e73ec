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
@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        ((17, 18, 19), [0, 1, 2]),
        ((1, 2, 4, 9), [0, 1, 3, 8]),
        ((500, 501, 3, 4), [0, 1, 2, 3]),
        ((500, 501, 500, 501), [0, 1, 2, 3]),
        ((500, 501, 501, 502), [0, 1, 2, 3]),
    ],
    ids=["from zero wherever it begins", "lost", "fell back", "fell back a little", "stands still"],
)
def test_frames_are_counted_and_lost_ones_are_a_gap(
    numbers: tuple[int, int], raw: tuple[int, ...], expected: list[int]
) -> None:
    assert numbered(numbers, *raw) == expected


@pytest.mark.parametrize(
    ("numbers", "raw", "expected"),
    [
        (GIGE_VISION, (65534, 65535, 1, 2), [0, 1, 2, 3]),
        (VIDEO4LINUX, (2**32 - 2, 2**32 - 1, 0, 1), [0, 1, 2, 3]),
        (GIGE_VISION, (500, 0, 502, 504), [0, 1, 2, 4]),  # 0: a frame without a number
    ],
)
def test_numbers_wrap_as_the_standard_says(
    numbers: tuple[int, int], raw: tuple[int, ...], expected: list[int]
) -> None:
    assert numbered(numbers, *raw) == expected


@RANGES
def test_frames_lost_over_the_wrap_are_a_gap_of_their_number(numbers: tuple[int, int]) -> None:
    first, largest = numbers
    assert numbered(numbers, largest - 1, first + 1) == [0, 3]


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
