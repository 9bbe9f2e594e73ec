"""``sigma_now`` and rates of a machine whose motion is the simulator's, not altd's."""

from __future__ import annotations

import pytest
from support.moving_machine import KEYS, machine

from altd.config import Installation, Measuring


def test_at_rest_it_is_hardly_larger_than_sigma() -> None:
    last = machine(1, 0.0, vibrates=False).measured(range(200), Measuring())[-1]
    for key in KEYS:
        sigma, now = last.sigma(key), last.sigma_at(key, 1.5)
        assert sigma is not None
        assert now is not None
        assert sigma < now < 1.5 * sigma


def test_rates_are_those_of_the_beam_with_the_signs_of_its_installation() -> None:
    moving = machine(3, 5.0, vibrates=False)
    signs = Installation.model_validate({"sign_x": -1, "sign_pitch": -1, "offset_yaw_deg": 3.0})
    last = moving.measured(range(40), Measuring(), signs)[-1]
    step_ns = 1_000_000
    truth = (moving.truth(last.t_ns + step_ns) - moving.truth(last.t_ns - step_ns)) / (2 * step_ns * 1e-9)
    for key, sign, rate in zip(KEYS, (-1, 1, 1, -1), truth, strict=True):
        found = last.rates[key]
        assert found.sigma is not None
        assert found.value == pytest.approx(sign * rate, abs=4 * found.sigma + 0.02 * abs(rate))
        assert found.sigma < 0.05


@pytest.mark.parametrize("window", [1, 3])
def test_where_too_few_exposures_are_averaged_it_is_not_known(window: int) -> None:
    last = machine(1, 2.0, vibrates=False).measured(range(60), Measuring(window=window))[-1]
    assert last.valid
    assert last.rates == {}
    assert [last.sigma_at(key, 0.1) for key in KEYS] == [None] * 4


def test_it_is_not_known_before_the_motion_was_seen_to_last() -> None:
    measurements = machine(1, 2.0, vibrates=False).measured(range(60), Measuring())
    known = [m.sigma_at("x_mm", 0.5) is not None for m in measurements if m.valid]
    assert known.index(True) in range(20, 30)
    assert all(known[known.index(True) :])


def test_every_quantity_with_a_sigma_has_one_of_now() -> None:
    last = machine(1, 0.0, vibrates=False).measured(range(60), Measuring())[-1]
    with_sigma = {key for key, value in last.values.items() if value.sigma is not None}
    assert with_sigma == {each.key for each in last.quantities.of_unit if each.has_sigma} - {"roll_deg"}
    assert {key for key in last.values if last.sigma_at(key, 0.5) is not None} == with_sigma


def test_what_has_no_sigma_has_none_of_now_either() -> None:
    last = machine(1, 0.0, vibrates=False).measured(range(60), Measuring())[-1]
    assert last.sigma_at("yaw_mm_per_m", 0.5) is None
    assert last.sigma_at("roll_deg", 0.5) is None


def test_what_is_invalid_has_neither_rates_nor_sigma_of_now() -> None:
    last = machine(1, 2.0, vibrates=False).measured(range(60), Measuring())[-1].without_numbers(())
    assert last.rates == {}
    assert last.sigma_at("x_mm", 0.5) is None
