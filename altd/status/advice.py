"""Meaning and remedy of a reason, by the detail of its fault."""

from __future__ import annotations

from typing import NamedTuple

from altd.reasons import LEDS_LIT, Reason


class Advice(NamedTuple):
    """Meaning of a fault and its remedy."""

    means: str
    remedy: str


_CLEAN_THE_WINDOW = "clean the window, look for reflections and for objects in the beam"
_RIGHT_CAMERA = "swap the cameras' cables or put the old camera back"

_LEDS = Advice(
    LEDS_LIT,
    "check `altd lamps on` and the wiring: frame LEDs are dark during a measurement",
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
    Reason.WRONG_SIZE: {
        "mm wide": Advice("the spot is too wide", "check the focus of the laser and clean the window"),
    },
    Reason.WRONG_SHAPE: {
        "profile": Advice(
            "the beam has another profile than the calibrated one",
            "check the laser and its focus, look for lamps, or calibrate with this laser",
        ),
        "too little of it": Advice("too little is seen of the spot", "bring the beam nearer to the middle"),
    },
    Reason.DISTORTED: {
        "the spots differ": Advice(
            "the spots of the targets are unlike",
            "look for objects in the beam, for reflections, and clean both targets",
        ),
        "light and view": Advice(
            "the spot's place is uncertain",
            "clean the window; if it stays, the camera has moved: calibrate again",
        ),
    },
    Reason.WRONG_CAMERA: {
        "the picture lies": Advice("the camera's view has moved", "fasten the camera and calibrate again"),
        "hot pixels": Advice("another camera than was calibrated", _RIGHT_CAMERA),
        "swapped": Advice("the cameras are swapped", "swap the cameras' cables"),
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
"""Words in a fault's detail that identify its cause; the tests compare them with the code that writes
them."""


def advice_of(reason: Reason, detail: str) -> Advice | None:
    """Return meaning and remedy as far as a fault's detail determines them; None: only the reason's own."""
    if detail.startswith(LEDS_LIT):
        return _LEDS
    return next((known for words, known in _SEEN.get(reason, {}).items() if words in detail), None)
