"""Faults of the unit beside the measurement's own reasons: the second table of causes.

The reasons in ``altd.reasons`` make a measurement invalid. A condition of this table never makes it invalid,
but the unit as a whole is not good. Codes are contracts, like those of reasons.
"""

from __future__ import annotations

from enum import StrEnum

from altd.reasons import Signal

_, _FAILURE, _CHECK_FUNCTION, _OUT_OF_SPECIFICATION, _MAINTENANCE_REQUIRED = Signal
_RESTART = "restart the unit; if this continues, send the archive of `altd diagnose` to support"


class Condition(StrEnum):
    """A row of the table: code, signal, brief, remedy, meaning, as in ``altd.reasons.Reason``."""

    STARTING = (
        "starting", _CHECK_FUNCTION,
        "the unit starts",
        "wait some seconds",
        "no valid measurement yet, in the first 2 s",
    )  # fmt: skip
    NOTHING_MEASURED = (
        "nothing_measured", _FAILURE,
        "nothing was measured since the start",
        "check the cameras' cables and supply; if this continues, run `altd doctor`",
        "no measurement, not even an invalid one, 2 s after the start",
    )  # fmt: skip
    UNKNOWN_REASON = (
        "unknown_reason", _FAILURE,
        "the reason is unknown",
        "update or restart the unit, and report it",
        "an unknown reason, or none for an invalid measurement: a defect",
    )  # fmt: skip
    CAMERA_FAILED = (
        "camera_failed", _FAILURE,
        "a camera has failed",
        "check the camera's cable and supply",
        "a camera could not be opened or was lost; the unit tries again",
    )  # fmt: skip
    CAMERA_DEGRADED = (
        "camera_degraded", _MAINTENANCE_REQUIRED,
        "the camera loses frames",
        "check the camera's cable, and its table in the config",
        "frames are lost, late or have impossible times, or the camera refuses its exposure",
    )  # fmt: skip
    CAMERA_AUTOMATIC = (
        "camera_automatic", _MAINTENANCE_REQUIRED,
        "the camera changes its picture automatically",
        "accept the automatic mode in the camera's table in the config, or use another camera",
        "automatic exposure, gain, white balance or focus that could not be switched off",
    )  # fmt: skip
    RECORDING_ENDED = (
        "recording_ended", _CHECK_FUNCTION,
        "the recording is at its end",
        "restart the unit, or set `repeat` in the config",
        "a recording was played to its end",
    )  # fmt: skip
    FACE_FAILED = (
        "face_failed", _MAINTENANCE_REQUIRED,
        "a connection to the outside has failed",
        "check that the port or address is free and right, and the cable",
        "Modbus, HTTP, MQTT, OPC UA or a serial port is not served; the other interfaces are right",
    )  # fmt: skip
    LAMPS_FAILED = (
        "lamps_failed", _MAINTENANCE_REQUIRED,
        "the frame LEDs cannot be switched",
        "check the lamps' chip, lines and cable",
        "the frame LEDs cannot be switched: no self-check is possible",
    )  # fmt: skip
    INDICATORS_FAILED = (
        "indicators_failed", _MAINTENANCE_REQUIRED,
        "the lamps on the housing have failed",
        "check the indicators' chip and lines",
        "the lamps on the housing do not show the unit's state; do not trust them",
    )  # fmt: skip
    SENSOR_FAILED = (
        "sensor_failed", _MAINTENANCE_REQUIRED,
        "a sensor beside the cameras has failed",
        "check the sensor's cable, supply and table in the config",
        "an inclinometer gives no value; the beam's numbers are right",
    )  # fmt: skip
    COMPONENT_FAILED = (
        "component_failed", _FAILURE,
        "a component has failed",
        _RESTART,
        "another component has failed or ended",
    )  # fmt: skip
    COMPONENT_DEGRADED = (
        "component_degraded", _MAINTENANCE_REQUIRED,
        "a component works in part only",
        _RESTART,
        "a component other than a camera is degraded; its message is in brackets",
    )  # fmt: skip
    COMPONENT_SILENT = (
        "component_silent", _FAILURE,
        "a component no longer responds",
        "restart the unit, and report it",
        "a component has not reported in time: it has ended or hangs",
    )  # fmt: skip
    NOT_STARTED = (
        "not_started", _MAINTENANCE_REQUIRED,
        "a component does not come up",
        _RESTART,
        "a component is still starting after 15 s",
    )  # fmt: skip
    TOO_COLD = (
        "too_cold", _OUT_OF_SPECIFICATION,
        "it is too cold",
        "warm the unit, or wait until it has warmed itself",
        "below the sensor's limit; the unit is made for -10 to +60 °C",
    )  # fmt: skip
    TOO_HOT = (
        "too_hot", _OUT_OF_SPECIFICATION,
        "it is too hot",
        "shade or cool the unit",
        "above the sensor's limit; the unit is made for -10 to +60 °C",
    )  # fmt: skip
    TEMPERATURE_UNKNOWN = (
        "temperature_unknown", _MAINTENANCE_REQUIRED,
        "a temperature cannot be read",
        "check the sensor and its table in the config",
        "a sensor is missing, gives no value or an impossible one",
    )  # fmt: skip
    LASER_WEAK = (
        "laser_weak", _MAINTENANCE_REQUIRED,
        "the laser has become weak",
        "clean the window, check the laser's supply and age",
        "a spot's light is below `min_light_share` of the reference",
    )  # fmt: skip
    RESIDUALS_RISING = (
        "residuals_rising", _MAINTENANCE_REQUIRED,
        "the spot fits less and less well",
        "clean the window and the targets, look for weak reflections",
        "the residuals of a spot's fit are above `max_residual_share`",
    )  # fmt: skip
    DUSTY = (
        "dusty", _MAINTENANCE_REQUIRED,
        "dust is seen under the spot",
        "clean the window; if it remains on one target only, that target",
        "specks that are not in the calibration cover more than `max_dust_share`",
    )  # fmt: skip
    CALIBRATION_DUE = (
        "calibration_due", _MAINTENANCE_REQUIRED,
        "the calibration is old",
        "calibrate again",
        "the calibration is older than `calibration_due_days`",
    )  # fmt: skip
    COMPUTER_BUSY = (
        "computer_busy", _MAINTENANCE_REQUIRED,
        "the computer is busy",
        "end other programs on the unit's computer; `altd doctor` names them",
        "a thread of altd waits longer for a processor than it rests, or the daemon responds 0.1 s late",
    )  # fmt: skip
    CLOCK_WRONG = (
        "clock_wrong", _MAINTENANCE_REQUIRED,
        "the clock is wrong",
        "set the computer's clock, check its time server",
        "the calibration is more than a day newer than the clock",
    )  # fmt: skip

    signal: Signal
    brief: str
    remedy: str
    meaning: str

    def __new__(cls, code: str, signal: Signal, brief: str, remedy: str, meaning: str) -> Condition:
        """Create a member that is equal to its code."""
        condition = str.__new__(cls, code)
        condition._value_ = code
        condition.signal = signal
        condition.brief, condition.remedy, condition.meaning = brief, remedy, meaning
        return condition
