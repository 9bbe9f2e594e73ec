import math
from dataclasses import replace

import numpy as np
import pytest
from support.measurements import BEAM, measured, measurement, points_of

from altd.instruments.beam.instrument import range_fault
from altd.instruments.beam.solver import KEYS, Beam
from altd.measuring.gate import Gate
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.records.joint import Joint
from altd.records.spots import Motion

NUMBERS = [
    name for name in Beam.__dataclass_fields__ if not name.endswith(("_random", "_covariance", "_scatter"))
]
SIGMAS = np.array([BEAM.sigma_x_mm, BEAM.sigma_y_mm, BEAM.sigma_yaw_deg, BEAM.sigma_pitch_deg])


def admitted(*measurements: Measurement) -> list[str]:
    """The reason and the detail of each, empty for one that passes as it is."""
    gate, said = Gate(), []
    for each in measurements:
        through = gate.admit(each)
        if through is each:
            said.append("")
        else:
            assert not through.valid
            assert set(points_of(through).values()) == {None}
            assert through.number("roll_deg") is None
            assert through.status[0].reason is Reason.CHECK_FAILED
            said.append(through.status[0].detail)
    return said


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", NUMBERS)
def test_no_number_that_is_none_leaves(field: str, value: float) -> None:
    [said] = admitted(measured(replace(BEAM, **{field: value})))
    assert said.startswith(f"{field} is {value}")


JOINT = Joint(KEYS, np.diag(SIGMAS**2), np.diag(SIGMAS**2) / 4, np.ones(4))
TOO_CORRELATED = np.diag(SIGMAS**2) + 1.1 * np.outer(SIGMAS, SIGMAS) * np.eye(4)[[2, 1, 0, 3]] * [1, 0, 1, 0]


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        (JOINT, ""),
        (replace(JOINT, covariance=np.full((4, 4), math.nan)), "covariance is not finite"),
        (replace(JOINT, scatter=np.full((4, 4), math.inf)), "scatter is not finite"),
        (replace(JOINT, covariance=TOO_CORRELATED), "covariance has a negative eigenvalue"),
        (replace(JOINT, covariance=JOINT.covariance * 1.01), "covariance is not that of the sigmas"),
    ],
)
def test_the_joint_uncertainty_is_one_of_the_sigmas(joint: Joint, said: str) -> None:
    [found] = admitted(replace(measured(), joint=joint))
    assert found == (said and f"the joint {said}")


def test_a_sigma_whose_square_is_zero_is_refused_without_a_division() -> None:
    field = next(name for name in NUMBERS if name.startswith("sigma_"))
    said = admitted(replace(measured(replace(BEAM, **{field: 1e-170})), joint=JOINT))
    assert "the joint covariance is not that of the sigmas" in said


@pytest.mark.parametrize("sigma", [0.0, -0.001])
@pytest.mark.parametrize("field", [name for name in NUMBERS if name.startswith("sigma_")])
def test_a_sigma_is_positive(field: str, sigma: float) -> None:
    assert admitted(measured(replace(BEAM, **{field: sigma}))) == [f"{field} is {sigma:g}"]


@pytest.mark.parametrize("random", [0.0, -0.001, math.nan, math.inf, 0.0041])
def test_the_part_that_scatters_is_positive_and_within_sigma(random: float) -> None:
    [said] = admitted(measured(replace(BEAM, sigma_random=(0.003, random, 0.001, 0.001))))
    assert said == f"sigma_random of y_mm is {random:g} of 0.004"


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (Motion(math.nan, 0.1, 0.1, 0.0, 0.5, 0.1, 0.1, 0.1), "the rate of y_mm is nan"),
        (Motion(0.1, math.inf, 0.1, 0.0, 0.5, 0.1, 0.1, 0.1), "how y_mm moves is not known"),
        (Motion(0.1, 0.1, math.nan, 0.0, 0.5, 0.1, 0.1, 0.1), "how y_mm moves is not known"),
        (Motion(0.1, 0.1, 0.1, 0.0, 0.5, 0.1, 0.1, math.inf), "how y_mm moves is not known"),
        (Motion(0.1, 0.1, 0.1, math.nan, 0.5, 0.1, 0.1, 0.1), "how y_mm moves is not known"),
        (Motion(0.1, 0.1, 0.1, 0.0, 0.5, 0.1, math.nan, 0.1), "how y_mm moves is not known"),
    ],
)
def test_a_motion_that_is_none_takes_its_value_along(motion: Motion, said: str) -> None:
    assert admitted(measured(motions={"y_mm": motion})) == [said]


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("points_mm", {"front": (math.nan, 0.0), "rear": (0.0, 0.0)}, "front.x_mm is nan"),
        ("points_mm", {"front": (0.0, 0.0), "rear": (0.0, math.inf)}, "rear.y_mm is inf"),
        ("points_mm", {"front": (0.0, 0.0), "rear": None}, "rear.x_mm is not known"),
        ("roll_deg", math.nan, "roll_deg is nan"),
        ("frames", 0, "it is the mean of 0 exposures"),
    ],
)
def test_all_that_is_published_is_checked(field: str, value: object, said: str) -> None:
    assert admitted(measured(**{field: value})) == [said]


