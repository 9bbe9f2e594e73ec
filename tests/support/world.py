"""A unit and a beam in a world of vectors east, north and up: the truth of points of the machine.

It shares nothing with altd: an orthogonal frame of unit vectors, and where a straight line meets a plane.
"""

from __future__ import annotations

import math

import numpy as np

from altd.records import FloatArray

VERTICAL = np.array([0.0, 0.0, 1.0])


def direction(heading: float, grade: float) -> FloatArray:
    """The unit vector of a heading from north to the east and a grade, rad."""
    return np.array(
        [math.sin(heading) * math.cos(grade), math.cos(heading) * math.cos(grade), math.sin(grade)]
    )


class World:
    """A unit with a heading, a grade and a roll, and a beam with a heading and a grade, all in degrees."""

    def __init__(self, unit_deg: tuple[float, float, float], beam_deg: tuple[float, float]) -> None:
        heading, grade, roll = np.radians(unit_deg)
        self.z = direction(heading, grade)
        level = np.cross(self.z, VERTICAL)
        level /= np.linalg.norm(level)
        upright = np.cross(level, self.z)
        self.x = math.cos(roll) * level - math.sin(roll) * upright
        self.y = math.sin(roll) * level + math.cos(roll) * upright
        self.along = direction(*np.radians(beam_deg))
        self.origin = np.array([12_000.0, 85_000.0, -3_000.0])
        self.passes = self.origin + 23.0 * self.x - 14.0 * self.y

    @classmethod
    def of(cls, beam: FloatArray, roll_deg: float, inclination_mm_per_m: float) -> World:
        """The world in which a unit with this roll sees a beam at x, y (mm), yaw, pitch (mm/m)."""
        slopes = np.append(np.asarray(beam[2:]) / 1000.0, 1.0)
        wanted = math.sin(math.atan(inclination_mm_per_m / 1000.0)) * np.linalg.norm(slopes)
        low, high = -60.0, 60.0
        for _ in range(80):  # the steeper the unit, the steeper the beam
            world = cls((0.0, middle := (low + high) / 2, roll_deg), (0.0, 0.0))
            along = slopes @ np.array([world.x, world.y, world.z])
            low, high = (middle, high) if along @ VERTICAL < wanted else (low, middle)
        world.along = along / np.linalg.norm(along)
        world.passes = world.origin + beam[0] * world.x + beam[1] * world.y
        return world

    @property
    def roll_deg(self) -> float:
        """Angle in the unit's xy-plane between y and the vertical: what an inclinometer on its axis shows."""
        return math.degrees(math.atan2(-self.x @ VERTICAL, self.y @ VERTICAL))

    def seen(self, plane_mm: float = 0.0) -> tuple[float, float, float, float]:
        """The beam in the unit: x and y in the plane z = plane, yaw and pitch."""
        along = np.array([self.along @ axis for axis in (self.x, self.y, self.z)])
        at = np.array([(self.passes - self.origin) @ axis for axis in (self.x, self.y, self.z)])
        at += along * (plane_mm - at[2]) / along[2]
        return (at[0], at[1], *np.degrees(np.arctan(along[:2] / along[2])))

    def distances(self, levers_mm: FloatArray) -> FloatArray:
        """Horizontal and vertical distances (n, 2) of the points from the beam, perpendicular to it."""
        points = self.origin + levers_mm @ np.array([self.x, self.y, self.z])
        from_beam = points - self.passes
        from_beam = from_beam - np.outer(from_beam @ self.along, self.along)
        right = np.cross(self.along, VERTICAL)
        right /= np.linalg.norm(right)
        return np.stack([from_beam @ right, from_beam @ np.cross(right, self.along)], axis=1)
