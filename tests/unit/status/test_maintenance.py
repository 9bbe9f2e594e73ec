"""A need of maintenance is reported before anything is invalid by it, and does not flicker at its limit."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import cycle

import pytest
from support.clock import START, FakeClock
from support.located import located

from altd.config import Maintenance
from altd.measuring.spot_trend import BUCKET_NS
from altd.reasons import Reason
from altd.records import NoSpot, Spot
from altd.status.health import FIGURE_AGE_S, Health, State
from altd.status.maintenance import CalibrationAge, SpotTrends, TemperatureLimits, Temperatures, due_date
from altd.vision.dust import DustCount

SECOND = 10**9
CLEAN = DustCount(0, 1000)


class TestCalibrationAge:
    @pytest.mark.parametrize(
        ("days_ago", "said"),
        [
            (0, []),
            (364.9, []),
            (365.1, ["calibration_due"]),
            (-0.9, []),  # another time zone
            (-1.1, ["clock_wrong"]),
        ],
    )
    def test_is_told_by_the_time_of_day(self, days_ago: float, said: list[str]) -> None:
        created = START - timedelta(days=days_ago)
        for of in (created, created.replace(tzinfo=None)):  # without a zone it is UTC
            age = CalibrationAge(of, 365.0, FakeClock().utc)
            assert [str(cause.kind) for cause in age(0)] == said

    def test_the_date_is_the_day_of_the_year_after_by_the_calendar(self) -> None:
        assert due_date(datetime(2026, 3, 1, tzinfo=UTC), 365.0) == "2027-03-01"
        assert due_date(datetime(2027, 3, 1, 23, 59), 365.0) == "2028-02-29"
        assert due_date(datetime(9999, 3, 1, tzinfo=UTC), 365.0) == ""

    def test_a_clock_that_is_set_right_ends_the_complaint(self) -> None:
        now = [datetime(1970, 1, 1, tzinfo=UTC)]
        age = CalibrationAge(START, 365.0, lambda t_ns: now[0])
        assert [str(cause.kind) for cause in age(0)] == ["clock_wrong"]
        now[0] = START + timedelta(days=1)
        assert list(age(0)) == []

    def test_nothing_is_said_where_the_time_is_not_known(self) -> None:
        assert list(CalibrationAge(START, 365.0, lambda t_ns: None)(0)) == []


class TestTemperatures:
    def told(self, *celsius: float | None) -> list[list[str]]:
        health = Health(FakeClock())
        component = health.component("temperature housing")
        watch = Temperatures({"housing": TemperatureLimits(-10.0, 60.0)}, health.component)
        told = []
        for reading in celsius:
            component.observe({"celsius": reading})
            told.append([f"{cause.kind} {cause.of} {cause.detail}" for cause in watch(0)])
        return told

    def test_limits_of_the_source(self) -> None:
        assert self.told(-10.0, 20.0, 60.0) == [[], [], []]
        assert self.told(-10.1, 60.1) == [["too_cold housing -10.1 C"], ["too_hot housing 60.1 C"]]

    def test_at_its_limit_it_does_not_flicker(self) -> None:
        told = self.told(60.1, 59.9, 60.1, 59.1, 59.0, 59.9)
        assert [len(causes) for causes in told] == [1, 1, 1, 1, 0, 0]
        told = self.told(-10.1, -9.9, -9.1, -9.0, -9.9)
        assert [len(causes) for causes in told] == [1, 1, 1, 0, 0]

    def test_what_is_not_known_is_no_temperature(self) -> None:
        assert self.told(None) == [[]]

    def test_an_old_reading_is_not_known(self) -> None:
        clock = FakeClock()
        health = Health(clock)
        component = health.component("temperature housing")
        component.observe({"celsius": 70.0})
        component.set_state(State.OK)
        watch = Temperatures({"housing": TemperatureLimits(-10.0, 60.0)}, health.component)
        clock.now_ns += round(FIGURE_AGE_S * 1e9) + 1
        assert list(watch(clock.now_ns)) == []


class Feed:
    """Two targets' spots of many minutes."""

    def __init__(self, min_light_share: float = 0.5) -> None:
        limits = Maintenance(min_light_share=min_light_share, max_residual_share=0.6, max_dust_share=0.002)
        self.trends = SpotTrends({"front": "front", "rear": "rear"}, limits)
        self.minute = 0

    def run(
        self, minutes: int, light: float | None, excess_px: float = 0.0, covered: tuple[int, ...] = (0,)
    ) -> list[str]:
        """Of 1000 pixels under the front spot so many are covered, one number after the other."""
        dust = cycle(DustCount(count, 1000) for count in covered)
        for second in range(60 * minutes):
            for target in ("front", "rear"):
                spot = Spot(0.0, 0.0, 0.01, 40.0, 100.0, light_per_ms=100.0)
                if target == "front":
                    spot = replace(spot, excess_px=excess_px, light_per_ms=light)
                t_ns = self.minute * BUCKET_NS + second * SECOND
                of_front = replace(located(target, second, t_ns), spot=spot)
                if second % 5 == 0:
                    of_front = replace(of_front, dust=next(dust) if target == "front" else CLEAN)
                self.trends.add(of_front)
        self.minute += minutes
        return [f"{cause.kind} {cause.of}: {cause.detail}" for cause in self.trends(0)]


