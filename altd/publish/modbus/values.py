"""Sources of the register values: each function reads one from a view.

Status bits and reason codes are contracts with controllers: new ones are added, old ones never change their
meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from altd.reasons import NOT_FROM_CAMERAS, Reason, Signal, StatusGroup
from altd.records import Measurement
from altd.status.unit import UnitView


@dataclass(frozen=True, slots=True)
class StatusBit:
    """A bit of the status word, and the reasons that set it."""

    bit: int
    name: str
    meaning: str
    reasons: frozenset[Reason] = frozenset()
    target: str | None = None
    """Target whose reasons set the bit; None: any target and the whole unit."""

    @property
    def warnings(self) -> tuple[Reason, ...]:
        """Reasons among these that a valid measurement may carry."""
        return tuple(reason for reason in Reason if reason in self.reasons and reason.is_warning)


VALID, NOTHING_YET = 0, 1
"""Bits that describe the measurement itself."""


def _of(group: StatusGroup) -> frozenset[Reason]:
    return frozenset(reason for reason in Reason if reason.group is group)


STATUS_BITS = (
    StatusBit(VALID, "valid", "the numbers are known; steer only while bits 12 and 13 are 0"),
    StatusBit(NOTHING_YET, "nothing yet", "no measurement since the daemon started"),
    StatusBit(2, "stale", "nothing new for too long", _of(StatusGroup.STALE)),
    StatusBit(3, "warming up", "not enough exposures yet, or no self-check", _of(StatusGroup.WARMING_UP)),
    StatusBit(4, "out of range", "a spot is outside the calibrated area", _of(StatusGroup.OUT_OF_RANGE)),
    StatusBit(
        5, "not synchronised", "the cameras' exposures are at different times", _of(StatusGroup.OUT_OF_STEP)
    ),
    StatusBit(6, "unsteady", "the spots move too much to be averaged", _of(StatusGroup.UNSTEADY)),
    StatusBit(7, "exposures lost", "some exposures were not usable", _of(StatusGroup.EXPOSURES_LOST)),
    StatusBit(8, "front spot bad", "no usable spot", _of(StatusGroup.SPOT_BAD), "front"),
    StatusBit(9, "rear spot bad", "no usable spot", _of(StatusGroup.SPOT_BAD), "rear"),
    StatusBit(10, "front camera silent", "no frames", _of(StatusGroup.CAMERA_SILENT), "front"),
    StatusBit(11, "rear camera silent", "no frames", _of(StatusGroup.CAMERA_SILENT), "rear"),
    StatusBit(12, "playback", "not live: a recording is played", _of(StatusGroup.PLAYBACK)),
    StatusBit(13, "simulated", "frames or calibration are simulated", _of(StatusGroup.SIMULATED)),
    StatusBit(14, "implausible", "two maps of a target contradict each other", _of(StatusGroup.IMPLAUSIBLE)),
    StatusBit(
        15,
        "not trusted",
        "a check of cameras, frames, numbers or geometry failed",
        _of(StatusGroup.NOT_TRUSTED),
    ),
)
"""Bits of the status word; unlisted bits are 0."""

PLACE_WARNINGS = (
    Reason.ALARM_DISPLACEMENT,
    Reason.ALARM_RATE,
    Reason.STUCK_OPAQUE,
    Reason.BEAM_LOST_BEHIND,
    Reason.STABLE_MOVED,
    Reason.NO_BASELINE,
    Reason.SWITCH_UNSEEN,
)
"""Warnings of a place, in the order of their bits."""

ROW_WARNINGS = (
    Reason.BASELINE_INCOMPLETE,
    Reason.STABLE_DISAGREE,
    Reason.BEAM_ANGLE_UNKNOWN,
    Reason.BEAM_DRIFT_UNKNOWN,
    Reason.BEAM_NOT_CLOSED,
)
"""Warnings of the whole row, in the order of their bits."""

WITHOUT_BIT = tuple(
    reason
    for reason in Reason
    if reason.is_warning
    and reason not in (*PLACE_WARNINGS, *ROW_WARNINGS)
    and not any(reason in row.reasons for row in STATUS_BITS)
)
"""Warnings without a bit: ``rehearsal`` and those of sensors; all bits of the status word are taken."""

REASON_CODES = tuple(
    sorted((reason for reason in Reason if reason.modbus_code), key=lambda reason: reason.modbus_code)
)
"""All reasons except warnings, sorted by number; 0 means no reason."""


def status_word(measurement: Measurement | None) -> int:
    """Return the status word of a measurement; None: no measurement yet."""
    if measurement is None:
        return 1 << NOTHING_YET
    word = int(measurement.valid) << VALID
    for fault in measurement.status:
        for row in STATUS_BITS:
            if fault.reason in row.reasons and row.target in (None, fault.target):
                word |= 1 << row.bit
    return word


def reason_code(measurement: Measurement | None, target: str | None) -> int:
    """Return the code of the first reason, except warnings, of this target (None: the whole unit), else 0."""
    if measurement is None:
        return Reason.WARMING_UP.modbus_code if target is None else 0
    for fault in measurement.status:
        if fault.target == target and not fault.reason.is_warning:
            return fault.reason.modbus_code
    return 0


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


Reading = Callable[[UnitView], float | str | None]
"""Function that reads a value from a view, text for a register of text; None: not known."""


def has(measurement: Measurement, *reasons: Reason) -> bool:
    """Whether a measurement carries one of these reasons."""
    return any(fault.reason in reasons for fault in measurement.status)


def state(view: UnitView) -> int | None:
    """Number of the unit's signal; None: not known."""
    return None if view.state is None else view.state.signal.number


