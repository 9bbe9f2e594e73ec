"""The status codes of values, against asyncua's names and the table that docs/opcua.md shows."""

import pytest
from asyncua import ua

from altd.publish.opcua.quality import OF_REASON, OF_SENSOR, Status, status_of, status_of_sensor
from altd.reasons import Reason
from altd.records.sensors import Quality

TARGETS = ("front", "rear", "front_spot")


def test_each_code_has_the_number_of_its_name() -> None:
    for status in Status:
        name = "".join(word.capitalize() for word in status.name.split("_"))
        assert getattr(ua.StatusCodes, name) == status


def test_every_reason_and_every_quality_of_a_sensor_has_a_code() -> None:
    assert set(OF_REASON) == set(Reason)
    assert set(OF_SENSOR) == set(Quality)


def test_a_reason_that_makes_a_measurement_invalid_is_bad_and_no_warning_is() -> None:
    for reason, status in OF_REASON.items():
        assert status.is_bad != reason.is_warning, reason


@pytest.mark.parametrize(
    ("valid", "codes", "expected"),
    [
        (True, [], Status.GOOD),
        (True, ["exposures_lost", "compensated", "roll_missing"], Status.GOOD),
        (True, ["geometry_suspect"], Status.UNCERTAIN_SENSOR_CALIBRATION),
        (True, ["pitch_diverges", "geometry_unknown"], Status.UNCERTAIN_SENSOR_CALIBRATION),
        (True, ["geometry_suspect", "simulated", "rehearsal"], Status.UNCERTAIN_SIMULATED_VALUE),
        (True, ["playback", "rehearsal"], Status.UNCERTAIN_SIMULATED_VALUE),
        (True, ["rehearsal"], Status.UNCERTAIN_SIMULATED_VALUE),
        (True, ["a_code_of_tomorrow"], Status.UNCERTAIN),
        (True, ["front_spot_missing"], Status.UNCERTAIN),
        (True, ["spot_missing"], Status.UNCERTAIN),
        (False, [], Status.BAD),
        (False, ["a_code_of_tomorrow"], Status.BAD),
        (False, ["exposures_lost"], Status.BAD),
        (False, ["rehearsal", "simulated"], Status.BAD),
        (False, ["front_spot_missing"], Status.BAD),
        (False, ["front_spot_distorted"], Status.BAD),
        (False, ["rear_camera_silent", "front_spot_missing"], Status.BAD_SENSOR_FAILURE),
        (False, ["front_spot_missing", "exposures_lost", "stale"], Status.BAD_NO_COMMUNICATION),
        (False, ["not_live", "simulated"], Status.BAD_OUT_OF_SERVICE),
        (False, ["warming_up"], Status.BAD_WAITING_FOR_INITIAL_DATA),
        (False, ["out_of_range"], Status.BAD_OUT_OF_RANGE),
        (False, ["geometry_drift", "rear_wrong_camera"], Status.BAD_DEVICE_FAILURE),
        (False, ["rear_wrong_camera"], Status.BAD_CONFIGURATION_ERROR),
    ],
)
def test_a_measurement_has_the_status_of_its_worst_reason(
    valid: bool, codes: list[str], expected: Status
) -> None:
    assert status_of(valid, codes, TARGETS, has_time=True) is expected


@pytest.mark.parametrize(
    ("valid", "codes", "expected"),
    [
        (True, ["t2_spot_missing", "t2_stuck_clear", "t3_alarm_rate"], Status.GOOD),
        (True, ["t1_stable_moved", "t1_exposures_lost", "t1_alarm_displacement"], Status.GOOD),
        (True, ["t1_spot_missing"], Status.UNCERTAIN),
        (True, ["t1_a_code_of_tomorrow"], Status.UNCERTAIN),
        (True, ["t2_a_code_of_tomorrow"], Status.UNCERTAIN),
        (True, ["t2_spot_missing", "simulated"], Status.UNCERTAIN_SIMULATED_VALUE),
        (False, ["t2_camera_silent", "t1_spot_missing"], Status.BAD),
        (False, ["t1_camera_silent", "t1_stuck_opaque"], Status.BAD_SENSOR_FAILURE),
        (False, ["t1_out_of_range"], Status.BAD_OUT_OF_RANGE),
        (False, ["t1_no_baseline"], Status.BAD),
        (False, ["t1_spot_missing", "not_live", "simulated"], Status.BAD_OUT_OF_SERVICE),
    ],
)
def test_a_place_of_a_row_has_the_status_of_its_own_reasons_and_of_those_of_the_row(
    valid: bool, codes: list[str], expected: Status
) -> None:
    assert status_of(valid, codes, ("t1", "t2", "t3"), has_time=True, place="t1") is expected


def test_no_code_is_that_of_two_targets() -> None:
    assert not [(one, other) for one in Reason for other in Reason if one.endswith(f"_{other}")]


def test_a_plate_has_no_targets_and_the_reasons_of_one() -> None:
    assert status_of(False, ["camera_silent"], (), has_time=True) is Status.BAD_SENSOR_FAILURE
    assert status_of(True, ["camera_silent"], (), has_time=True) is Status.UNCERTAIN


def test_a_value_whose_age_cannot_be_known_is_not_good() -> None:
    assert status_of(True, [], TARGETS, has_time=False) is Status.UNCERTAIN
    assert status_of(True, ["simulated"], TARGETS, has_time=False) is Status.UNCERTAIN_SIMULATED_VALUE


def test_a_sensors_value_is_of_its_own_quality_and_never_good_beside_simulated_ones() -> None:
    assert status_of_sensor(None, Status.GOOD) is Status.BAD_NOT_CONNECTED
    assert status_of_sensor({"quality": "good"}, Status.BAD) is Status.GOOD
    assert status_of_sensor({"quality": "good"}, Status.UNCERTAIN_SIMULATED_VALUE).name.startswith(
        "UNCERTAIN"
    )
    assert status_of_sensor({"quality": "reduced"}, Status.GOOD) is Status.UNCERTAIN_SENSOR_NOT_ACCURATE
    assert status_of_sensor({"quality": "frozen"}, Status.GOOD) is Status.BAD_SENSOR_FAILURE
    assert status_of_sensor({"quality": "tomorrow's"}, Status.GOOD) is Status.BAD
