import math
from collections.abc import Callable, Iterator
from weakref import WeakSet

import numpy as np
import pytest

from altd.measuring.averaging import mean_spots
from altd.measuring.pairing import Pair, Pairer
from altd.reasons import Reason
from altd.records import FrameSet, MeanSpots, Spot

MS = 1_000_000
PERIOD = 50 * MS


def pairer(by="sequence", cameras=("front", "rear")) -> Pairer[str]:
    return Pairer(cameras, by, max_skew_ns=10 * MS, max_lag_ns=30 * MS)


def sequences(pairs: list[Pair[str]]) -> list[tuple[int, bool]]:
    return [(pair.sequence, not pair.missing) for pair in pairs]


def test_items_of_one_sequence_become_one_exposure_whichever_comes_first() -> None:
    p = pairer()
    assert p.add("front", 7, 0, "f7") == []
    [pair] = p.add("rear", 7, 2 * MS, "r7")
    assert (pair.sequence, pair.t_ns, pair.skew_ns) == (7, MS, 2 * MS)
    assert pair.items == {"front": "f7", "rear": "r7"}
    assert pair.behind_ns == {"front": -MS, "rear": MS}
    assert p.add("rear", 8, PERIOD, "r8") == []
    assert sequences(p.add("front", 8, PERIOD, "f8")) == [(8, True)]


def test_a_frame_whose_partner_was_lost_comes_out_before_the_next_whole_exposure() -> None:
    p = pairer()
    for camera in ("front", "rear"):
        p.add(camera, 0, -PERIOD, "x")
    p.add("front", 1, 0, "f1")
    p.add("front", 2, PERIOD, "f2")
    pairs = p.add("rear", 2, PERIOD, "r2")
    assert sequences(pairs) == [(1, False), (2, True)]
    assert pairs[0].missing == {"rear": Reason.OUT_OF_STEP}


def test_a_camera_that_never_spoke_is_silent() -> None:
    p = pairer()
    out = [pair for n in range(10) for pair in p.add("front", n, n * PERIOD, "f")]
    assert [pair.missing for pair in out] == [{"rear": Reason.CAMERA_SILENT}] * 6


def test_a_camera_that_stops_is_silent_from_its_first_missing_frame_on() -> None:
    p = pairer()
    p.add("rear", 0, 0, "r")
    out = [pair for n in range(20) for pair in p.add("front", n, n * PERIOD, "f")]
    assert [pair.missing.get("rear") for pair in out] == [None] + [Reason.CAMERA_SILENT] * (len(out) - 1)


@pytest.mark.parametrize("by", ["sequence", "time"])
@pytest.mark.parametrize("pause", [range(2), range(7), range(20, 40)], ids=["2 late", "7 late", "returns"])
@pytest.mark.parametrize("of", ["front", "rear"])
def test_a_camera_that_begins_to_deliver_was_silent_not_out_of_step(by: str, pause: range, of: str) -> None:
    p = pairer(by)
    out = []
    for n in range(60):
        for camera in ("front", "rear"):
            if camera != of or n not in pause:
                out += p.add(camera, n, n * PERIOD, n)
    assert {reason for pair in out for reason in pair.missing.values()} == {Reason.CAMERA_SILENT}
    assert p.lost_pairs == sum(bool(pair.missing) for pair in out) == len(pause)


@pytest.mark.parametrize("of", ["front", "rear"])
@pytest.mark.parametrize("late", [1, 2, 7, 500])
def test_by_time_the_numbers_go_on_when_a_camera_begins_later_than_the_other(of: str, late: int) -> None:
    p = pairer("time")
    out = []
    for n in range(late + 20):
        for camera in ("front", "rear"):
            if camera != of:
                out += p.add(camera, n, n * PERIOD, n)
            elif n >= late:
                out += p.add(camera, n - late, n * PERIOD, n)
    assert [pair.sequence for pair in out] == list(range(late + 20))


