from __future__ import annotations

import numpy as np
import pytest

from altd.devices.v4l2.image import PIXEL_FORMATS, Layout, Stamp, middle_of_exposure_ns

NOW_NS = 5_000_000_000_000


def test_lines_are_read_without_their_padding() -> None:
    layout = Layout(3, 2, 4, PIXEL_FORMATS["GREY"])
    pixels = layout.pixels(bytes([1, 2, 3, 99, 4, 5, 6, 99]))
    assert pixels.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert pixels.dtype == np.uint8


@pytest.mark.parametrize("name", ["Y10", "Y12", "Y16"])
def test_two_bytes_a_pixel_come_with_the_low_one_first(name: str) -> None:
    layout = Layout(2, 1, 4, PIXEL_FORMATS[name])
    pixels = layout.pixels(bytes([0x34, 0x02, 0xFF, 0x00]))
    assert pixels.tolist() == [[0x234, 0xFF]]
    assert pixels.dtype == np.uint16


def test_a_frame_is_read_only_and_stays_when_its_buffer_is_filled_again() -> None:
    buffer = bytearray(range(6))
    pixels = Layout(3, 2, 3, PIXEL_FORMATS["GREY"]).pixels(memoryview(buffer))
    buffer[:] = bytes(6)
    assert pixels.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert not pixels.flags.writeable


def test_the_last_line_may_come_without_its_padding() -> None:
    layout = Layout(3, 2, 4, PIXEL_FORMATS["GREY"])
    assert layout.frame_bytes == 7
    assert layout.pixels(bytes([1, 2, 3, 99, 4, 5, 6])).tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.raises((TypeError, ValueError)):
        layout.pixels(bytes(6))


@pytest.mark.parametrize(
    ("source", "exposure_ms", "middle_ns"),
    [
        (Stamp.START_OF_EXPOSURE, 4.0, NOW_NS + 2_000_000),
        (Stamp.END_OF_FRAME, 4.0, NOW_NS - 2_000_000),
        (Stamp.START_OF_EXPOSURE, None, NOW_NS),
        (Stamp.END_OF_FRAME, None, NOW_NS),
    ],
)
def test_half_the_exposure_lies_between_stamp_and_middle(
    source: Stamp, exposure_ms: float | None, middle_ns: int
) -> None:
    assert middle_of_exposure_ns(NOW_NS, "monotonic", source, exposure_ms, NOW_NS + 1) == middle_ns


@pytest.mark.parametrize(
    ("clock", "stamp_ns", "taken_ns"),
    [
        ("unknown", NOW_NS - 30_000_000, NOW_NS - 30_000_000),  # v4l2loopback: it is the monotonic clock
        ("unknown", 0, NOW_NS),
        ("unknown", 1_790_000_000_000_000_000, NOW_NS),  # the time of day
        ("monotonic", NOW_NS - 3_000_000_000, NOW_NS - 3_000_000_000),  # waited long to be taken
    ],
)
def test_a_stamp_of_an_unknown_clock_counts_only_when_it_can_be_the_monotonic_one(
    clock: str, stamp_ns: int, taken_ns: int
) -> None:
    assert middle_of_exposure_ns(stamp_ns, clock, Stamp.END_OF_FRAME, None, NOW_NS) == taken_ns