STATE_MEANING = "NAMUR NE 107: " + ", ".join(
    f"{signal.number} {signal.replace('_', ' ')}" for signal in sorted(Signal, key=lambda each: each.number)
)
"""Meaning of a register with ``state``."""


def of_identity(name: str) -> Reading:
    """``unit`` or ``session`` of the identity, by ``name``."""
    return lambda view: getattr(view.identity, name)


def uptime_s(view: UnitView) -> float:
    """Seconds since the daemon started."""
    return view.running_ns * 1e-9


def status(view: UnitView) -> int:
    """The status word."""
    return status_word(view.measurement)


def reason(target: str | None) -> Reading:
    """Code of the first reason of a target; None: the whole unit."""
    return lambda view: reason_code(view.measurement, target)


def exposures(view: UnitView) -> float | None:
    """Number of exposures that were averaged for the measurement."""
    return view.measurement.frames if view.measurement else None


def number(key: str) -> Reading:
    """The value of a quantity."""
    return lambda view: view.measurement.number(key) if view.measurement else None


def sigma(key: str) -> Reading:
    """The standard deviation of a quantity."""
    return lambda view: view.measurement.sigma(key) if view.measurement else None


def sigma_random(key: str) -> Reading:
    """The part of a quantity's sigma that scatters."""
    return lambda view: view.measurement.sigma_random(key) if view.measurement else None


def sigma_now(key: str) -> Reading:
    """Standard deviation of a quantity as a statement about the truth at the time of reading."""

    def sigma(view: UnitView) -> float | None:
        if view.measurement is None or view.age_s is None:
            return None
        return view.measurement.sigma_at(key, view.age_s)

    return sigma


def rate(key: str) -> Reading:
    """The rate of a quantity, per second."""

    def value(view: UnitView) -> float | None:
        known = view.measurement and view.measurement.rates.get(key)
        return known.value if known else None

    return value


def of_target(target: str, key: str) -> Reading:
    """The value of a quantity on a target."""

    def coordinate(view: UnitView) -> float | None:
        values = (view.measurement and view.measurement.targets.get(target)) or {}
        return values[key].value if key in values else None

    return coordinate


def targets(view: UnitView) -> int | None:
    """Number of targets of a row; None: no row has been measured yet."""
    measurement = view.measurement
    return len(measurement.targets) if measurement and measurement.quantities.has_places else None


def _place(view: UnitView, number: int) -> tuple[Measurement, str] | None:
    """The measurement, and the name of the target with that number, from 1; None: there is none."""
    measurement = view.measurement
    if measurement is None or not measurement.quantities.has_places or number > len(measurement.targets):
        return None
    return measurement, list(measurement.targets)[number - 1]


