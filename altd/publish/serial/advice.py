"""Steps for a technician: by the cause of a fault, and by the reports of components."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from altd.reasons import Reason
from altd.records import Fault, FaultCause
from altd.status.causes import OF_DELAYS
from altd.status.health import COMPUTER, MEASURING, ComponentReport, State


class Advice(NamedTuple):
    """Meaning of a fault and its remedy."""

    means: str
    remedy: str


_ONE_TARGET_DARK = Advice(
    "no laser spot", "the laser reaches the other target: check what covers this one or its camera"
)
_CAMERA_BELOW = Advice("the camera delivers no frames", "see the camera below")


def advice(fault: Fault, status: Iterable[Fault], components: Iterable[ComponentReport] = ()) -> Advice:
    """Return the fault and its remedy, by its cause, the other faults and the components."""
    cause, components = fault.cause, list(components)
    has_failed = any(
        component.kind == "camera" and component.state is State.FAILED for component in components
    )
    if fault.reason in OF_DELAYS and not has_failed and any(_is_busy(component) for component in components):
        cause = FaultCause.BUSY_COMPUTER
    if cause is not None:
        return Advice(cause.meaning, cause.remedy)
    if fault.reason is Reason.SPOT_MISSING and {other.target for other in status} - {None} == {fault.target}:
        return _ONE_TARGET_DARK
    if fault.reason is Reason.CAMERA_SILENT and any(component.is_faulty_camera for component in components):
        return _CAMERA_BELOW
    return Advice(fault.reason.brief, fault.reason.remedy)


def _is_busy(component: ComponentReport) -> bool:
    return component.name == COMPUTER and component.state is State.DEGRADED


def component_steps(components: Iterable[ComponentReport], status: Iterable[Fault]) -> Iterable[str]:
    """Yield faults of components, with their remedies.

    ``measuring`` is omitted if ``status`` already reports it in other words; a busy computer is a cause of
    the state.
    """
    has_fault = any(status)
    for component in components:
        is_faulty = component.state in (State.FAILED, State.DEGRADED) or component.is_faulty_camera
        if not is_faulty or _is_busy(component) or (component.name == MEASURING and has_fault):
            continue
        remedy = f": {component.trouble.value}" if component.trouble and component.is_faulty_camera else ""
        yield f"{component.name} {component.state}: {component.message or 'no details'}{remedy}"
