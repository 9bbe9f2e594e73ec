"""Present faults, from the latest measurement and the components' reports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from altd.reasons import Reason
from altd.records import Fault, FaultCause, Measurement
from altd.status.cause import Cause
from altd.status.conditions import Condition
from altd.status.health import COMPUTER, MEASURING, CameraTrouble, Component, State

START_S = 2.0
"""Time after the daemon's start during which the unit counts as starting: cameras take time to open, s."""

MAX_START_S = 15.0
"""Time after which a component that is still starting counts as not started, s."""

_WHILE_CAMERAS_OPEN = {Reason.CAMERA_SILENT, Reason.STALE, Condition.CAMERA_FAILED}
"""Reasons that are not a failure while the unit starts."""

OF_DELAYS = {
    Reason.CAMERA_SILENT,
    Reason.OUT_OF_STEP,
    Reason.WARMING_UP,
    Reason.STALE,
    Reason.EXPOSURES_LOST,
    Condition.NOTHING_MEASURED,
    Condition.CAMERA_DEGRADED,
    Condition.COMPONENT_SILENT,
}
"""Causes that a busy computer has, too. Unless a camera has failed, it is then the first suspect."""

_FACES = {"modbus_tcp", "modbus_rtu", "http", "mqtt", "opcua", "local", "serial"}
"""Kinds of components that are external interfaces."""


def causes_now(
    measurement: Measurement | None, components: Iterable[Component], now_ns: int, running_s: float
) -> list[Cause]:
    """Return every cause that is true now, for a daemon that has run for ``running_s``.

    ``measurement`` is the board's current one; None: nothing yet.
    """
    causes = [*_of_measurement(measurement), *_of_components(components, now_ns)]
    is_measuring = measurement is not None and measurement.valid
    if running_s < START_S and not is_measuring:
        causes = [cause for cause in causes if cause.kind not in _WHILE_CAMERAS_OPEN]
        return [Cause(Condition.STARTING), *causes]
    if measurement is None:
        causes.insert(0, Cause(Condition.NOTHING_MEASURED))
    kinds = {cause.kind for cause in causes}
    if Condition.COMPUTER_BUSY in kinds and Condition.CAMERA_FAILED not in kinds:
        busy = FaultCause.BUSY_COMPUTER
        causes = [replace(cause, known=busy) if cause.kind in OF_DELAYS else cause for cause in causes]
    return causes


def _of_measurement(measurement: Measurement | None) -> Iterator[Cause]:
    if measurement is None:
        return
    for fault in measurement.status:
        yield _of_fault(fault)
    if not measurement.valid and all(is_warning(fault) for fault in measurement.status):
        yield Cause(Condition.UNKNOWN_REASON, detail="a measurement is invalid and does not say why")


def _of_fault(fault: Fault) -> Cause:
    reason: object = fault.reason
    if isinstance(reason, Reason):
        return Cause(reason, fault.target, fault.detail, fault.cause)
    return Cause(Condition.UNKNOWN_REASON, fault.target, str(reason))


def is_warning(fault: Fault) -> bool:
    """Whether a measurement with this fault may be valid; an unknown reason is not a warning."""
    return isinstance(fault.reason, Reason) and fault.reason.is_warning


def _of_components(components: Iterable[Component], now_ns: int) -> Iterator[Cause]:
    for component in components:
        if (silent_s := component.silent_s(now_ns)) is not None:
            yield Cause(Condition.COMPONENT_SILENT, component.name, f"for {silent_s:.1f} s")
        condition = _of_component(component, now_ns)
        if condition is not None:
            yield Cause(condition, component.name, component.message)


def _of_component(component: Component, now_ns: int) -> Condition | None:
    """Return the condition of a component's state; None: no fault, or one that the measurement reports."""
    match component.state:
        case State.OK:
            return None
        case State.STARTING:
            is_late = now_ns - component.since_ns > MAX_START_S * 1e9
            return Condition.NOT_STARTED if is_late else None
        case State.DEGRADED:
            if component.name == MEASURING:
                return None
            if component.trouble is CameraTrouble.AUTOMATIC:
                return Condition.CAMERA_AUTOMATIC
            return _DEGRADED.get(component.kind, Condition.COMPONENT_DEGRADED)
        case State.ENDED if component.kind == "camera":
            return Condition.RECORDING_ENDED
        case State.FAILED if component.kind in _FACES:
            return Condition.FACE_FAILED
        case State.FAILED:
            return _FAILED.get(component.kind, Condition.COMPONENT_FAILED)
    return Condition.COMPONENT_FAILED


_DEGRADED = {"camera": Condition.CAMERA_DEGRADED, COMPUTER: Condition.COMPUTER_BUSY}

_FAILED = {
    "camera": Condition.CAMERA_FAILED,
    "lamps": Condition.LAMPS_FAILED,
    "indicators": Condition.INDICATORS_FAILED,
    "inclinometer": Condition.SENSOR_FAILED,
    "temperature": Condition.TEMPERATURE_UNKNOWN,
}
