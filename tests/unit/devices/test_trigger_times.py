"""Instants of software triggers, against the theory of additive random sampling."""

import itertools

import numpy as np
import pytest

from altd.devices.trigger_times import BLOCK_FRAMES, TriggerTimes

MS = 1_000_000
PERIOD_NS = 50 * MS
WINDOW = 20


def instants(triggers: TriggerTimes, first_ns: int, count: int) -> list[int]:
    times_ns = [triggers.after(first_ns)]
    while len(times_ns) < count:
        times_ns.append(triggers.after(times_ns[-1]))
    return times_ns


def test_all_cameras_have_the_same_instants_whenever_they_were_opened() -> None:
    first = instants(TriggerTimes(PERIOD_NS, 25 * MS), 7_000_000_000_000, 300)
    for later in (5, 170):
        assert instants(TriggerTimes(PERIOD_NS, 25 * MS), first[later] + 1, 100) == first[later + 1 :][:100]


@pytest.mark.parametrize(
    ("shortest_ms", "lowest_ms", "highest_ms"), [(0, 25, 75), (40, 40, 60), (70, 50, 50)]
)
def test_the_rate_is_kept_within_the_limits_of_the_intervals(
    shortest_ms: int, lowest_ms: int, highest_ms: int
) -> None:
    triggers = TriggerTimes(PERIOD_NS, 0)
    triggers.lengthen(shortest_ms * MS)
    times_ns = instants(triggers, 64 * 50 * MS * 1000 - 1, 640)
    intervals_ms = np.diff(times_ns) / MS
    assert lowest_ms <= intervals_ms.min() <= lowest_ms + 1
    assert highest_ms - 1 <= intervals_ms.max() <= highest_ms
    begins = [t_ns for t_ns in times_ns if t_ns % (BLOCK_FRAMES * PERIOD_NS) == 0]
    assert len(begins) == 640 // BLOCK_FRAMES


@pytest.mark.parametrize("multiple", [1, 2, 3, 5])
def test_a_vibration_at_a_multiple_of_the_rate_has_independent_phases(multiple: int) -> None:
    """The mean of exp(2πi f t) over a window is zero, its mean square nearly that of such phases, 1/n."""
    triggers = TriggerTimes(PERIOD_NS, 25 * MS)
    times = np.array(instants(triggers, 0, 400 * BLOCK_FRAMES))[: 400 * 60].reshape(-1, WINDOW) / PERIOD_NS
    means = np.exp(2j * np.pi * multiple * times).mean(axis=1)
    assert abs(means.mean()) < 4 / np.sqrt(WINDOW * len(means))
    assert np.square(np.abs(means)).mean() == pytest.approx(1.1 / WINDOW, rel=0.15)
    phases = 2 * np.pi * multiple * times.ravel()
    neighbours = [
        np.exp(1j * (one - other)) for one, other in itertools.pairwise(phases[: 20 * BLOCK_FRAMES])
    ]
    assert abs(np.mean(neighbours)) < 0.1
