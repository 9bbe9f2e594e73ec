"""When a frame is examined, and the effect of the verdicts; the verdicts themselves are scripted here."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from unittest.mock import Mock

import numpy as np
import pytest
from support.evidence import straight_map
from support.frames import Blob, frame, light

from altd.measuring.calibration import TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.measuring.view_check import ViewCheck
from altd.reasons import Reason
from altd.records import CameraIdentity, FaultCause, NoSpot, Spot
from altd.vision.fingerprint import Fingerprint, ViewOutcome, ViewVerdict
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.settings import SpotSettings
from altd.vision.texture import TextureSample

PICTURE = frame(light(Blob(300, 200)))
SPOT = Spot(300.0, 200.0, 0.01, 44.0, 150.0)
NO_SPOT = NoSpot(Reason.SPOT_MISSING)
PERIOD_NS = 50_000_000

GOOD = ViewVerdict(ViewOutcome.VERIFIED, shift_px=0.04)
DOUBT = ViewVerdict.undecided("nothing is known of the target under the spot")
NOTHING_KNOWN = Fingerprint(HotPixels(places_of([]), places_of([])), None, None)
FAINT = replace(
    ViewVerdict.undecided("too little is seen of the target"),
    faint=TextureSample(0, 0, np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32)),
)
WRONG = ViewVerdict.refuted("another print is seen", FaultCause.OTHER_TARGET)
OTHER_SENSOR = replace(
    ViewVerdict.refuted("0 of 20 hot pixels are in their places", FaultCause.OTHER_CAMERA),
    is_other_sensor=True,
)
SAME_SENSOR = replace(ViewVerdict.undecided("no spot to see it by"), is_same_sensor=True)


@dataclass
class Bench:
    check: ViewCheck
    verdict: ViewVerdict = GOOD
    examined: list[int] = field(default_factory=list)
    stacked: list[int] = field(default_factory=list)
    """With how many earlier samples each of them was."""
    number: int = 0
    t_ns: int = 0

    def push(
        self,
        count: int = 1,
        verdict: ViewVerdict | None = None,
        spot: Spot | NoSpot = SPOT,
        camera: CameraIdentity | None = None,
        after_ns: int = PERIOD_NS,
    ) -> list[bool]:
        """Whether each of so many frames may be measured."""
        self.verdict = verdict or self.verdict
        allowed = []
        for _ in range(count):
            self.number, self.t_ns = self.number + 1, self.t_ns + after_ns
            seen = replace(PICTURE, sequence=self.number, t_ns=self.t_ns)
            allowed.append(self.check.objection(FrameAnalysis(seen, SpotSettings()), spot, camera) is None)
        return allowed

    def figures(self, after_s: float = 0.0) -> dict[str, float | str]:
        """Health so long after the last frame."""
        return self.check.status.figures(self.t_ns + round(after_s * 1e9))


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    fitted = straight_map("front")
    made = Bench(
        ViewCheck(
            TargetCalibration(
                name="front",
                z_mm=0.0,
                width=752,
                height=480,
                localiser=SpotSettings(),
                flat=None,
                map=fitted,
                cross_check=CrossCheck(fitted, 0.1, 0.3, 0.1),
                leave_one_out_px=0.04,
                residual_mean_mm=0.01,
                residual_std_mm=0.01,
                residual_max_mm=0.02,
                repeatability_px=np.zeros(2),
                leds_px=np.empty((0, 2)),
                fingerprint=NOTHING_KNOWN,
            ),
            (CameraIdentity("F-1", driver="aravis"),),
            lambda camera, target: f": {camera.serial} is not of {target}",
        )
    )

    def examine(
        fingerprint: Fingerprint, seen: FrameAnalysis, has_spot: bool, earlier: Sequence[TextureSample]
    ) -> ViewVerdict:
        assert fingerprint.max_shift_px == pytest.approx(0.11 * 4, rel=1e-3)  # at 4 px/mm
        made.examined.append(seen.frame.sequence)
        made.stacked.append(len(earlier))
        return made.verdict

    monkeypatch.setattr(Fingerprint, "examine", examine)
    return made


def test_a_good_camera_is_examined_once_in_four_frames(bench: Bench) -> None:
    assert all(bench.push(601))
    assert bench.examined == list(range(1, 602, 4))


def test_the_first_frames_are_examined_until_one_is_verified_but_not_for_ever(bench: Bench) -> None:
    assert all(bench.push(14, DOUBT))
    assert bench.examined == [1, 2, 3, 7, 11]


def test_a_spot_that_jumped_is_looked_at_and_one_that_trembles_or_moves_steadily_is_not(bench: Bench) -> None:
    bench.push(2)
    bench.push(3, spot=replace(SPOT, u_px=301.0))
    assert bench.examined == [1, 3, 4]
    for step in range(3):
        bench.push(1, spot=replace(SPOT, u_px=301.0 + 0.2 * (step % 2)))
    assert bench.examined == [1, 3, 4, 8]
    for step in range(4):
        bench.push(1, spot=replace(SPOT, u_px=301.2 + 0.4 * step))
    assert bench.examined == [1, 3, 4, 8, 12]


def test_a_beam_that_shakes_is_examined_like_a_still_one_and_at_once_when_it_jumps(bench: Bench) -> None:
    """Its spots scatter by 0.3 px, so that most lie more than half a px from where the last two point."""
    drawn = np.random.default_rng(5)

    def shaken(u_px: float = 300.0) -> Spot:
        return replace(SPOT, u_px=u_px + drawn.normal(0, 0.3), v_px=200.0 + drawn.normal(0, 0.3))

    for _ in range(400):
        bench.push(1, spot=shaken())
    assert len(bench.examined) < 130
    before = bench.number
    while bench.number < before + 5 or bench.examined[-1] >= bench.number - 1:  # two that are not due
        bench.push(1, spot=shaken())
    bench.push(1, spot=shaken(304.0))
    assert bench.examined[-1] == bench.number


def test_dim_frames_are_examined_one_after_another_until_eight_decide_together(bench: Bench) -> None:
    bench.push(4)
    bench.push(16, FAINT)
    assert bench.examined[1:] == [5, 6, 7, 8, 9, 10, 11, 15, 19]
    assert bench.stacked[1:] == [0, 1, 2, 3, 4, 5, 6, 7, 7]


def test_dim_frames_before_a_jump_and_before_a_bright_one_do_not_count(bench: Bench) -> None:
    bench.push(4, FAINT)
    bench.push(2, FAINT, spot=replace(SPOT, u_px=301.0))
    assert bench.stacked == [0, 1, 2, 3, 0, 0]  # the second has jumped from where the first would have led
    bench.push(1, GOOD, spot=replace(SPOT, u_px=301.0))
    bench.push(4, FAINT, spot=replace(SPOT, u_px=301.0))
    assert bench.stacked[6:] == [1, 0]


def test_a_picture_that_moved_by_less_than_is_refused_adds_to_the_uncertainty(bench: Bench) -> None:
    bench.push(5)
    assert bench.check.displaced_px == 0.0
    assert bench.check.status.certain_shift_mm == 0.0  # of a scan's texture
    bench.push(4, replace(GOOD, shift_px=0.3, displaced_px=0.29))
    assert bench.check.displaced_px == 0.29
    assert bench.check.status.certain_shift_mm == pytest.approx(0.3 / 4)
    bench.push(4, DOUBT)
    # no frame has shown it back
    assert (bench.check.displaced_px, bench.check.status.certain_shift_mm) == pytest.approx((0.29, 0.3 / 4))
    bench.push(4, replace(GOOD, displaced_px=0.0))
    assert (bench.check.displaced_px, bench.check.status.certain_shift_mm) == pytest.approx((0.0, 0.04 / 4))


def test_a_pause_begins_anew(bench: Bench) -> None:
    bench.push(3)
    bench.push(1, after_ns=500_000_000)
    bench.push(1, after_ns=-3_000_000_000)
    assert bench.examined == [1, 4, 5]


def test_one_wrong_verdict_holds_until_the_next_frame_and_three_until_it_is_verified(bench: Bench) -> None:
    assert bench.push(1, WRONG) == [False]
    assert bench.push(1, DOUBT) == [True]
    bench.push(1, after_ns=500_000_000)
    assert bench.push(3, WRONG) == [False] * 3
    assert bench.push(5, DOUBT) == [False] * 5
    assert bench.push(5, GOOD)[-2:] == [True] * 2  # an established one is looked at every 0.2 s


def test_a_pause_ends_neither_an_established_wrong_view_nor_what_is_known_of_a_shift(bench: Bench) -> None:
    bench.push(5, WRONG)
    assert bench.push(2, DOUBT, after_ns=500_000_000) == [False] * 2
    assert bench.push(1, GOOD, after_ns=500_000_000) == [True]
    bench.push(4, replace(GOOD, displaced_px=0.4))
    bench.push(1, DOUBT, after_ns=500_000_000)
    assert bench.check.displaced_px == 0.4


def test_another_sensor_is_over_when_the_hot_pixels_are_back(bench: Bench) -> None:
    assert bench.push(5, OTHER_SENSOR) == [False] * 5
    assert bench.push(4, SAME_SENSOR, spot=NO_SPOT)[-1]


def test_print_on_a_plain_plate_is_over_when_a_spot_shows_none(bench: Bench) -> None:
    """Nothing else could end it where the plate's own grain is not known under the spot."""
    assert (
        bench.push(
            5, replace(ViewVerdict.refuted("print is seen", FaultCause.OTHER_TARGET), is_print_seen=True)
        )
        == [False] * 5
    )
    assert bench.push(4, SAME_SENSOR, spot=NO_SPOT) == [False] * 4
    assert bench.push(4, replace(DOUBT, is_print_seen=False))[-1]


