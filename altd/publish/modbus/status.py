"""The status word and the reason codes: how a measurement's faults become numbers.

Bits and numbers are contracts with controllers: new ones are added, old ones never change their meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

from altd.reasons import Reason, StatusGroup
from altd.records import Measurement


@dataclass(frozen=True, slots=True)
class StatusBit:
    """A bit of the status word, and the reasons that set it."""

    bit: int
    name: str
    meaning: str
    reasons: frozenset[Reason] = frozenset()
    target: str | None = None
    """Only the reasons of this target count; None: of any target and of the whole unit."""

    @property
    def warnings(self) -> tuple[Reason, ...]:
        """Those of its reasons that a valid measurement may carry."""
        return tuple(reason for reason in Reason if reason in self.reasons and reason.is_warning)


VALID, NOTHING_YET = 0, 1
"""Bits that say something of the measurement itself."""


def _of(group: StatusGroup) -> frozenset[Reason]:
    return frozenset(reason for reason in Reason if reason.group is group)


STATUS_BITS = (
    StatusBit(VALID, "valid", "the numbers may be used"),
    StatusBit(NOTHING_YET, "nothing yet", "no measurement since the daemon started"),
    StatusBit(2, "stale", "nothing new for too long; the numbers are gone", _of(StatusGroup.STALE)),
    StatusBit(3, "warming up", "not enough exposures yet, or no self-check", _of(StatusGroup.WARMING_UP)),
    StatusBit(4, "out of range", "a spot lies outside the calibrated area", _of(StatusGroup.OUT_OF_RANGE)),
    StatusBit(5, "out of step", "the cameras' exposures do not fit together", _of(StatusGroup.OUT_OF_STEP)),
    StatusBit(6, "unsteady", "the spots move too much to be averaged", _of(StatusGroup.UNSTEADY)),
    StatusBit(
        7, "exposures lost", "warning: some exposures were not usable", _of(StatusGroup.EXPOSURES_LOST)
    ),
    StatusBit(8, "front spot bad", "no usable spot on the front target", _of(StatusGroup.SPOT_BAD), "front"),
    StatusBit(9, "rear spot bad", "no usable spot on the rear target", _of(StatusGroup.SPOT_BAD), "rear"),
    StatusBit(10, "front camera silent", "no frames come from it", _of(StatusGroup.CAMERA_SILENT), "front"),
    StatusBit(11, "rear camera silent", "no frames come from it", _of(StatusGroup.CAMERA_SILENT), "rear"),
    StatusBit(12, "playback", "warning: not live, a recording is played", _of(StatusGroup.PLAYBACK)),
    StatusBit(13, "simulated", "warning: frames or calibration are simulated", _of(StatusGroup.SIMULATED)),
    StatusBit(14, "implausible", "two maps of a target contradict each other", _of(StatusGroup.IMPLAUSIBLE)),
    StatusBit(
        15,
        "not trusted",
        "a camera, its frames, the numbers, or where cameras and targets are, did not pass a check",
        _of(StatusGroup.NOT_TRUSTED),
    ),
)
"""The status word; bits that are not listed are 0."""

WITHOUT_BIT = tuple(reason for reason in Reason if not any(reason in row.reasons for row in STATUS_BITS))
"""What the status word does not show: warnings of sensors, for all of its bits are taken."""

REASON_CODES = tuple(
    sorted((reason for reason in Reason if reason.modbus_code), key=lambda reason: reason.modbus_code)
)
"""Every reason that is not a warning, by its number; 0 is none."""


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
            return fault.reason.modbus_code
    return 0
