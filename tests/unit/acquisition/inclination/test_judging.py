"""Acceptance of an inclinometer's readings, and their sigma."""

import math
import random

import pytest

from altd.acquisition.inclination.judging import InclinationJudge
from altd.config import InclinometerSettings
from altd.ports import InclinometerAccuracy, InclinometerReading
from altd.records.sensors import Quality, SensorValue

BALLUFF = InclinometerAccuracy(0.1, 10.0, 40.0, 0.15, 0.1, 0.01)
INTERVAL_NS = 200_000_000


def judge(**more: object) -> InclinationJudge:
    table = {"driver": "balluff_bsi_r11a0", "device": "/dev/ttyS9", **more}
    return InclinationJudge(InclinometerSettings.model_validate(table), BALLUFF)


def reading(n: int, roll_deg: float, temperature_c: float = 20.0, **more: object) -> InclinometerReading:
    words = (round(roll_deg * 100) % 36000, round(temperature_c * 100), n)
    fields = {"pitch_deg": None, "words": words, **more}
    return InclinometerReading(
        t_ns=n * INTERVAL_NS,
        roll_deg=roll_deg,
        temperature_c=temperature_c,
        **fields,  # type: ignore[arg-type]
    )


def last_of(judge: InclinationJudge, angles_deg: list[float], **more: object) -> SensorValue:
    return [judge.roll(reading(n, angle, **more)) for n, angle in enumerate(angles_deg)][-1]  # type: ignore[arg-type]


def noisy(count: int, noise_deg: float, seed: int = 1, per_reading_deg: float = 0.0) -> list[float]:
    source = random.Random(seed)
    return [1.0 + n * per_reading_deg + source.gauss(0.0, noise_deg) for n in range(count)]


def test_nothing_is_said_before_four_readings() -> None:
    judged = judge()
    said = [judged.roll(reading(n, 1.0 + 0.01 * n)) for n in range(5)]
    assert [each.quality for each in said] == [Quality.STARTING] * 3 + [Quality.GOOD] * 2


def test_a_value_is_the_newest_reading_and_expires_by_its_own_time() -> None:
    said = last_of(judge(), [1.0, 1.01, 0.99, 1.02])
    assert said.value == pytest.approx(1.02)
    assert said.t_ns == 3 * INTERVAL_NS
    assert said.expires_ns == said.t_ns + 800_000_000


@pytest.mark.parametrize(
    ("sign", "offset", "angle", "roll"),
    [(1, 0.0, 3.0, 3.0), (-1, 0.0, 3.0, -3.0), (-1, 90.0, 88.0, 2.0), (1, 179.0, -177.5, 1.5)],
)
def test_mounting_is_a_sign_then_an_offset(sign: int, offset: float, angle: float, roll: float) -> None:
    said = last_of(judge(sign_roll=sign, offset_roll_deg=offset), [angle, angle + 0.01] * 2 + [angle])
    assert said.value == pytest.approx(roll)


class TestSigma:
    def test_holds_the_makers_limits_the_last_digit_the_offset_and_the_noise(self) -> None:
        judged = judge()
        said = last_of(judged, noisy(10, 0.03))
        assert judged.noise_deg is not None
        assert said.sigma == pytest.approx(
            math.sqrt(0.1**2 / 3 + 0.1**2 / 3 + 0.01**2 / 12 + 0.05**2 + judged.noise_deg**2)
        )

    @pytest.mark.parametrize("temperature_c", [-15.0, 9.9, 40.1, 60.0])
    def test_grows_outside_the_temperatures_of_best_accuracy(self, temperature_c: float) -> None:
        angles = noisy(10, 0.03)
        inside, outside = last_of(judge(), angles), last_of(judge(), angles, temperature_c=temperature_c)
        assert outside.quality is Quality.REDUCED
        assert inside.sigma is not None
        assert outside.sigma is not None
        assert outside.sigma**2 - inside.sigma**2 == pytest.approx((0.15**2 - 0.1**2) / 3)

    @pytest.mark.parametrize("per_reading_deg", [0.0, 0.5])
    def test_noise_is_that_of_a_reading_and_turning_is_none(self, per_reading_deg: float) -> None:
        found = []
        for seed in range(200):
            judged = judge(max_roll_deg=90.0)
            last_of(judged, noisy(10, 0.05, seed, per_reading_deg))
            assert judged.noise_deg is not None
            found.append(judged.noise_deg**2)
        assert math.sqrt(sum(found) / len(found)) == pytest.approx(0.05, rel=0.1)

    def test_noise_across_half_a_turn_is_not_a_whole_one(self) -> None:
        judged = judge(offset_roll_deg=180.0)
        last_of(judged, [0.01, -0.01, 0.02, -0.02, 0.0])
        assert judged.noise_deg is not None
        assert judged.noise_deg < 0.05