class TestSpotTrends:
    def test_a_laser_that_fades_is_told_of_one_target_and_the_other_is_well(self) -> None:
        feed = Feed()
        assert feed.run(31, 100.0) == []
        assert feed.run(11, 60.0) == []
        assert feed.run(11, 49.0) == ["laser_weak front: 49% of its reference's light"]

    def test_at_its_limit_it_does_not_flicker(self) -> None:
        feed = Feed()
        feed.run(31, 100.0)
        said = [bool(feed.run(12, light)) for light in (49.0, 51.0, 49.0, 54.0, 56.0, 51.0)]
        assert said == [True, True, True, True, False, False]

    def test_a_laser_that_is_off_is_not_weak(self) -> None:
        feed = Feed()
        feed.run(31, 100.0)
        for second in range(3600):
            dark = replace(
                located("front", second, feed.minute * BUCKET_NS + second * SECOND),
                spot=NoSpot(Reason.SPOT_MISSING),
                dust=DustCount(1000, 1000),
            )
            feed.trends.add(dark)
        assert list(feed.trends(0)) == []

    def test_light_that_is_not_known_says_nothing(self) -> None:
        feed = Feed()
        assert feed.run(60, None) == []

    def test_can_be_switched_off(self) -> None:
        feed = Feed(min_light_share=0.0)
        feed.run(31, 100.0)
        assert feed.run(12, 0.01) == []

    def test_residuals_that_near_what_is_distorted_are_told_before(self) -> None:
        # distorted from 0.015 · 40 px = 0.6 px on
        feed = Feed()
        assert feed.run(12, 100.0, excess_px=0.1) == []
        assert feed.run(12, 100.0, excess_px=0.35) == []
        said = feed.run(12, 100.0, excess_px=0.40)
        assert said == ["residuals_rising front: 67% of what makes it distorted"]
        assert len(feed.run(12, 100.0, excess_px=0.34)) == 1
        assert feed.run(12, 100.0, excess_px=0.30) == []

    def test_dust_is_told_by_all_that_a_moving_beam_meets(self) -> None:
        feed = Feed()
        assert feed.run(15, 100.0) == []
        assert feed.run(15, 100.0, covered=(0, 0, 0, 7)) == []  # 0.18 %
        said = feed.run(15, 100.0, covered=(0, 0, 0, 9))
        assert said == ["dusty front: 0.22% of the area under the spot are covered"]

    def test_dust_is_not_told_by_less_than_five_minutes_nor_for_ever_after_cleaning(self) -> None:
        feed = Feed()
        assert feed.run(4, 100.0, covered=(50,)) == []
        assert len(feed.run(2, 100.0, covered=(50,))) == 1
        assert feed.run(11, 100.0) == []

    def test_at_its_limit_of_dust_it_does_not_flicker(self) -> None:
        feed = Feed()
        said = [bool(feed.run(11, 100.0, covered=(0, covered))) for covered in (4, 5, 4, 3)]
        assert said == [False, True, True, False]
