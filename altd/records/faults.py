"""A reason with the target that it concerns, and the cause as far as it is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from altd.reasons import Reason
from altd.records.frames import Origin

_CLEAN_THE_WINDOW = "clean the window, look for reflections and for objects in the beam"


class FaultCause(Enum):
    """Cause of a fault that is known more exactly than its reason: its meaning and its remedy."""

    LEDS_LIT = (
        "the frame LEDs are lit",
        "end `altd lamps on`, check the wiring: frame LEDs must be dark during a measurement",
    )
    TOO_DIM = "the spot is too dim", "clean the window, give the laser more power or expose longer"
    DOUBLE = "the spot is double", _CLEAN_THE_WINDOW
    FLOODED = (
        "the whole picture is overexposed",
        "keep daylight and lamps off the window or shorten the exposure",
    )
    TOO_WIDE = "the spot is too wide", "check the focus of the laser and clean the window"
    OTHER_PROFILE = (
        "the beam has another profile than the calibrated one",
        "check the laser and its focus, look for lamps, or calibrate with this laser",
    )
    SEEN_IN_PART = "too little is seen of the spot", "bring the beam nearer to the middle"
    UNLIKE_SPOTS = (
        "the spots on the targets differ",
        "look for objects in the beam, for reflections, and clean both targets",
    )
    UNCERTAIN_PLACE = (
        "the spot's place is uncertain",
        "clean the window; if this continues, the camera has moved: calibrate again",
    )
    VIEW_MOVED = "the camera's view has moved", "fasten the camera and calibrate again"
    OTHER_CAMERA = (
        "another camera than was calibrated",
        "swap the cameras' cables or put the old camera back",
    )
    SWAPPED = "the cameras are swapped", "swap the cameras' cables"
    OTHER_TARGET = "the camera looks at another target", "swap the cameras' cables or calibrate again"
    OTHER_SURFACE = (
        "the target does not look as calibrated",
        "clean the target; if it or the camera was exchanged, calibrate again",
    )
    LATE_PICTURES = "one camera's pictures come late", "unplug the cameras and plug them in again"
    BUSY_COMPUTER = (
        "the computer is busy",
        "end other programs on the unit's computer; if this continues, check the camera's cable and trigger",
    )
    TOO_OBLIQUE = "the beam is too oblique", "turn the unit towards the beam"

    @property
    def meaning(self) -> str:
        """The cause in a few words."""
        return self.value[0]

    @property
    def remedy(self) -> str:
        """The technician's action."""
        return self.value[1]


@dataclass(frozen=True, slots=True)
class Fault:
    """One reason with the target it concerns (None: the whole unit) and a sentence for people.

    ``cause`` replaces the reason's meaning and remedy; None: only these are known.
    """

    reason: Reason
    target: str | None = None
    detail: str = ""
    cause: FaultCause | None = None

    def __str__(self) -> str:
        """Return the published code, such as ``front_spot_missing``."""
        return f"{self.target}_{self.reason}" if self.target else str(self.reason)


def origin_faults(origins: Mapping[str, Origin], played: Iterable[str] = ()) -> tuple[Fault, ...]:
    """Return the warnings of each measurement from these cameras' frames; ``played`` play a recording."""
    simulated = (name for name, origin in origins.items() if origin is Origin.SIMULATED)
    by_reason = {Reason.PLAYBACK: sorted(played), Reason.SIMULATED: sorted(simulated)}
    return tuple(Fault(reason, detail=", ".join(names)) for reason, names in by_reason.items() if names)
