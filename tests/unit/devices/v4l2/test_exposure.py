from __future__ import annotations

import pytest

from altd.devices.v4l2 import abi
from altd.devices.v4l2.camera import ExposureTime
from altd.devices.v4l2.controls import Control
from altd.ports import ExposureRange

V4L2_CID_EXPOSURE, V4L2_CID_GAIN = 0x0098_0911, 0x0098_0913  # of <linux/v4l2-controls.h>; altd uses neither


def control(number: int, smallest: int, largest: int, step: int = 1, writes: bool = True) -> Control:
    """A control as the kernel describes it; what a UVC camera's says is in the kernel's uvc_ctrl.c."""
    return Control(number, "a control", "integer", smallest, largest, step, smallest, True, writes)


UVC_TIME = control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047)
UVC_AUTO = control(abi.V4L2_CID_EXPOSURE_AUTO, 0, 3)


def test_a_uvc_camera_exposes_in_units_of_100_us() -> None:
    exposure = ExposureTime.of([UVC_AUTO, UVC_TIME])
    assert exposure is not None
    assert exposure.range == ExposureRange(pytest.approx(0.3), pytest.approx(204.7), 0.0, 0.0)
    assert exposure.units(2.04) == 20


def test_a_camera_that_counts_lines_or_has_but_a_gain_has_no_exposure_that_altd_could_set() -> None:
    lines, gain = control(V4L2_CID_EXPOSURE, 4, 1100), control(V4L2_CID_GAIN, 0, 255)
    assert ExposureTime.of([lines, gain]) is None


def test_an_exposure_that_can_only_be_read_is_none_to_set() -> None:
    assert ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047, writes=False)]) is None


def test_an_exposure_of_nothing_is_not_offered() -> None:
    exposure = ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 0, 100)])
    assert exposure is not None
    assert exposure.range.shortest_ms == pytest.approx(0.1)
    assert exposure.units(0.0) == 1


@pytest.mark.parametrize(
    ("exposure_ms", "units"), [(0.01, 5), (0.9, 10), (1.1, 10), (1.3, 15), (99.0, 95), (9.4, 95)]
)
def test_an_exposure_is_the_nearest_that_the_steps_and_the_range_allow(
    exposure_ms: float, units: int
) -> None:
    exposure = ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 5, 98, step=5)])
    assert exposure is not None
    assert exposure.units(exposure_ms) == units
