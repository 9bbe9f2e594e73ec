"""Where an interface gets the newest picture of each target, for people to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

Points = tuple[tuple[float, float], ...]
"""u, v in px of the frame."""


class NoPictureError(Exception):
    """There is no picture; the sentence says why."""


@dataclass(frozen=True, slots=True)
class TargetView:
    """What does not change in a target's pictures: the frame's size, px, and what its calibration knows.

    ``outline`` bounds the area in which a spot is measured, ``leds`` are the frame LEDs' references.
    ``middle`` is the place x = y = 0 of the unit frame, ``x_axis`` and ``y_axis`` how far one millimetre
    along x and y goes there, u and v in px.
    """

    target: str
    camera: str
    width: int
    height: int
    outline: Points
    leds: Points
    middle: tuple[float, float]
    x_axis: tuple[float, float]
    y_axis: tuple[float, float]

    def as_object(self) -> dict[str, object]:
        """As plain JSON types."""
        return {
            "target": self.target,
            "width": self.width,
            "height": self.height,
            "outline": [list(point) for point in self.outline],
            "leds": [list(point) for point in self.leds],
            "middle": list(self.middle),
            "x_axis": list(self.x_axis),
            "y_axis": list(self.y_axis),
        }


@dataclass(frozen=True, slots=True)
class SpotContour:
    """A spot's 1/e² contour: an ellipse about (u_px, v_px), its major axis turned from u to v."""

    u_px: float
    v_px: float
    semi_major_px: float
    semi_minor_px: float
    turn_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One frame as JPEG, with what was found in this very frame. ``t_ns`` is the middle of its exposure.

    ``width`` and ``height`` are the JPEG's own, px; ``spot`` is None where none was found, ``why`` says why
    not; ``number`` grows from picture to picture of a camera.
    """

    target: str
    number: int
    sequence: int
    t_ns: int
    width: int
    height: int
    spot: SpotContour | None
    why: str
    leds_on: bool
    jpeg: bytes


class PictureMaker(Protocol):
    """Who makes pictures."""

    @property
    def views(self) -> Sequence[TargetView]:
        """The targets, in beam order."""

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        """The newest picture of each target that is newer than the number that was ``seen`` of it.

        Waits until there is one. Raises NoPictureError when it cannot be made.
        """


class PictureDesk:
    """``unavailable`` says why there are no pictures; empty once there is somebody who makes them."""

    def __init__(self) -> None:
        self.unavailable = "this unit shows no pictures"
        self._maker: PictureMaker | None = None

    def open(self, maker: PictureMaker) -> None:
        """From now on there are pictures."""
        self.unavailable, self._maker = "", maker

    @property
    def maker(self) -> PictureMaker:
        """Who makes them; raises NoPictureError when there is nobody."""
        if self._maker is None:
            raise NoPictureError(self.unavailable)
        return self._maker