class TestRefuses:
    def test_what_stands_still_to_the_last_digit(self) -> None:
        judged = judge()
        last_of(judged, [1.0, 1.01, 1.02, 1.03])
        still = {"words": (103, 2000, 3)}
        said = [judged.roll(reading(n, 1.03, **still)) for n in range(3, 9)]
        stood_s = [0.2 * n for n in range(6)]
        assert [each.quality is Quality.FROZEN for each in said] == [s >= 0.5 for s in stood_s]
        assert "frozen" in said[-1].detail
        assert said[-1].value is None

    def test_what_never_moved_from_the_first_reading_on(self) -> None:
        """At 0.15 s four readings are there before half a second is over."""
        judged = judge()
        dead = {"roll_deg": 0.0, "pitch_deg": 0.0, "temperature_c": 0.0, "words": (0,) * 13}
        said = [judged.roll(InclinometerReading(t_ns=n * 150_000_000, **dead)) for n in range(8)]  # type: ignore[arg-type]
        assert [each.quality for each in said] == [Quality.STARTING] * 4 + [Quality.FROZEN] * 4

    def test_not_two_that_are_the_same_on_either_side_of_lost_answers(self) -> None:
        judged = judge()
        last_of(judged, [1.0, 1.01, 1.02, 1.03])
        assert judged.roll(reading(10, 1.03, words=(103, 2000, 3))).quality is Quality.GOOD

    def test_not_what_stands_while_another_word_moves(self) -> None:
        assert last_of(judge(), [1.0] * 10).quality is Quality.GOOD

    def test_but_an_angle_that_stands_for_a_minute_while_the_rest_moves(self) -> None:
        judged = judge()
        said = [judged.roll(reading(n, 1.0)).quality for n in range(310)]
        assert said[290] is Quality.GOOD
        assert said[301] is Quality.FROZEN

    def test_what_moves_again_is_believed_again(self) -> None:
        judged = judge()
        same = [judged.roll(reading(n, 1.0, words=(100, 2000))) for n in range(8)]
        assert same[-1].quality is Quality.FROZEN
        assert judged.roll(reading(9, 1.01)).quality is Quality.GOOD

    @pytest.mark.parametrize("seed", range(20))
    def test_what_scatters_within_a_second(self, seed: int) -> None:
        judged = judge()
        last_of(judged, noisy(10, 0.02))
        source = random.Random(seed)
        said = [judged.roll(reading(10 + n, 1.0 + source.gauss(0.0, 2.0))).quality for n in range(4)]
        assert said[-1] is Quality.NOISY

    def test_a_jump(self) -> None:
        judged = judge()
        last_of(judged, noisy(10, 0.02))
        assert judged.roll(reading(10, 11.5)).quality is Quality.NOISY

    @pytest.mark.parametrize(
        ("angle_deg", "temperature_c"),
        [(14.1, 20.0), (-14.1, 20.0), (179.0, 20.0), (90.0, 20.0), (1.0, -40.1), (1.0, 85.1), (1.0, -327.68)],
    )
    def test_what_is_out_of_range(self, angle_deg: float, temperature_c: float) -> None:
        said = last_of(judge(), [angle_deg, angle_deg + 0.01] * 3, temperature_c=temperature_c)
        assert (said.quality, said.value) == (Quality.OUT_OF_RANGE, None)


@pytest.mark.parametrize("roll_deg", [14.03, -14.03])
def test_a_roll_of_250_mm_per_m_is_good(roll_deg: float) -> None:
    said = last_of(judge(), [roll_deg, roll_deg - math.copysign(0.01, roll_deg)] * 3 + [roll_deg])
    assert (said.quality, said.value) == (Quality.GOOD, pytest.approx(roll_deg))


FINE = InclinometerAccuracy(0.01, -20.0, 60.0, 0.05, 0.0, 0.0, 0.001, 30.0, roll_is_inclination=True)


def fine_judge(**more: object) -> InclinationJudge:
    table = {"driver": "witmotion_wt901c485", "device": "/dev/ttyS9", "offset_sigma_deg": 0, **more}
    return InclinationJudge(InclinometerSettings.model_validate(table), FINE)


def test_the_inclination_of_an_axis_is_no_rotation() -> None:
    """At a pitch of 14° an axis across is inclined by 4.85° if the unit is rotated by 5°."""
    angle = math.degrees(math.asin(math.sin(math.radians(5.0)) * math.cos(math.radians(14.0))))
    angles = [angle, angle + 1e-6] * 3
    said = last_of(fine_judge(), angles, pitch_deg=14.0)
    assert said.value == pytest.approx(5.0, abs=1e-4)
    assert angle == pytest.approx(4.85, abs=0.01)


def test_the_drift_by_temperature_is_in_sigma() -> None:
    angles = [1.0, 1.0 + 1e-6] * 3
    cold, zero = (last_of(fine_judge(), angles, pitch_deg=0.0, temperature_c=c) for c in (40.0, 20.0))
    assert (cold.sigma or 0) ** 2 - (zero.sigma or 0) ** 2 == pytest.approx(0.02**2 / 3)


def test_a_sensor_of_360_degrees_has_no_end_of_its_range() -> None:
    said = last_of(judge(offset_roll_deg=180.0), [-180.0, 179.99] * 3)
    assert said.quality is Quality.GOOD


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(30.0, 0.0), (0.0, -30.0)])
def test_an_angle_at_the_end_of_the_range_is_none(roll_deg: float, pitch_deg: float) -> None:
    said = last_of(fine_judge(max_roll_deg=90.0), [roll_deg] * 5, pitch_deg=pitch_deg)
    assert (said.quality, said.value) == (Quality.OUT_OF_RANGE, None)


def test_after_a_restart_nothing_of_before_counts() -> None:
    judged = judge()
    last_of(judged, noisy(10, 0.02))
    judged.restart()
    assert judged.roll(reading(20, 1.0)).quality is Quality.STARTING


@pytest.mark.parametrize("per_s", [0.1, -0.3])
def test_a_machine_that_rolls_has_a_rate_and_noise_has_none(per_s: float) -> None:
    rolling = last_of(judge(), noisy(10, 0.01, per_reading_deg=per_s * INTERVAL_NS * 1e-9))
    assert rolling.rate == pytest.approx(per_s, abs=0.03)
    resting = [last_of(judge(), noisy(10, 0.02, seed)).rate for seed in range(40)]
    assert sum(rate == 0.0 for rate in resting) >= 32