def test_by_time_no_number_comes_twice_when_cameras_leave_out_exposures_that_they_do_not_count() -> None:
    p = pairer("time")
    left_out = {"front": {5, 12}, "rear": {6, 11, 13}}
    out = []
    for n in range(30):
        for camera, without in left_out.items():
            if n not in without:
                number = n - sum(left < n for left in without)
                out += p.add(camera, number, n * PERIOD, "x")
    numbers = [pair.sequence for pair in out]
    assert numbers == sorted(set(numbers))
    assert p.lost_pairs == 5


def test_pairs_are_lost_by_one_frame_by_both_and_by_their_times() -> None:
    p = pairer()
    without = {3: ("front",), 5: ("front", "rear"), 6: ("front", "rear")}
    lost = []
    for n in range(10):
        for camera in ("front", "rear"):
            if camera not in without.get(n, ()):
                p.add(camera, n, n * PERIOD + 11 * MS * (camera == "rear" and n == 8), "x")
        lost.append(p.lost_pairs)
    assert lost == [0, 0, 0, 0, 1, 1, 1, 3, 4, 4]


def test_equal_numbers_at_different_times_are_out_of_step() -> None:
    p = pairer()
    p.add("front", 5, 0, "f")
    [pair] = p.add("rear", 5, 11 * MS, "r")
    assert pair.missing == {"front": Reason.OUT_OF_STEP, "rear": Reason.OUT_OF_STEP}
    assert pair.items == {}


def test_shifted_numbers_are_out_of_step_not_silent() -> None:
    p = pairer()
    out = []
    for n in range(12):
        out += p.add("front", n, n * PERIOD, "f")
        out += p.add("rear", n + 500, n * PERIOD, "r")
    assert out
    assert all(Reason.OUT_OF_STEP in pair.missing.values() for pair in out)


def test_by_time_the_nearest_frames_pair_whatever_their_numbers() -> None:
    p = pairer("time")
    out = []
    for n in range(5):
        out += p.add("front", n, n * PERIOD, f"f{n}")
        out += p.add("rear", 9000 + n, n * PERIOD + 8 * MS, f"r{n}")
    assert [pair.items for pair in out] == [{"front": f"f{n}", "rear": f"r{n}"} for n in range(5)]
    assert [pair.sequence for pair in out] == list(range(5))


def free_running(
    p: Pairer[int], lag_ms: Callable[[int], float], period_ms: float = 50.0, count: int = 60, first: int = 0
) -> list[Pair[int]]:
    """The pairs of two cameras, the rear one behind by ``lag_ms`` in exposure n, as they are delivered."""
    rng = np.random.default_rng(3)
    frames = []
    for n in range(first, first + count):
        t_ms = n * period_ms
        for camera, at_ms in (("front", t_ms), ("rear", t_ms + lag_ms(n))):
            exposed_ns = round((at_ms + rng.normal(0, 0.3)) * MS)
            delivered_ns = exposed_ns + round(rng.uniform(5, 30) * MS)
            frames.append((delivered_ns, camera, n, exposed_ns))
    return [pair for _, camera, n, t_ns in sorted(frames) for pair in p.add(camera, n, t_ns, n)]


def whole(pairs: list[Pair[int]]) -> list[bool]:
    return [not pair.missing for pair in pairs]


@pytest.mark.parametrize("lag_ms", [-24.0, -15.0, 0.0, 11.0, 24.0, 25.0])
def test_by_time_a_steady_lag_is_learnt_and_taken_off(lag_ms: float) -> None:
    p = pairer("time")
    pairs = free_running(p, lambda n: lag_ms)
    assert all(whole(pairs)[6:])
    assert p.lags_ns["rear"] == pytest.approx(lag_ms * MS, abs=0.5 * MS)
    assert max(pair.skew_ns for pair in pairs[6:]) < 3 * MS
    assert {pair.items["rear"] - pair.items["front"] for pair in pairs[6:]} == {0}


def test_by_time_a_lag_that_creeps_past_half_a_period_costs_two_exposures_each_time() -> None:
    pairs = free_running(pairer("time"), lambda n: n * 0.2, count=1000)  # four periods in the end
    slips = {pair.items["rear"] - pair.items["front"] for pair in pairs if not pair.missing}
    assert slips == {0, -1, -2, -3, -4}
    assert whole(pairs[6:]).count(False) <= 4 * 3


