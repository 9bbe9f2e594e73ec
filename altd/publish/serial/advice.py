"""What a reason means and what to do about it, by what was seen."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from altd.reasons import LEDS_LIT, Reason
from altd.records import Fault
from altd.status.health import MEASURING, Component, State


class Advice(NamedTuple):
    """What is wrong, and what to do about it."""

    means: str
    remedy: str


_CLEAN_THE_WINDOW = "clean the window, look for reflections and for objects in the beam"
_RIGHT_CAMERA = "swap the cameras' cables or put the old camera back"

_LEDS = Advice(
    LEDS_LIT,
    "they are dark while it measures: look for what lights them, `altd lamps on` or their wiring",
)

_SEEN: dict[Reason, dict[str, Advice]] = {
    Reason.SPOT_MISSING: {
        "too dim": Advice(
            "the spot is too dim", "clean the window, give the laser more power or expose longer"
        ),
    },
    Reason.AMBIGUOUS: {"two spots touch": Advice("the spot is double", _CLEAN_THE_WINDOW)},
    Reason.SATURATED: {
        "whole frame": Advice(
            "the whole picture is overexposed",
            "keep daylight and lamps off the window or shorten the exposure",
        ),
    },
    Reason.WRONG_SHAPE: {
        "too little of it": Advice("too little is seen of the spot", "bring the beam nearer to the middle"),
    },
    Reason.DISTORTED: {
        "mm wide": Advice("the spot is too wide", "check the focus of the laser and clean the window"),
        "the spots differ": Advice(
            "the spots of the targets are unlike",
            "look for what stands in the beam, for reflections, and clean both targets",
        ),
        "light or view": Advice(
            "the spot's place is uncertain",
            "clean the window; if it stays, the camera has moved: calibrate again",
        ),
    },
    Reason.WRONG_CAMERA: {
        "the picture lies": Advice("the camera's view has moved", "fasten the camera and calibrate again"),
        "hot pixels": Advice("another camera than was calibrated", _RIGHT_CAMERA),
        "expected": Advice("another camera than was calibrated", _RIGHT_CAMERA),
        "print": Advice("the camera looks at another target", "swap the cameras' cables or calibrate again"),
        "surface": Advice(
            "the target looks otherwise than calibrated", "clean it; was it or the camera exchanged?"
        ),
    },
    Reason.OUT_OF_STEP: {
        "spot moves": Advice("one camera's pictures come late", "unplug the cameras and plug them in again"),
    },
    Reason.OUT_OF_RANGE: {
        "the unit measures up to": Advice("the beam is too oblique", "turn the unit towards the beam"),
    },
}
"""What the detail of a fault tells of its cause, by words of it; the tests have them from what makes them."""

_ONE_TARGET_DARK = Advice(
    "no laser spot", "the other target sees the laser: look for what covers this one or its camera"
)
_CAMERA_BELOW = Advice("the camera delivers nothing", "see the camera below")

_CAMERA_REMEDIES = {
    "not found": "is it plugged in, and has it power?",
    "busy": "end the program that has it",
    "lost": "check its cable and supply",
    "refused": "check its table in the config",
    "the driver does not return": "unplug it and plug it in again",
    "no frame for": "check its trigger, cable and supply",
    "exposure refused": "check its limits in the config",
}
"""By how the sentence begins that a camera's health says."""


def advice(fault: Fault, status: Iterable[Fault], components: Iterable[Component] = ()) -> Advice:
    """What is wrong and what to do, as far as the fault's detail, the others and the components tell."""
    if fault.detail.startswith(LEDS_LIT):
        return _LEDS
    for words, known in _SEEN.get(fault.reason, {}).items():
        if words in fault.detail:
            return known
    if fault.reason is Reason.SPOT_MISSING and {other.target for other in status} - {None} == {fault.target}:
        return _ONE_TARGET_DARK
    if fault.reason is Reason.CAMERA_SILENT and any(map(is_ill_camera, components)):
        return _CAMERA_BELOW
    return Advice(fault.reason.brief, fault.reason.remedy)


def is_ill_camera(component: Component) -> bool:
    """Whether it is a camera that does not deliver as it should."""
    return component.name.startswith("camera ") and component.state not in (State.OK, State.STARTING)


def component_steps(components: Iterable[Component], status: Iterable[Fault]) -> Iterable[str]:
    """What is wrong with components, and what to do.

    How ``measuring`` is, the status says in other words.
    """
    told = any(status)
    for component in components:
        ill = component.state in (State.FAILED, State.DEGRADED) or is_ill_camera(component)
        if not ill or (component.name == MEASURING and told):
            continue
        message = component.message
        remedy = next((does for words, does in _CAMERA_REMEDIES.items() if message.startswith(words)), "")
        yield f"{component.name} {component.state}: {message or 'no more is known'}" + (
            f": {remedy}" if remedy and is_ill_camera(component) else ""
        )