def test_hot_pixels_do_not_mend_a_view_that_moved(bench: Bench) -> None:
    assert bench.push(5, WRONG) == [False] * 5
    assert bench.push(2, SAME_SENSOR) == [False] * 2


def test_another_serial_is_refused_whatever_the_picture_shows(bench: Bench) -> None:
    right, other = CameraIdentity("F-1", driver="aravis"), CameraIdentity("F-2", driver="aravis")
    assert bench.push(2, camera=right) == [True, True]
    assert bench.push(2, camera=other) == [False, False]
    assert bench.push(2, camera=right) == [True, True]
    assert bench.examined == [1, 5]  # the camera that is back is looked at again
    refused = bench.check.objection(Mock(), NO_SPOT, other)
    detail = "its serial is 'F-2', expected 'F-1' as calibrated or configured: F-2 is not of front"
    assert refused.detail == detail


def test_another_place_of_the_picture_is_looked_for_in_the_next_frame(bench: Bench) -> None:
    bench.push(3, replace(GOOD, displaced_px=0.3))
    bench.check.compare_with(replace(NOTHING_KNOWN, moved=np.eye(2, 3)))
    assert bench.check.displaced_px == 0.3  # until it is seen
    assert bench.push(1, replace(GOOD, displaced_px=0.0)) == [True]
    assert bench.examined == [1, 4]
    assert bench.check.displaced_px == 0.0