def test_by_time_a_camera_that_is_started_anew_has_a_lag_of_its_own() -> None:
    p = pairer("time")
    free_running(p, lambda n: 20.0)
    pairs = free_running(p, lambda n: -20.0, first=80)
    assert all(whole(pairs)[8:])
    assert p.lags_ns["rear"] == pytest.approx(-20 * MS, abs=0.5 * MS)


def test_by_time_a_lag_beyond_what_is_allowed_is_out_of_step() -> None:
    pairs = free_running(pairer("time"), lambda n: 40.0, period_ms=100.0)
    assert {reason for pair in pairs[1:] for reason in pair.missing.values()} == {Reason.OUT_OF_STEP}
    assert not any(whole(pairs))


def test_by_time_a_frame_off_the_steady_lag_is_out_of_step() -> None:
    pairs = free_running(pairer("time"), lambda n: 20.0 + (12.0 if n == 30 else 0.0))
    bad = [pair for pair in pairs[6:] if pair.missing]
    assert {item for pair in bad for item in pair.all_items} == {30}


def test_by_time_cameras_of_unlike_rates_are_out_of_step() -> None:
    pairs = free_running(pairer("time"), lambda n: n * 25.0)
    assert whole(pairs[6:]).count(True) < len(pairs) / 2


def test_a_frame_that_comes_after_its_exposure_was_given_up_is_counted() -> None:
    p = pairer()
    for n in range(6):
        p.add("front", n, n * PERIOD, "f")
    assert p.add("rear", 0, 0, "late") == []
    assert p.late == 1
    first, *_, last = p.add("rear", 5, 5 * PERIOD, "r")
    assert (first.unpaired, last.unpaired) == (("late",), ())
    assert dict(last.items) == {"front": "f", "rear": "r"}


def test_a_numbering_that_starts_anew_goes_on_pairing() -> None:
    p = pairer()
    for camera in ("front", "rear"):
        p.add(camera, 60_000, 0, "x")
    p.add("front", 1, PERIOD, "f")
    assert sequences(p.add("rear", 1, PERIOD, "r")) == [(1, True)]


def test_three_cameras_pair_too() -> None:
    p = pairer(cameras=("a", "b", "c"))
    assert p.add("a", 1, 0, "a") == p.add("c", 1, 0, "c") == []
    assert sequences(p.add("b", 1, 0, "b")) == [(1, True)]


def test_a_flush_settles_what_waits_in_order() -> None:
    p = pairer()
    p.add("front", 1, 0, "f")
    p.add("rear", 2, PERIOD, "r")
    assert sequences(p.flush()) == [(1, False), (2, False)]
    assert p.flush() == []


def test_by_time_a_frame_near_two_of_the_other_camera_is_given_once() -> None:
    """Stamps (ms) of 30 frames per second with a jitter of 15 ms, reduced to those that matter."""
    front = {212: 0, 213: 50, 215: 105, 216: 148, 223: 363, 224: 444, 225: 453, 226: 465}
    rear = {211: 1, 212: 17, 213: 53, 214: 81, 215: 129, 216: 133, 219: 267, 221: 322, 224: 438, 225: 442}
    stamps = {("front", n): t for n, t in front.items()} | {("rear", n): t for n, t in rear.items()}
    p = pairer("time")
    given = [
        item
        for (camera, n), t in sorted(stamps.items(), key=lambda stamp: stamp[1])
        for pair in p.add(camera, n, t * MS, f"{camera} {n}")
        for item in pair.all_items
    ]
    assert len(given) == len(set(given)) > 10


HOUR = 3600 * 1000 * MS


