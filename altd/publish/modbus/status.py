"""The status word and the reason codes: how a measurement's faults become numbers.

Bits and numbers are contracts with controllers: new ones are added, old ones never change their meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

from altd.records import Measurement, Reason


@dataclass(frozen=True, slots=True)
class StatusBit:
    """A bit of the status word, and the reasons that set it."""

    bit: int
    name: str
    meaning: str
    reasons: frozenset[Reason] = frozenset()
    target: str | None = None
    """Only the reasons of this target count; None: of any target and of the whole unit."""


@dataclass(frozen=True, slots=True)
class ReasonCode:
    """The number of a reason for which values are missing."""

    code: int
    reason: Reason
    meaning: str


VALID, NOTHING_YET = 0, 1
"""Bits that say something of the measurement itself."""

_NO_SPOT = frozenset(
    {
        Reason.SPOT_MISSING,
        Reason.AMBIGUOUS,
        Reason.SATURATED,
        Reason.CUT_BY_EDGE,
        Reason.WRONG_SIZE,
        Reason.WRONG_SHAPE,
        Reason.DISTORTED,
        Reason.EXPOSURE_CHANGING,
    }
)
_NOT_TRUSTED = frozenset({Reason.FRAME_REPEATED, Reason.WRONG_CAMERA, Reason.CHECK_FAILED})


def _only(reason: Reason) -> frozenset[Reason]:
    return frozenset({reason})


STATUS_BITS = (
    StatusBit(VALID, "valid", "the numbers may be used"),
    StatusBit(NOTHING_YET, "nothing yet", "no measurement since the daemon started"),
    StatusBit(2, "stale", "nothing new for too long; the numbers are gone", _only(Reason.STALE)),
    StatusBit(3, "warming up", "not enough exposures yet", _only(Reason.WARMING_UP)),
    StatusBit(4, "out of range", "a spot lies outside the calibrated area", _only(Reason.OUT_OF_RANGE)),
    StatusBit(5, "out of step", "the cameras' exposures do not fit together", _only(Reason.OUT_OF_STEP)),
    StatusBit(6, "unsteady", "the spots move too much to be averaged", _only(Reason.UNSTEADY)),
    StatusBit(7, "exposures lost", "warning: some exposures were not usable", _only(Reason.EXPOSURES_LOST)),
    StatusBit(8, "front spot bad", "no usable spot on the front target", _NO_SPOT, "front"),
    StatusBit(9, "rear spot bad", "no usable spot on the rear target", _NO_SPOT, "rear"),
    StatusBit(10, "front camera silent", "no frames come from it", _only(Reason.CAMERA_SILENT), "front"),
    StatusBit(11, "rear camera silent", "no frames come from it", _only(Reason.CAMERA_SILENT), "rear"),
    StatusBit(12, "playback", "warning: not live, a recording is played", _only(Reason.PLAYBACK)),
    StatusBit(13, "simulated", "warning: frames or calibration are simulated", _only(Reason.SIMULATED)),
    StatusBit(14, "implausible", "two maps of a target contradict each other", _only(Reason.IMPLAUSIBLE)),
    StatusBit(15, "not trusted", "a camera, its frames or the numbers did not pass a check", _NOT_TRUSTED),
)
"""The status word; bits that are not listed are 0."""

REASON_CODES = (
    ReasonCode(1, Reason.SPOT_MISSING, "no spot"),
    ReasonCode(2, Reason.AMBIGUOUS, "a second spot of like size"),
    ReasonCode(3, Reason.SATURATED, "spot too bright for the camera"),
    ReasonCode(4, Reason.CUT_BY_EDGE, "spot cut by the edge of the image"),
    ReasonCode(5, Reason.WRONG_SIZE, "spot too small or too large"),
    ReasonCode(6, Reason.WRONG_SHAPE, "spot not round enough to be the laser"),
    ReasonCode(7, Reason.CAMERA_SILENT, "no frames come from the camera"),
    ReasonCode(8, Reason.IMPLAUSIBLE, "two maps of the target contradict each other"),
    ReasonCode(9, Reason.EXPOSURE_CHANGING, "the camera's exposure is being set anew"),
    ReasonCode(10, Reason.DISTORTED, "the spot is not what it was when the unit was calibrated"),
    ReasonCode(11, Reason.FRAME_REPEATED, "the camera delivers the same picture again"),
    ReasonCode(12, Reason.WRONG_CAMERA, "not the camera, or not the view, that was calibrated"),
    ReasonCode(20, Reason.OUT_OF_STEP, "the cameras' exposures do not fit together"),
    ReasonCode(21, Reason.OUT_OF_RANGE, "spot outside the calibrated area"),
    ReasonCode(22, Reason.UNSTEADY, "the spots move too much to be averaged"),
    ReasonCode(23, Reason.WARMING_UP, "not enough exposures yet"),
    ReasonCode(24, Reason.STALE, "nothing new for too long"),
    ReasonCode(25, Reason.CHECK_FAILED, "the numbers did not pass the last check before they are published"),
)
"""Every reason that is not a warning; 0 is none."""

_CODES = {row.reason: row.code for row in REASON_CODES}


def status_word(measurement: Measurement | None) -> int:
    """The status word of a measurement, or of none yet."""
    if measurement is None:
        return 1 << NOTHING_YET
    word = int(measurement.valid) << VALID
    for fault in measurement.status:
        for row in STATUS_BITS:
            if fault.reason in row.reasons and row.target in (None, fault.target):
                word |= 1 << row.bit
    return word


def reason_code(measurement: Measurement | None, target: str | None) -> int:
    """The code of the first reason, warnings aside, that concerns this target (None: the whole unit)."""
    for fault in measurement.status if measurement else ():
        if fault.target == target and not fault.reason.is_warning:
            return _CODES[fault.reason]
    return 0
