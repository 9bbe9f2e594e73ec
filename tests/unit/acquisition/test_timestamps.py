from __future__ import annotations

import pytest
from support.frames import Blob, frame, light

from altd.acquisition.acquiring import StampCheck
from altd.records import Frame

PIXELS = frame(light(Blob(300, 200))).pixels
S = 1_000_000_000
MS = 1_000_000
NOW = 500_000 * S


def shot(t_ns: int, sequence: int = 7) -> Frame:
    return Frame("front", sequence, t_ns, PIXELS)


@pytest.mark.parametrize("age_ns", [-99 * MS, 0, 30 * MS, 1_900 * MS])
def test_a_frame_that_was_exposed_lately_is_taken(age_ns: int) -> None:
    assert StampCheck().refusal(shot(NOW - age_ns), NOW) == ""


@pytest.mark.parametrize(
    ("t_ns", "why"),
    [
        (NOW + 3600 * S, "exposure 7 is stamped 3600.000 s ahead of the clock"),
        (NOW + 101 * MS, "exposure 7 is stamped 0.101 s ahead of the clock"),
        (NOW - 10 * S, "exposure 7 is 10.000 s old"),
        (0, "exposure 7 is 500000.000 s old"),
    ],
)
def test_a_frame_of_the_future_or_of_long_ago_is_refused_and_costs_no_other(t_ns: int, why: str) -> None:
    check = StampCheck()
    assert check.refusal(shot(NOW - 50 * MS), NOW) == ""
    assert check.refusal(shot(t_ns), NOW) == why
    assert check.refusal(shot(NOW), NOW) == ""


@pytest.mark.parametrize("back_ms", [0, 1, 200])
def test_times_that_stand_or_fall_are_refused_until_they_rise_again(back_ms: int) -> None:
    check = StampCheck()
    assert check.refusal(shot(NOW), NOW) == ""
    said = check.refusal(shot(NOW - back_ms * MS), NOW + 50 * MS)
    assert said == f"exposure 7 is stamped {back_ms / 1000:.3f} s before the one before it"
    assert check.refusal(shot(NOW + 50 * MS), NOW + 50 * MS) == ""