def lying(
    by: str, lie: Callable[[str, int], tuple[int, int]], silent: range = range(0), lag_ms: float = 20.0
) -> list[bool]:
    """Whether each of 80 exposures was paired with its own partner; the lie is added to number and time."""
    p = pairer(by)
    behind_ns = round(lag_ms * MS) if by == "time" else 0
    paired = set()
    for n in range(80):
        for camera, late_ns in (("front", 0), ("rear", behind_ns)):
            if camera == "rear" and n in silent:
                continue
            number, time_ns = lie(camera, n)
            out = p.add(camera, n + number, n * PERIOD + late_ns + time_ns, str(n))
            paired |= {
                int(pair.items["front"])
                for pair in out
                if len(set(pair.items.values())) == 1 and not pair.missing
            }
    return [n in paired for n in range(80)]


LIES: dict[str, Callable[[str, int], tuple[int, int]]] = {
    "one stamp an hour ahead": lambda camera, n: (0, HOUR * (n == 40 and camera == "front")),
    "the other's stamp an hour ahead": lambda camera, n: (0, HOUR * (n == 40 and camera == "rear")),
    "both stamps an hour ahead": lambda camera, n: (0, HOUR * (n == 40)),
    "an hour ahead for five": lambda camera, n: (0, HOUR * (40 <= n < 45)),
    "one stamp an hour back": lambda camera, n: (0, -HOUR * (n == 40 and camera == "rear")),
    "all stamps 30 ms back": lambda camera, n: (0, -30 * MS * (n >= 40)),
    "all stamps an hour back": lambda camera, n: (0, -HOUR * (n >= 40)),
    "one number 900 ahead": lambda camera, n: (900 * (n == 40 and camera == "front"), 0),
    "the other's number 900 ahead": lambda camera, n: (900 * (n == 40 and camera == "rear"), 0),
    "both numbers 900 ahead once": lambda camera, n: (900 * (n == 40), 0),
    "both numbers 900 ahead": lambda camera, n: (900 * (n >= 40), 0),
    "both numbers 500 back": lambda camera, n: (10_000 - 500 * (n >= 40), 0),
    "one number 500 back": lambda camera, n: (10_000 - 500 * (n == 40 and camera == "front"), 0),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("by", ["sequence", "time"])
@pytest.mark.parametrize("silent", [range(0), range(41, 47)], ids=["both deliver", "rear pauses"])
def test_one_lie_costs_a_second_of_good_exposures_at_most(by: str, lie: str, silent: range) -> None:
    paired = lying(by, LIES[lie], silent)
    assert all(paired[10:40])
    bad_until = max(46, silent.stop)
    assert all(paired[bad_until + 20 : 78]), [n for n, whole in enumerate(paired) if not whole]


def test_by_time_an_exposure_without_the_first_camera_keeps_its_number() -> None:
    p = pairer("time")
    out = []
    for n in range(12):
        if n != 5:
            out += p.add("front", n, n * PERIOD, "f")
        out += p.add("rear", 7000 + n, n * PERIOD, "r")
    assert [pair.sequence for pair in out] == list(range(12))


@pytest.mark.parametrize(("by", "lost"), [("sequence", 0.3), ("time", 0.2)])
def test_exposures_come_out_in_their_order_whatever_is_lost(by: str, lost: float) -> None:
    rng = np.random.default_rng(6)
    p = pairer(by)
    out = []
    for n in range(2000):
        for camera in ("front", "rear"):
            if n < 20 or rng.random() >= lost:
                out += p.add(camera, n, n * PERIOD, n)
    times = [pair.t_ns for pair in out]
    assert len(out) > 1500
    assert times == sorted(set(times))
    assert [pair.sequence for pair in out] == sorted({pair.sequence for pair in out})


class Picture:
    """Something that takes memory."""


def chance_numbers() -> Iterator[tuple[str, int, int]]:
    """Cameras of any rate, whose numbers and times jump in both directions."""
    random, t = np.random.default_rng(7), 0
    for n in range(20_000):
        t += int(random.integers(0, 60 * MS))
        camera = ("front", "rear")[int(random.random() < random.choice([0.1, 0.5, 0.9]))]
        number = n // 2 + int(random.choice([0, 0, 0, -3, 3, -10_000, 10_000]))
        yield camera, number, t + int(random.choice([0, 0, 0, -900, 900])) * MS


def numbers_that_settle_nothing() -> Iterator[tuple[str, int, int]]:
    """One far ahead, then four too late, and again."""
    for n in range(2_000):
        yield "rear", 10**6 if n % 5 == 0 else -n, 0


@pytest.mark.parametrize("by", ["sequence", "time"])
@pytest.mark.parametrize("numbers", [chance_numbers, numbers_that_settle_nothing])
def test_no_numbers_keep_many_frames_in_memory_or_give_one_twice(
    numbers: Callable[[], Iterator[tuple[str, int, int]]], by: str
) -> None:
    p = pairer(by)
    alive, out = WeakSet[Picture](), WeakSet[Picture]()
    for camera, number, t_ns in numbers():
        picture = Picture()
        alive.add(picture)
        pairs = p.add(camera, number, t_ns, picture)  # type: ignore[arg-type]
        for item in (item for pair in pairs for item in pair.all_items):
            assert item not in out
            out.add(item)  # type: ignore[arg-type]
        del picture, pairs
        item = None
        assert len(alive) <= 20


PERIOD_MS = 100 / 3
Rows = np.ndarray[tuple[int, int], np.dtype[np.float64]]


class Jittery:
    """Two free-running cameras at 30 frames per second, the rear one 0.3 periods behind.

    A frame is a row of true time, number, stamp and time of delivery; times in ms.
    """

    def __init__(self, jitter_ms: float, count: int = 400) -> None:
        random = np.random.default_rng(66)
        self.frames: dict[str, Rows] = {}
        for camera, lag in (("front", 0.0), ("rear", 0.3)):
            true_ms = (np.arange(count) + lag) * PERIOD_MS
            stamps_ms = np.maximum.accumulate(true_ms + random.normal(0, jitter_ms, count))
            self.frames[camera] = np.column_stack([true_ms, np.arange(count), stamps_ms, stamps_ms + 5])

    def pairs(self) -> list[Pair[float]]:
        """The whole frame sets; their items are true times, ms."""
        p: Pairer[float] = Pairer(("front", "rear"), "time", max_skew_ns=10 * MS, max_lag_ns=40 * MS)
        frames = [(*frame, camera) for camera in self.frames for frame in self.frames[camera].tolist()]
        return [
            pair
            for true_ms, number, stamp_ms, _, camera in sorted(frames, key=lambda frame: frame[3])
            for pair in p.add(camera, round(number), round(stamp_ms * MS), true_ms)
            if not pair.missing
        ]


def lost(frames: Rows) -> Rows:
    """Frames are lost and not counted."""
    kept = np.delete(frames, [150, 200, 201, 202, 250, 300], axis=0)
    kept[:, 1] = np.arange(len(kept))
    return kept


def stalled(frames: Rows) -> Rows:
    """Nine old frames arrive at once and are stamped then."""
    for begin in (100, 200, 300):
        frames[begin : begin + 9, 2:] = frames[begin + 8, 2] + np.arange(9)[:, None] * 0.5
    return frames


def a_period_off(frames: Rows) -> Rows:
    """Single stamps and numbers are a period later or earlier."""
    frames[[150, 250], 2] += PERIOD_MS
    frames[[200, 300], 2] -= PERIOD_MS
    frames[[170, 270], 1] += 1
    frames[[220, 320], 1] -= 1
    return frames


def stepped(frames: Rows) -> Rows:
    """The clock steps by 0.4 periods forth and back."""
    frames[150:250, 2:] += 0.4 * PERIOD_MS
    return frames


def halved(frames: Rows) -> Rows:
    """The rate drops to a half in the dark."""
    n = np.arange(len(frames))
    kept = frames[(n < 150) | (n >= 250) | (n % 2 == 0)]
    kept[:, 1] = np.arange(len(kept))
    return kept


@pytest.mark.parametrize("jitter_ms", [0.2, 4.0])
@pytest.mark.parametrize("cameras", [("rear",), ("front", "rear")], ids=["rear", "both"])
@pytest.mark.parametrize(
    ("disturb", "least"), [(lost, 370), (stalled, 360), (a_period_off, 375), (stepped, 380), (halved, 300)]
)
def test_by_time_a_disturbed_camera_never_gives_frames_of_two_periods(
    disturb: Callable[[Rows], Rows], least: int, cameras: tuple[str, ...], jitter_ms: float
) -> None:
    unit = Jittery(jitter_ms)
    for camera in cameras:
        unit.frames[camera] = disturb(unit.frames[camera])
    apart_ms = [abs(pair.items["rear"] - pair.items["front"]) for pair in unit.pairs()]
    assert max(apart_ms) < 0.75 * PERIOD_MS
    assert len(apart_ms) >= least


def test_by_time_a_jitter_beyond_a_fifth_of_the_period_gives_no_frame_sets() -> None:
    assert len(Jittery(15.0).pairs()) < 10


@pytest.mark.parametrize("sizes", [(1, 2), (2, 2), (2, 3), (1, 4)])
@pytest.mark.parametrize("lag", [0.0, 0.25, 0.5, 0.75])
def test_by_time_frames_stamped_as_they_arrive_in_bursts_give_no_sets_of_two_periods(
    lag: float, sizes: tuple[int, int]
) -> None:
    """Stamps of a burst tell nothing of its exposures; each is near several frames of the other camera."""
    unit = Jittery(0.2)
    unit.frames["rear"][:, [0, 2, 3]] += (lag - 0.3) * PERIOD_MS
    for (camera, frames), size in zip(unit.frames.items(), sizes, strict=True):
        last = np.minimum(np.arange(len(frames)) // size * size + size - 1, len(frames) - 1)
        frames[:, 2:] = frames[last, 2:] - 0.3 * (last - np.arange(len(frames)))[:, None]
        unit.frames[camera] = frames
    apart_ms = [abs(pair.items["rear"] - pair.items["front"]) for pair in unit.pairs()]
    # The first burst is not yet known.
    assert [each for each in apart_ms[1:] if each > 0.85 * PERIOD_MS] == []


def test_by_time_uneven_triggers_are_no_bursts() -> None:
    """Intervals as those of ``trigger = "software"``, and 2 ms of jitter."""
    unit = Jittery(0.0)
    random = np.random.default_rng(2)
    triggers_ms = np.cumsum(random.uniform(0.5, 1.5, 400)) * PERIOD_MS
    for frames in unit.frames.values():
        frames[:, 0] = triggers_ms
        frames[:, 2:] = (triggers_ms + random.normal(0, 2.0, 400))[:, None]
    assert len(unit.pairs()) > 390


def test_by_time_the_jitter_of_the_stamps_is_in_sigma_of_moving_spots() -> None:
    """At 5 mm/s (20 px/s) with a noise of 0.04 px, means of 20 frame sets against the motion itself."""
    random, window, noise_px, px_per_ms = np.random.default_rng(5), 20, 0.04, 0.02

    def spot(true_ms: float) -> Spot:
        du_px, dv_px = random.normal(0, noise_px, 2).tolist()
        return Spot(px_per_ms * true_ms + du_px, 100.0 + dv_px, noise_px, 44.0, 180.0)

    ratios = []
    pairs = Jittery(4.0, count=4000).pairs()[40:]
    for begin in range(0, len(pairs) - window, window):
        sets = [
            FrameSet(n, pair.t_ns, {camera: spot(ms) for camera, ms in pair.items.items()}, pair.behind_ns)
            for n, pair in enumerate(pairs[begin : begin + window])
        ]
        mean = mean_spots(sets, ("front", "rear"), window)
        assert isinstance(mean, MeanSpots)
        of_difference = np.array([-1.0, 0.0, 1.0, 0.0])
        sigma_px = math.sqrt(of_difference @ mean.covariance_px2 @ of_difference)
        ratios.append((of_difference @ mean.px.ravel()) / sigma_px)
    assert len(ratios) > 150
    assert 0.8 < math.sqrt(np.square(ratios).mean()) < 1.25
