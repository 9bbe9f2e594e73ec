"""Status codes of values: one table for reasons, another for the quality of sensors.

Names and numbers are those of OPC 10000-4 and 10000-8. Where these leave a choice, the codes follow tables 14
and 15 of OPC 30142, which map the states of NE 107: a fault of the beam is not a fault of the unit.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from enum import IntEnum
from typing import Any

from altd.reasons import Reason
from altd.records.sensors import Quality


class Status(IntEnum):
    """Status codes of values."""

    GOOD = 0x0000_0000
    UNCERTAIN = 0x4000_0000
    UNCERTAIN_SENSOR_NOT_ACCURATE = 0x4093_0000
    UNCERTAIN_SENSOR_CALIBRATION = 0x420A_0000
    UNCERTAIN_SIMULATED_VALUE = 0x4209_0000
    BAD = 0x8000_0000
    BAD_NO_COMMUNICATION = 0x8031_0000
    BAD_WAITING_FOR_INITIAL_DATA = 0x8032_0000
    BAD_OUT_OF_RANGE = 0x803C_0000
    BAD_CONFIGURATION_ERROR = 0x8089_0000
    BAD_NOT_CONNECTED = 0x808A_0000
    BAD_DEVICE_FAILURE = 0x808B_0000
    BAD_SENSOR_FAILURE = 0x808C_0000
    BAD_OUT_OF_SERVICE = 0x808D_0000

    @property
    def is_bad(self) -> bool:
        """Whether a value with this status is not a value."""
        return self >= Status.BAD


OF_REASON: Mapping[Reason, Status] = {
    Reason.STALE: Status.BAD_NO_COMMUNICATION,
    Reason.NOT_LIVE: Status.BAD_OUT_OF_SERVICE,
    Reason.CHECK_FAILED: Status.BAD_DEVICE_FAILURE,
    Reason.GEOMETRY_DRIFT: Status.BAD_DEVICE_FAILURE,
    Reason.GEOMETRY_UNVERIFIED: Status.BAD_DEVICE_FAILURE,
    Reason.WRONG_CAMERA: Status.BAD_CONFIGURATION_ERROR,
    Reason.IMPLAUSIBLE: Status.BAD_CONFIGURATION_ERROR,
    Reason.CAMERA_SILENT: Status.BAD_SENSOR_FAILURE,
    Reason.FRAME_REPEATED: Status.BAD_SENSOR_FAILURE,
    Reason.OUT_OF_STEP: Status.BAD_SENSOR_FAILURE,
    Reason.SELF_CHECKING: Status.BAD_WAITING_FOR_INITIAL_DATA,
    Reason.WARMING_UP: Status.BAD_WAITING_FOR_INITIAL_DATA,
    Reason.EXPOSURE_CHANGING: Status.BAD_WAITING_FOR_INITIAL_DATA,
    Reason.OUT_OF_RANGE: Status.BAD_OUT_OF_RANGE,
    Reason.SPOT_MISSING: Status.BAD,
    Reason.AMBIGUOUS: Status.BAD,
    Reason.SATURATED: Status.BAD,
    Reason.CUT_BY_EDGE: Status.BAD,
    Reason.WRONG_SIZE: Status.BAD,
    Reason.WRONG_SHAPE: Status.BAD,
    Reason.DISTORTED: Status.BAD,
    Reason.UNSTEADY: Status.BAD,
    Reason.LEDS_MISSING: Status.BAD,
    Reason.LEDS_MISFIT: Status.BAD,
    Reason.STUCK_CLEAR: Status.BAD,
    Reason.SLOW: Status.BAD,
    Reason.NOT_CONFIRMED: Status.BAD,
    Reason.CAMERAS_SWAPPED: Status.BAD,
    Reason.BEAM_LOST: Status.BAD,
    Reason.REHEARSAL: Status.UNCERTAIN_SIMULATED_VALUE,
    Reason.PLAYBACK: Status.UNCERTAIN_SIMULATED_VALUE,
    Reason.SIMULATED: Status.UNCERTAIN_SIMULATED_VALUE,
    Reason.GEOMETRY_SUSPECT: Status.UNCERTAIN_SENSOR_CALIBRATION,
    Reason.GEOMETRY_UNKNOWN: Status.UNCERTAIN_SENSOR_CALIBRATION,
    Reason.PITCH_DIVERGES: Status.UNCERTAIN_SENSOR_NOT_ACCURATE,
    Reason.COMPENSATED: Status.GOOD,
    Reason.EXPOSURES_LOST: Status.GOOD,
    Reason.ROLL_MISSING: Status.GOOD,
    Reason.STUCK_OPAQUE: Status.GOOD,
    Reason.SWITCH_UNSEEN: Status.GOOD,
    Reason.BEAM_LOST_BEHIND: Status.GOOD,
    Reason.STABLE_MOVED: Status.GOOD,
    Reason.STABLE_DISAGREE: Status.GOOD,
    Reason.NO_BASELINE: Status.GOOD,
    Reason.BASELINE_INCOMPLETE: Status.GOOD,
    Reason.BEAM_ANGLE_UNKNOWN: Status.GOOD,
    Reason.BEAM_DRIFT_UNKNOWN: Status.GOOD,
    Reason.BEAM_NOT_CLOSED: Status.GOOD,
    Reason.ALARM_DISPLACEMENT: Status.GOOD,
    Reason.ALARM_RATE: Status.GOOD,
}
"""Of several reasons, the first one here counts. A warning is Good if sigma covers its effect."""

OF_SENSOR: Mapping[Quality, Status] = {
    Quality.GOOD: Status.GOOD,
    Quality.REDUCED: Status.UNCERTAIN_SENSOR_NOT_ACCURATE,
    Quality.STARTING: Status.BAD_WAITING_FOR_INITIAL_DATA,
    Quality.NO_PORT: Status.BAD_NO_COMMUNICATION,
    Quality.NO_ANSWER: Status.BAD_NO_COMMUNICATION,
    Quality.OLD: Status.BAD_NO_COMMUNICATION,
    Quality.BAD_ANSWER: Status.BAD_NO_COMMUNICATION,
    Quality.WRONG_SENSOR: Status.BAD_CONFIGURATION_ERROR,
    Quality.INVALID_SETTING: Status.BAD_CONFIGURATION_ERROR,
    Quality.OUT_OF_RANGE: Status.BAD_OUT_OF_RANGE,
    Quality.FROZEN: Status.BAD_SENSOR_FAILURE,
    Quality.NOISY: Status.BAD_SENSOR_FAILURE,
    Quality.DEFECT: Status.BAD_SENSOR_FAILURE,
}

_RANK = {reason: rank for rank, reason in enumerate(OF_REASON)}
_BY_CODE = {str(reason): reason for reason in Reason}


def status_of(
    valid: bool, codes: Iterable[str], targets: Collection[str], has_time: bool, place: str | None = None
) -> Status:
    """Return the status of the numbers of a measurement with these codes of reasons and warnings.

    Numbers that are not valid are Bad, whatever the codes. Valid numbers with a code that is not a warning
    are Uncertain, and so are valid numbers without a capture time: their age is not known.
    ``place`` is the target of a row that the numbers belong to, empty: the row. The codes of its other
    targets do not count.
    """
    found = [_reason(code, targets) for code in codes]
    reasons = [reason for target, reason in found if place is None or target in ("", place)]
    known = sorted((each for each in reasons if each is not None), key=_RANK.__getitem__)
    if not valid:
        worst = next((OF_REASON[reason] for reason in known), Status.BAD)
        return worst if worst.is_bad else Status.BAD
    statuses = [OF_REASON[reason] for reason in known if OF_REASON[reason] is not Status.GOOD]
    status = next(iter(statuses), Status.GOOD)
    if status.is_bad or (status is Status.GOOD and (None in reasons or not has_time)):
        return Status.UNCERTAIN
    return status


def status_of_sensor(said: Mapping[str, Any] | None, of_measurement: Status) -> Status:
    """Status of another sensor's value; ``said`` is its entry in ``sensors``, None: no sensor is fitted."""
    if said is None:
        return Status.BAD_NOT_CONNECTED
    status = OF_SENSOR.get(said["quality"], Status.BAD)
    if status.is_bad or of_measurement is not Status.UNCERTAIN_SIMULATED_VALUE:
        return status
    return of_measurement


def _reason(code: str, targets: Collection[str]) -> tuple[str, Reason | None]:
    """Target whose name begins a code (empty: none), and the reason (None: not known)."""
    for target in targets:
        reason = _BY_CODE.get(code.removeprefix(f"{target}_"))
        if reason is not None and str(reason) != code:
            return target, reason
    return "", _BY_CODE.get(code)