def test_a_wrong_view_is_no_more_once_it_is_verified_where_it_is_known_to_lie(bench: Bench) -> None:
    assert bench.push(5, WRONG) == [False] * 5
    bench.check.compare_with(replace(NOTHING_KNOWN, moved=np.eye(2, 3)))
    assert bench.push(1, DOUBT) == [False]
    bench.check.compare_with(NOTHING_KNOWN)
    assert bench.push(1, GOOD) == [True]


def test_health_says_whether_the_view_is_verified(bench: Bench) -> None:
    assert bench.figures() == {"view_front": "could not be verified: no frame has been examined yet"}
    bench.push(1, DOUBT)
    assert bench.figures() == {"view_front": f"could not be verified: {DOUBT.reason}"}
    bench.push(21, GOOD)
    assert bench.figures() == {"view_front": "verified 0 s ago", "view_shift_front_px": 0.04}
    bench.push(1, WRONG, after_ns=500_000_000)
    assert bench.figures() == {"view_front": "wrong: another print is seen"}


def test_the_age_of_a_view_counts_while_no_frame_comes_and_nothing_else_is_said_of_it(bench: Bench) -> None:
    bench.push(21, GOOD)
    assert bench.figures(after_s=0.3) == {"view_front": "verified 0 s ago", "view_shift_front_px": 0.04}
    assert bench.figures(after_s=6.1) == {"view_front": "verified 6 s ago"}
    bench.push(1, WRONG, after_ns=500_000_000)
    assert bench.figures(after_s=6.1) == {"view_front": "could not be verified: no frames"}