def of_place(number: int, key: str, part: str = "value") -> Reading:
    """The value, or the ``sigma``, of a quantity of the place with that number."""

    def value(view: UnitView) -> float | None:
        if (place := _place(view, number)) is None:
            return None
        measurement, name = place
        known = measurement.known(f"{name}_{key}") or measurement.known_of(f"{name}.{key}")
        return None if known is None else getattr(known, part)

    return value


def reason_of_place(number: int) -> Reading:
    """Code of the first reason why a place was not measured."""

    def code(view: UnitView) -> int | None:
        place = _place(view, number)
        return None if place is None else reason_code(*place)

    return code


def warnings_of_place(number: int) -> Reading:
    """The bits of ``PLACE_WARNINGS``."""

    def bits(view: UnitView) -> int | None:
        if (place := _place(view, number)) is None:
            return None
        return _bits(*place, PLACE_WARNINGS)

    return bits


def row_warnings(view: UnitView) -> int | None:
    """The bits of ``ROW_WARNINGS``."""
    measurement = view.measurement
    return (
        _bits(measurement, None, ROW_WARNINGS) if measurement and measurement.quantities.has_places else None
    )


def _bits(measurement: Measurement, target: str | None, reasons: Sequence[Reason]) -> int:
    said = {fault.reason for fault in measurement.status if fault.target == target}
    return sum((reason in said) << bit for bit, reason in enumerate(reasons))


def age_tenths(view: UnitView) -> float | None:
    """Time since the middle of the exposures in units of 0.1 s, because a round takes long."""
    return None if view.age_s is None else 10.0 * view.age_s


def sequence(view: UnitView) -> int | None:
    """Number of the last exposure; after 0xFFFFFFFE it restarts at 0."""
    return view.measurement.sequence % 0xFFFF_FFFF if view.measurement else None


def age_ms(view: UnitView) -> float | None:
    """Milliseconds since the middle of the exposures."""
    return None if view.age_s is None else 1000.0 * view.age_s


def utc_s(view: UnitView) -> int | None:
    """Middle of the exposures, seconds since 1970, UTC."""
    ms = _utc_ms(view)
    return None if ms is None else ms // 1000


def utc_rest_ms(view: UnitView) -> int | None:
    """Milliseconds that follow ``utc_s``, 0 to 999."""
    ms = _utc_ms(view)
    return None if ms is None else ms % 1000


def _utc_ms(view: UnitView) -> int | None:
    time = view.measurement and view.measurement.time
    return (time - _EPOCH) // timedelta(milliseconds=1) if time else None


def constant(value: float | None) -> Reading:
    """A constant value; None: never known."""
    return lambda _: value


@dataclass(frozen=True, slots=True)
class DiscreteInput:
    """A bit that function 2 reads; its address is its index in ``DISCRETE_INPUTS``."""

    name: str
    meaning: str
    is_set: Callable[[UnitView], bool]


def _is_valid(view: UnitView) -> bool:
    return view.measurement is not None and view.measurement.valid


def _has_reason(*reasons: Reason) -> Callable[[UnitView], bool]:
    return lambda view: view.measurement is not None and has(view.measurement, *reasons)


def _has_signal(signal: Signal) -> Callable[[UnitView], bool]:
    return lambda view: view.state is not None and view.state.signal is signal


DISCRETE_INPUTS = (
    DiscreteInput("valid", "as bit 0 of `status`; steer only while `not_live` is 0", _is_valid),
    DiscreteInput("failure", "the state is failure", _has_signal(Signal.FAILURE)),
    DiscreteInput("check_function", "check function", _has_signal(Signal.CHECK_FUNCTION)),
    DiscreteInput("out_of_specification", "out of specification", _has_signal(Signal.OUT_OF_SPECIFICATION)),
    DiscreteInput("maintenance_required", "maintenance required", _has_signal(Signal.MAINTENANCE_REQUIRED)),
    DiscreteInput(
        "not_live", "frames or calibration are played or simulated", _has_reason(*NOT_FROM_CAMERAS)
    ),
    DiscreteInput("rehearsal", "the daemon was started with `--rehearsal`", _has_reason(Reason.REHEARSAL)),
)
