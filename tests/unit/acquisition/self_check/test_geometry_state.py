"""Effect of checks on a measurement, by verdicts that the test writes down."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support import evidence
from support.clock import FakeClock
from support.measurements import measured, measurement

from altd.acquisition.self_check.geometry_state import GeometryState
from altd.config import SelfCheckSettings
from altd.reasons import Reason
from altd.records import MeanSpots, Measurement
from altd.selfcheck.records import DriftLimits, SelfCheck, Similarity, TargetDrift, Verdict


def check(verdict: Verdict, *reasons: str, shift_px: float = 0.0, significance: float = 1.0) -> SelfCheck:
    """Of both targets, each with that shift to the right."""
    moved = Similarity(
        about_px=(376.0, 240.0),
        radius_px=300.0,
        shift_px=(shift_px, 0.0),
        turn_deg=0.0,
        scale_ppm=0.0,
        covariance=np.diag([1e-4, 1e-4, 1e-6, 1.0]),
    )
    targets = {
        name: TargetDrift(name, 6, 6, (), similarity=moved, rms_px=0.01, significance=significance)
        for name in ("front", "rear")
    }
    return SelfCheck(verdict, targets, {}, reasons)


UNKNOWN = SelfCheck(Verdict.UNKNOWN, {}, {}, ("all LEDs dark",))
GOOD, SUSPECT, BAD = (check(Verdict(word), word) for word in ("good", "suspect", "bad"))
SUSPECT_IN_PART, BAD_IN_PART = (replace(one, is_whole=False) for one in (SUSPECT, BAD))


calibration = cache(evidence.calibration)


def state_of(clock: FakeClock | None = None, **settings: object) -> GeometryState:
    checked = SelfCheckSettings.model_validate(settings)
    return GeometryState(checked, DriftLimits(), calibration(), clock or FakeClock())


def codes(state: GeometryState, of: Measurement | None = None) -> tuple[bool, list[str]]:
    """Whether a valid measurement still is, and what it says."""
    of = of or measured()
    passed = of.with_findings(state.finding(of.valid))
    return passed.valid, [str(fault) for fault in passed.status]


def test_before_the_first_check_nothing_is_valid() -> None:
    assert codes(state_of()) == (False, ["self_checking"])
    assert codes(state_of(enabled=False)) == (True, [])


@pytest.mark.parametrize(
    ("settings", "checks", "valid", "says"),
    [
        ({}, [GOOD], True, []),
        ({}, [SUSPECT], True, ["geometry_suspect"]),
        ({}, [BAD], False, ["geometry_drift"]),
        ({"when_bad": "warning"}, [BAD], True, ["geometry_suspect"]),
        ({}, [UNKNOWN], True, ["geometry_unknown"]),
        ({"when_unknown": "invalid"}, [UNKNOWN], False, ["geometry_unverified"]),
        ({}, [BAD, GOOD], True, []),
        ({}, [UNKNOWN, GOOD], True, []),
        # a check without sight of the LEDs withdraws nothing
        ({}, [BAD, UNKNOWN], False, ["geometry_drift", "geometry_unknown"]),
        ({}, [BAD, UNKNOWN, UNKNOWN], False, ["geometry_drift", "geometry_unknown"]),
        ({}, [SUSPECT, UNKNOWN], True, ["geometry_suspect", "geometry_unknown"]),
        ({}, [GOOD, UNKNOWN], True, ["geometry_unknown"]),
        # nor does who sees but a part say that the rest is in its place
        ({}, [SUSPECT_IN_PART], True, ["geometry_suspect", "geometry_unknown"]),
        ({"when_unknown": "invalid"}, [SUSPECT_IN_PART], False, ["geometry_suspect", "geometry_unverified"]),
        ({}, [BAD_IN_PART], False, ["geometry_drift", "geometry_unknown"]),
        ({}, [SUSPECT_IN_PART, SUSPECT], True, ["geometry_suspect"]),
    ],
)
def test_what_follows_from_verdicts(
    settings: dict[str, object], checks: list[SelfCheck], valid: bool, says: list[str]
) -> None:
    of_unit = state_of(**settings)
    for one in checks:
        of_unit.take(one)
    assert codes(of_unit) == (valid, says)


def test_what_was_bad_before_the_start_stays_so_until_a_check_has_a_verdict() -> None:
    of_unit = state_of()
    of_unit.recall_bad()
    assert codes(of_unit) == (False, ["self_checking"])
    assert of_unit.verdict is Verdict.BAD
    of_unit.take(UNKNOWN)
    assert codes(of_unit) == (False, ["geometry_drift", "geometry_unknown"])
    of_unit.take(SUSPECT)
    of_unit.recall_bad()
    assert codes(of_unit) == (True, ["geometry_suspect"])
    asked_only = state_of(enabled=False)
    asked_only.recall_bad()
    assert codes(asked_only) == (False, ["geometry_drift"])


def test_the_reason_is_told_and_those_of_the_measurement_stay() -> None:
    of_unit = state_of()
    of_unit.take(check(Verdict.BAD, "rear: moved by 0.3 mm", "yaw is off"))
    assert codes(of_unit, measurement(1, 0, Reason.CAMERA_SILENT)) == (
        *(False, ["camera_silent", "geometry_drift"]),
    )
    assert of_unit.faults[-1].detail == "rear: moved by 0.3 mm; yaw is off"


def test_a_slow_drift_is_a_warning_while_all_is_good() -> None:
    of_unit = state_of()
    of_unit.take(GOOD, "rear drifts by 0.020 px a day")
    assert codes(of_unit) == (True, ["geometry_suspect"])
    assert of_unit.faults[0].detail == "rear drifts by 0.020 px a day"


@pytest.mark.parametrize(
    ("settings", "before", "valid", "says"),
    [
        ({}, GOOD, True, ["geometry_unknown"]),
        ({"when_unknown": "invalid"}, GOOD, False, ["geometry_unverified"]),
        ({}, SUSPECT, True, ["geometry_suspect", "geometry_unknown"]),
        ({}, BAD, False, ["geometry_drift", "geometry_unknown"]),
        ({"enabled": False}, GOOD, True, []),  # no check would come after it
    ],
)
def test_after_a_shock_nobody_knows_until_a_check_has_ended(
    settings: dict[str, object], before: SelfCheck, valid: bool, says: list[str]
) -> None:
    of_unit = state_of(**settings)
    of_unit.take(before)
    of_unit.note_shock()
    assert codes(of_unit) == (valid, says)
    of_unit.take(GOOD)
    assert codes(of_unit) == (True, [])


class TestCompensation:
    PROVEN = check(Verdict.BAD, "bad", shift_px=0.5, significance=50.0)

    def test_is_off_unless_asked_for(self) -> None:
        of_unit = state_of()
        of_unit.take(self.PROVEN)
        assert of_unit.transforms == {}
        assert codes(of_unit) == (False, ["geometry_drift"])

    def test_takes_out_what_is_proven_and_says_so(self) -> None:
        of_unit = state_of(compensate=True)
        of_unit.take(self.PROVEN)
        assert codes(of_unit) == (True, ["compensated"])
        px = np.array([[300.0, 200.0], [400.0, 250.0]])
        mean = MeanSpots(("front", "rear"), px, 1e-4 * np.eye(4), 0, 20, 0)
        corrected = of_unit.correct(mean)
        assert corrected.px == pytest.approx(px - [[0.5, 0.0]] * 2)
        assert all(corrected.covariance_px2.diagonal() > 1.9e-4)  # the check's own 1e-4 px² is added

    def test_leaves_alone_what_chance_may_be(self) -> None:
        of_unit = state_of(compensate=True)
        of_unit.take(check(Verdict.SUSPECT, "suspect", shift_px=0.05, significance=3.0))
        assert of_unit.transforms == {}
        assert codes(of_unit) == (True, ["geometry_suspect"])

    def test_never_goes_beyond_its_limit(self) -> None:
        of_unit = state_of(compensate=True)
        of_unit.take(check(Verdict.BAD, "bad", shift_px=math.inf, significance=50.0))
        assert codes(of_unit) == (False, ["geometry_drift"])
        of_unit.take(check(Verdict.BAD, "bad", shift_px=20.0, significance=5000.0))
        assert of_unit.transforms == {}
        assert codes(of_unit) == (False, ["geometry_drift"])
        assert "not corrected: front" in of_unit.faults[0].detail

    def test_holds_through_a_check_without_a_verdict_and_ends_with_a_good_one(self) -> None:
        of_unit = state_of(compensate=True)
        of_unit.take(self.PROVEN)
        of_unit.take(UNKNOWN)
        assert of_unit.transforms != {}
        assert codes(of_unit) == (True, ["compensated", "geometry_unknown"])
        of_unit.take(GOOD)
        assert of_unit.transforms == {}
        assert codes(of_unit) == (True, [])

    def test_holds_through_a_check_that_saw_but_a_part_unless_that_is_bad(self) -> None:
        of_unit = state_of(compensate=True)
        of_unit.take(check(Verdict.SUSPECT, "suspect", shift_px=0.2, significance=50.0))
        before = of_unit.transforms
        rear_only = {"front": TargetDrift("front", 6, 0, ()), "rear": SUSPECT.targets["rear"]}
        in_part = replace(SUSPECT_IN_PART, targets=rear_only)
        assert of_unit.transforms_after(in_part) == before != {}
        of_unit.take(in_part)
        assert of_unit.transforms == before
        assert codes(of_unit) == (True, ["compensated", "geometry_unknown"])
        of_unit.take(replace(BAD_IN_PART, targets=rear_only))
        assert of_unit.transforms == {}
        assert codes(of_unit) == (False, ["geometry_drift", "geometry_unknown"])

    @pytest.mark.parametrize(
        ("settings", "proven", "valid", "says"),
        [
            ({}, PROVEN, False, ["geometry_drift", "geometry_unknown"]),
            ({"when_bad": "warning"}, PROVEN, True, ["geometry_suspect", "geometry_unknown"]),
            ({"when_unknown": "invalid"}, PROVEN, False, ["geometry_drift", "geometry_unverified"]),
            (
                {},
                check(Verdict.SUSPECT, "suspect", shift_px=0.1, significance=10.0),
                True,
                ["geometry_suspect", "geometry_unknown"],
            ),
            ({}, check(Verdict.GOOD, shift_px=0.08, significance=8.0), True, ["geometry_unknown"]),
        ],
    )
    def test_lapses_when_no_check_confirms_it_for_three_intervals(
        self, settings: dict[str, object], proven: SelfCheck, valid: bool, says: list[str]
    ) -> None:
        clock = FakeClock()
        of_unit = state_of(clock, compensate=True, interval_s=60.0, **settings)
        of_unit.take(proven)
        for _ in range(18):
            clock.now_ns += 10_000_000_000
            of_unit.take(UNKNOWN)
            assert not of_unit.lapse()
        assert of_unit.transforms != {}
        clock.now_ns += 1
        assert of_unit.lapse()
        assert not of_unit.lapse()
        assert of_unit.transforms == {}
        assert codes(of_unit) == (valid, says)
        of_unit.take(UNKNOWN)
        assert codes(of_unit) == (valid, says)
        of_unit.take(proven)
        assert codes(of_unit) == (True, ["compensated"])

    def test_lapses_where_nobody_asks_for_another_check(self) -> None:
        clock = FakeClock()
        of_unit = state_of(clock, compensate=True, enabled=False)
        of_unit.take(self.PROVEN)
        clock.now_ns += 1_801_000_000_000
        assert of_unit.lapse()
        assert codes(of_unit) == (False, ["geometry_drift"])
        assert of_unit.faults[0].detail == ("bad; no longer corrected: no check has confirmed it for 1801 s")

    def test_a_check_that_confirms_it_begins_the_time_anew(self) -> None:
        clock = FakeClock()
        of_unit = state_of(clock, compensate=True)
        for _ in range(5):
            of_unit.take(self.PROVEN)
            clock.now_ns += 1_700_000_000_000
            assert not of_unit.lapse()
