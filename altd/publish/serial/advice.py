"""Steps for a technician: by the cause of a fault, and by the reports of components."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from altd.reasons import Reason
from altd.records import Fault
from altd.status.health import MEASURING, Component, State


class Advice(NamedTuple):
    """Meaning of a fault and its remedy."""

    means: str
    remedy: str


_ONE_TARGET_DARK = Advice(
    "no laser spot", "the laser reaches the other target: check what covers this one or its camera"
)
_CAMERA_BELOW = Advice("the camera delivers no frames", "see the camera below")

_CAMERA_REMEDIES = {
    "not found": "check its cable and power",
    "busy": "end the program that uses it",
    "lost": "check its cable and supply",
    "refused": "check its table in the config",
    "the driver does not return": "unplug it and plug it in again",
    "no frame for": "check its trigger, cable and supply",
    "exposure refused": "check its limits in the config",
}
"""Remedies, by the beginning of a camera's health message."""


def advice(fault: Fault, status: Iterable[Fault], components: Iterable[Component] = ()) -> Advice:
    """Return the fault and its remedy, by the fault's detail, the other faults and the components."""
    if fault.cause is not None:
        return Advice(fault.cause.meaning, fault.cause.remedy)
    if fault.reason is Reason.SPOT_MISSING and {other.target for other in status} - {None} == {fault.target}:
        return _ONE_TARGET_DARK
    if fault.reason is Reason.CAMERA_SILENT and any(map(is_faulty_camera, components)):
        return _CAMERA_BELOW
    return Advice(fault.reason.brief, fault.reason.remedy)


def is_faulty_camera(component: Component) -> bool:
    """Whether it is a camera that does not deliver as it should."""
    return component.name.startswith("camera ") and component.state not in (State.OK, State.STARTING)


def component_steps(components: Iterable[Component], status: Iterable[Fault]) -> Iterable[str]:
    """Yield faults of components, with their remedies.

    ``measuring`` is omitted if ``status`` already reports it in other words.
    """
    has_fault = any(status)
    for component in components:
        is_faulty = component.state in (State.FAILED, State.DEGRADED) or is_faulty_camera(component)
        if not is_faulty or (component.name == MEASURING and has_fault):
            continue
        message = component.message
        remedy = next((does for words, does in _CAMERA_REMEDIES.items() if message.startswith(words)), "")
        yield f"{component.name} {component.state}: {message or 'no more is known'}" + (
            f": {remedy}" if remedy and is_faulty_camera(component) else ""
        )
