"""A unit drawn from the optics, calibrated and verified by frames: right, and with each of three faults.

``python -m support.verified_unit`` does the same with further units.
"""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from support.verified_unit import WRONG_MM, ZERO_DEG, By, Document, DrawnUnit, Fault, found_in

SEED = 4
"""Its calibrating beam is 0.41 and -0.25 mm/m off."""

Documents = Mapping[tuple[By, Fault], Document]


@pytest.fixture(scope="module")
def verified() -> Documents:
    with TemporaryDirectory() as folder:
        unit = DrawnUnit(SEED, Path(folder))
        return {(by, fault): unit.verified(by, fault) for by in By for fault in Fault}


def test_a_unit_without_an_error_passes(verified: Documents) -> None:
    document = verified[By.TURNED, Fault.NONE]
    assert (document["verdict"], document["reasons"]) == ("passed", [])
    assert [(one["positions"], one["valid"]) for one in document["sets"]] == [(20, 20)] * 3


@pytest.mark.parametrize("fault", [Fault.CAMERA, Fault.SEAT])
def test_a_moved_camera_and_a_unit_that_is_seated_askew_fail_by_the_zero(
    verified: Documents, fault: Fault
) -> None:
    document, right = verified[By.TURNED, fault], verified[By.TURNED, Fault.NONE]
    assert (document["verdict"], document["reasons"]) == ("failed", ["zero of yaw is beyond its limit"])
    found_deg, before_deg = (found_in(of, "zero_yaw_deg")["value"] for of in (document, right))
    assert found_deg - before_deg == pytest.approx(ZERO_DEG[fault], abs=0.001)


@pytest.mark.parametrize("by", By)
def test_a_distance_that_is_stated_wrong_fails(verified: Documents, by: By) -> None:
    document, right = verified[by, Fault.DISTANCE], verified[by, Fault.NONE]
    assert document["verdict"] == "failed"
    assert "distance of the targets is beyond its limit" in document["reasons"]
    found_mm, before_mm = (found_in(of, "target_distance_mm")["value"] for of in (document, right))
    assert found_mm - before_mm == pytest.approx(WRONG_MM, abs=0.01)


@pytest.mark.parametrize("fault", [Fault.NONE, Fault.CAMERA, Fault.SEAT])
def test_a_calibration_by_one_scan_lets_no_zero_be_decided(verified: Documents, fault: Fault) -> None:
    document = verified[By.ONE_SCAN, fault]
    assert document["verdict"] == "not decided"
    undecided = [reason.split(" less ")[0] for reason in document["reasons"][:2]]
    assert undecided == ["zero of yaw: cannot detect", "zero of pitch: cannot detect"]
    assert found_in(document, "zero_yaw_deg")["detectable"] == pytest.approx(0.077, abs=0.001)