def test_what_is_valid_moves_forward_and_one_lie_costs_no_more_than_the_next() -> None:
    first, lie, after = measurement(10, 1000), measurement(910, 2000), measurement(11, 3000)
    said = admitted(first, lie, after, measurement(12, 4000))
    assert said == ["", "", "sequence 11 does not follow 910", ""]
    [_, again] = admitted(first, first)
    assert again == "sequence 10 does not follow 10"
    [_, back, on] = admitted(first, measurement(11, 1000 - 2 * 10**9), measurement(12, 2000))
    assert (back, on) == ("exposed 2 s before the one before it", "")


def test_the_middle_of_a_window_may_fall_where_its_last_exposure_moves_on() -> None:
    """As when its last exposures turn out to be outliers."""
    first = replace(measurement(10, 1000), last_exposure_ns=1500)
    assert admitted(first, replace(measurement(11, 900), last_exposure_ns=1550)) == ["", ""]


def test_what_is_invalid_passes_with_its_reasons_and_orders_nothing() -> None:
    invalid = measurement(99, 10**12, Reason.UNSTEADY)
    assert admitted(measurement(10, 1000), invalid, measurement(11, 2000)) == ["", "", ""]


def test_warnings_stay_beside_a_failed_check() -> None:
    playing = measured(status=(Fault(Reason.PLAYBACK),), roll_deg=math.inf)
    assert [str(fault) for fault in Gate().admit(playing).status] == ["check_failed", "playback"]


def beam(yaw: float, pitch: float, sigma_mm_per_m: float = 0.01) -> Beam:
    """Of these slopes, mm/m."""
    sigma_deg = math.degrees(sigma_mm_per_m * 1e-3)
    angles = (math.degrees(math.atan(slope * 1e-3)) for slope in (yaw, pitch))
    return Beam(0.0, 0.0, *angles, 0.004, 0.004, sigma_deg, sigma_deg)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_stated_ranges_hold_by_three_sigmas_and_no_more_than_the_accuracy(sign: int) -> None:
    for yaw, pitch in ((0.0, 0.0), (110.0, 250.0), (110.02, 0.0), (0.0, 250.02)):
        assert range_fault(beam(sign * yaw, sign * pitch)) is None
    for yaw, pitch, said in (
        (110.2, 0.0, f"yaw is {sign * 110.2:.1f} mm/m, the unit measures up to 110"),
        (0.0, 250.2, f"pitch is {sign * 250.2:.1f} mm/m, the unit measures up to 250"),
        (500.0, 0.0, f"yaw is {sign * 500.0:.1f} mm/m, the unit measures up to 110"),
    ):
        fault = range_fault(beam(sign * yaw, sign * pitch))
        assert (fault.reason, fault.detail) == (Reason.OUT_OF_RANGE, said)
    assert range_fault(beam(sign * 110.9, 0.0, sigma_mm_per_m=5.0)) is None
    assert range_fault(beam(sign * 111.1, 0.0, sigma_mm_per_m=5.0)) is not None


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_slope_that_is_no_number_is_left_to_the_gate(value: float) -> None:
    assert range_fault(replace(BEAM, yaw_deg=value)) is None
    assert range_fault(replace(BEAM, pitch_deg=value)) is None
