"""Faults of a unit, by name."""

from collections.abc import Iterable
from enum import StrEnum

from altd.errors import BadInputError
from hw_sim.displacement import Displacement
from hw_sim.frame_leds import Shines, Stray


class Fault(StrEnum):
    """A named fault. Several may be present at once."""

    NO_LASER = "no_laser"
    """The beam is off or blocked; ambient light and hot pixels stay."""
    FRONT_SPOT_MISSING = "front_spot_missing"
    REAR_SPOT_MISSING = "rear_spot_missing"
    FRONT_SECOND_SPOT = "front_second_spot"
    """A second spot of the same size and brightness, SECOND_SPOT_MM to the side."""
    REAR_SECOND_SPOT = "rear_second_spot"
    SATURATED = "saturated"
    """The laser is OVERLOAD times too strong: the spot is flat at full scale to its edge."""
    BLACK = "black"
    """Every pixel reads 0."""
    WHITE = "white"
    """Every pixel reads full scale."""
    NOISE_ONLY = "noise_only"
    """Grey values around a quarter of full scale, unrelated to light."""
    CUT_BY_EDGE = "cut_by_edge"
    """The beam meets the edge of the front camera's picture, normal to the targets."""
    OUT_OF_AREA = "out_of_area"
    """The beam is at OUT_OF_AREA_MM, in the picture but outside the area that a scan calibrates."""
    OUT_OF_STEP = "out_of_step"
    """The rear camera exposes half a period late, with matching timestamps."""
    FRONT_SILENT = "front_silent"
    REAR_SILENT = "rear_silent"
    DROPPED_FRAMES = "dropped_frames"
    """Each camera loses one frame in five, independently."""
    LEDS_ON = "leds_on"
    """The frame LEDs are lit although they are switched off."""
    LEDS_DARK = "leds_dark"
    """The frame LEDs are dark although they are switched on."""
    FRONT_BLINKING_LIGHT = "front_blinking_light"
    """A light as bright as a frame LED, between two of them, blinks independently of them."""
    PUSHED_ASIDE = "pushed_aside"
    """A blow has moved the whole unit: the beam meets all targets PUSHED_ASIDE_MM farther along x."""
    REAR_CAMERA_MOVED = "rear_camera_moved"
    """The rear camera has moved relative to its target: its picture has moved by CAMERA_MOVED."""


SECOND_SPOT_MM = 40.0
OVERLOAD_RATIO = 100.0
OUT_OF_AREA_MM = (90.0, 0.0)
DROPPED_SHARE = 0.2
BLINKING_LIGHT = Stray(-40.0, 30.0, shines=Shines.BY_ITSELF)
PUSHED_ASIDE_MM = 5.0
CAMERA_MOVED = Displacement((0.6, -0.2), turn_deg=0.1)
ALL_PIXELS = frozenset({Fault.BLACK, Fault.WHITE, Fault.NOISE_ONLY})
"""Faults that replace the whole picture."""


def parse_faults(names: Iterable[str]) -> frozenset[Fault]:
    """Faults with these names; raises BadInputError that lists the known names."""
    faults = set()
    for name in names:
        if name not in set(Fault):
            raise BadInputError("--faults", f"unknown fault {name!r}; known are {', '.join(Fault)}")
        faults.add(Fault(name))
    return frozenset(faults)
