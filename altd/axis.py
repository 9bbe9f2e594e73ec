"""Points beside a surveyed beam in the project's coordinates, and against a designed axis (docs/machine.md).

East, north and height are in m, azimuths clockwise from north as seen from above, chainages horizontal. The
project's plane is taken as flat and true to scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from altd.config.wording import UNUSABLE, WHY
from altd.files.table import FAULTS, Table, complaint, shown
from altd.records import FloatArray

_MAX_TURN_RAD = 0.25
"""Maximum turn of a piece of the axis; ten nodes of Gauss integrate its cosine to 1e-15 of its length."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_SAME_PLACE_M = 1e-6
_STEP_M, _MAX_STEPS = 1e-10, 60
"""Last step of Newton's method, and the maximum number of steps."""
_END_TOLERANCE_M = 0.01
"""Maximum distance of the axis' computed end from the stated one: designs are printed in mm."""
_MAX_GRADIENT, _MIN_APART_M = 0.5, 0.001
_RADII_OF_OFFSET = 2.0
"""Minimum radius as a multiple of the largest offset: further inside a curve a foot is not unique."""


def _utc(text: object) -> datetime:
    """Return the time of an ISO 8601 text with its offset from UTC."""
    try:
        time = datetime.fromisoformat(text) if isinstance(text, str) else None
        if time is not None and time.tzinfo is not None:
            return time.astimezone(UTC)
    except (ValueError, OverflowError):  # the latter for the first and the last day
        pass
    raise complaint(((), f"{shown(text)} is not a time such as 2026-11-20T08:15:22Z"))


Utc = Annotated[datetime, BeforeValidator(_utc)]
Metres = Annotated[float, Field(ge=-1e8, le=1e8)]
_Radius = Annotated[float, Field(ge=-100_000, le=100_000)]
_Azimuth = Annotated[float, Field(ge=0, lt=360)]
_SigmaMm = Annotated[float, Field(gt=0, le=1000)]
Distance = Annotated[float, Field(gt=0, le=2000)]


class Strict(Table):
    """Table of a JSON document: no text is taken for a number."""

    model_config = ConfigDict(strict=True)


def fault_of(error: ValidationError) -> str:
    """Return the first fault of a document, with its place."""
    first = error.errors(include_url=False)[0]
    keys, kind, value = list(first["loc"]), first["type"], first["input"]
    said = f"{shown(value)} {WHY.get(kind, UNUSABLE)}"
    if kind == FAULTS:
        more, said = first["ctx"]["faults"][0]
        keys += more
    elif kind in ("missing", "extra_forbidden"):
        said = "this key is missing" if kind == "missing" else "there is no such key"
    place = ".".join(map(str, keys))
    return f"{place}: {said}" if place else said


class Element(Strict):
    """An element of the axis: its curvature changes evenly between two radii, positive to the right.

    null: no curvature. A straight line has null twice, an arc one radius twice, any other is a clothoid.
    """

    length_m: Annotated[float, Field(ge=0.001, le=100_000)]
    start_radius_m: _Radius | None
    end_radius_m: _Radius | None

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvature at both ends, 1/m."""
        start, end = (1.0 / each if each else 0.0 for each in (self.start_radius_m, self.end_radius_m))
        return start, end


class _Place(Strict):
    east_m: Metres
    north_m: Metres


class _Start(_Place):
    chainage_m: Metres
    azimuth_deg: _Azimuth


class _Intersection(Strict):
    """Intersection of two gradients; the vertical curve there is a parabola of this length, or none."""

    chainage_m: Metres
    height_m: Metres
    curve_length_m: Annotated[float, Field(ge=0, le=100_000)] = 0.0


class AxisDocument(Strict):
    """The designed axis. ``end`` repeats what follows, so that no unit or sign is mistaken."""

    format: Literal["altd-axis/1"]
    name: Annotated[str, Field(min_length=1, max_length=200)]
    max_offset_m: Annotated[float, Field(ge=0.1, le=100)]
    start: _Start
    horizontal: Annotated[list[Element], Field(min_length=1, max_length=1000)]
    end: _Place
    vertical: Annotated[list[_Intersection], Field(min_length=2, max_length=1000)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        for number, element in enumerate(self.horizontal):
            radii = {"start_radius_m": element.start_radius_m, "end_radius_m": element.end_radius_m}
            for key, radius_m in radii.items():
                if radius_m is not None and abs(radius_m) < _RADII_OF_OFFSET * self.max_offset_m:
                    said = f"{radius_m:g} is below {_RADII_OF_OFFSET:g} times max_offset_m: no unique foot"
                    raise complaint((("horizontal", number, key), said))
        self._check_vertical()
        east_m, north_m = (float(each) for each in self.axis.nodes[-1])
        if math.hypot(east_m - self.end.east_m, north_m - self.end.north_m) > _END_TOLERANCE_M:
            said = f"the elements end at {east_m:.3f}, {north_m:.3f}; check units, signs and azimuth"
            raise complaint((("end",), said))
        start_m, end_m = self.start.chainage_m, self.axis.end_m
        if self.vertical[0].chainage_m > start_m or self.vertical[-1].chainage_m < end_m - _END_TOLERANCE_M:
            raise complaint((("vertical",), f"does not reach from {start_m:.3f} to {end_m:.3f}, as the axis"))
        return self

    def _check_vertical(self) -> None:
        for number, (one, two) in enumerate(pairwise(self.vertical), start=1):
            apart_m = two.chainage_m - one.chainage_m
            if apart_m < _MIN_APART_M or abs(two.height_m - one.height_m) > _MAX_GRADIENT * apart_m:
                said = f"is behind or steeper than {1000 * _MAX_GRADIENT:g} mm/m"
                raise complaint((("vertical", number), said))
            if one.curve_length_m + two.curve_length_m > 2 * apart_m:
                raise complaint((("vertical", number), "its curve overlaps the one before"))
        if self.vertical[0].curve_length_m or self.vertical[-1].curve_length_m:
            raise complaint((("vertical",), "the first and the last have no curve"))

    @cached_property
    def axis(self) -> Axis:
        """The axis in numbers."""
        return Axis(self)


@dataclass(frozen=True, slots=True)
class Foot:
    """A point against the axis: where its foot is, and its distances to the right and above.

    ``normal`` (3, 3) has the derivatives of chainage, right and up by east, north and height.
    """

    chainage_m: float
    right_m: float
    up_m: float
    normal: FloatArray


class Axis:
    """The axis in pieces whose curvature changes evenly, with their ends ``nodes`` (n + 1, 2), m."""

    def __init__(self, of: AxisDocument) -> None:
        self._max_offset_m, pieces = of.max_offset_m, list[tuple[float, float, float]]()
        for element in of.horizontal:
            sharpest = max(map(abs, element.curvatures))
            count = math.ceil(element.length_m * sharpest / _MAX_TURN_RAD) or 1
            ends = np.linspace(*element.curvatures, count + 1).tolist()
            pieces += [(element.length_m / count, *two) for two in pairwise(ends)]
        self._lengths, first, last = np.array(pieces).T
        self._bends, self._rates = first, (last - first) / self._lengths
        turns = self._lengths * (first + last) / 2
        self._azimuths = np.concatenate([[0.0], turns.cumsum()]) + math.radians(of.start.azimuth_deg)
        self._chainages = np.concatenate([[0.0], self._lengths.cumsum()]) + of.start.chainage_m
        self.nodes = np.array([[of.start.east_m, of.start.north_m]])
        ways = [self._way(piece, length) for piece, length in enumerate(self._lengths)]
        self.nodes = self.nodes + np.concatenate([np.zeros((1, 2)), np.cumsum(ways, axis=0)])
        self._along = np.column_stack([np.sin(self._azimuths), np.cos(self._azimuths)])
        self.end_m = float(self._chainages[-1])
        self._vertical = of.vertical
        heights = np.array([(each.chainage_m, each.height_m) for each in of.vertical])
        rises = np.diff(heights[:, 1]) / np.diff(heights[:, 0])
        self._gradients: list[float] = [float(each) for each in (rises[0], *rises, rises[-1])]
        """Before and behind each of ``_vertical``."""

    def _azimuth(self, piece: int, way_m: Any) -> Any:
        return self._azimuths[piece] + way_m * (self._bends[piece] + self._rates[piece] * way_m / 2)

    def _way(self, piece: int, way_m: float) -> FloatArray:
        """Return the vector (2,) from the start of a piece to a place on it, by Gauss-Legendre."""
        azimuths = self._azimuth(piece, way_m * (_NODES + 1) / 2)
        vector: FloatArray = np.array([_WEIGHTS @ np.sin(azimuths), _WEIGHTS @ np.cos(azimuths)])
        return vector * way_m / 2

    def feet(self, point: FloatArray) -> list[Foot]:
        """Return the places of a point (3,) against the axis: one, none, or several if the axis returns.

        Beyond both ends, and further away than ``max_offset_m``, there is none.
        """
        ahead = ((point[:2] - self.nodes) * self._along).sum(axis=1)
        found: list[Foot] = []
        for piece in np.nonzero((ahead[:-1] >= -_STEP_M) & (ahead[1:] <= _STEP_M))[0].tolist():
            foot = self._foot(piece, point)
            known = any(abs(foot.chainage_m - each.chainage_m) < _SAME_PLACE_M for each in found)
            if max(abs(foot.right_m), abs(foot.up_m)) <= self._max_offset_m and not known:
                found.append(foot)
        return found

    def _foot(self, piece: int, point: FloatArray) -> Foot:
        """Return the foot on a piece before whose start the point is not, nor behind its end.

        Newton's method for the place where the point is neither ahead nor behind, bisection where it leaves
        the interval.
        """
        low, high = 0.0, float(self._lengths[piece])
        way = min(max(float((point[:2] - self.nodes[piece]) @ self._along[piece]), low), high)
        for _ in range(_MAX_STEPS):
            from_foot = point[:2] - self.nodes[piece] - self._way(piece, way)
            azimuth = float(self._azimuth(piece, way))
            along = np.array([math.sin(azimuth), math.cos(azimuth)])
            right = np.array([along[1], -along[0]])
            offset_m = float(from_foot @ right)
            closer = 1.0 - float(self._bends[piece] + self._rates[piece] * way) * offset_m
            ahead = float(from_foot @ along)
            low, high = (way, high) if ahead > 0 else (low, way)
            step = ahead / closer if closer > 0 else math.inf
            if abs(step) < _STEP_M:
                break
            way = way + step if low <= way + step <= high else (low + high) / 2
        chainage_m = float(self._chainages[piece]) + way
        height_m, gradient = self.height(chainage_m)
        if closer != 0.0:  # else at an arc's centre, which is further away than ``max_offset_m``
            along = along / closer
        normal = np.array([[*along, 0.0], [*right, 0.0], [*(-gradient * along), 1.0]])
        return Foot(chainage_m, offset_m, float(point[2]) - height_m, normal)

    def height(self, chainage_m: float) -> tuple[float, float]:
        """Return the height, m, and the gradient (1 = 45°) at a chainage."""
        places, gradients = self._vertical, self._gradients
        number = sum(each.chainage_m <= chainage_m for each in places[1:-1])
        for at in (number, number + 1):
            length_m = places[at].curve_length_m
            way_m = chainage_m - places[at].chainage_m + length_m / 2
            if 0 < way_m < length_m:
                bend = (gradients[at + 1] - gradients[at]) / length_m
                tangent_m = places[at].height_m + gradients[at] * (chainage_m - places[at].chainage_m)
                return tangent_m + bend * way_m**2 / 2, gradients[at] + bend * way_m
        gradient = gradients[number + 1]
        return places[number].height_m + gradient * (chainage_m - places[number].chainage_m), gradient


class BeamLine(Strict):
    """A surveyed beam: a point on it, its direction, and the distance from that point to the front target.

    The distance is along the beam to where it meets the front target, with the machine at rest until
    ``distance_until``; without both each measurement needs its own.
    """

    format: Literal["altd-beam/1"]
    serial: Annotated[str, Field(min_length=1, max_length=64)]
    time: Utc
    by: Annotated[str, Field(min_length=1, max_length=200)]
    east_m: Metres
    north_m: Metres
    height_m: Metres
    sigma_east_mm: _SigmaMm
    sigma_north_mm: _SigmaMm
    sigma_height_mm: _SigmaMm
    azimuth_deg: _Azimuth
    sigma_azimuth_deg: Annotated[float, Field(gt=0, le=1)]
    inclination_mm_per_m: Annotated[float, Field(ge=-500, le=500)]
    sigma_inclination_mm_per_m: Annotated[float, Field(gt=0, le=10)]
    sigma_distance_mm: _SigmaMm
    distance_m: Distance | None = None
    distance_until: Utc | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.distance_m is None) != (self.distance_until is None):
            raise complaint((("distance_m",), "needs distance_until, the time until the machine is at rest"))
        return self

    def place(
        self, distance_m: float, offset_mm: Sequence[float] | FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return a point (3,) in m, and its covariance (3, 3) in mm²: east, north and height.

        ``offset_mm`` and its ``covariance`` are to the right, up and along the beam from the front target.
        Errors of the start's coordinates, the azimuth, the inclination, the distance and the offset are
        taken as independent of each other.
        """
        azimuth, slope = math.radians(self.azimuth_deg), self.inclination_mm_per_m / 1000.0
        incline = math.atan(slope)
        level, ahead = (
            np.array([math.cos(azimuth), -math.sin(azimuth), 0.0]),
            np.array([math.sin(azimuth), math.cos(azimuth), 0.0]),
        )
        along = math.cos(incline) * ahead + math.sin(incline) * np.array([0.0, 0.0, 1.0])
        axes = np.column_stack([level, np.cross(level, along), along])
        offset = np.array(offset_mm) + np.array([0.0, 0.0, 1000.0 * distance_m])
        from_start = axes @ offset
        by_azimuth = np.array([from_start[1], -from_start[0], 0.0])
        by_incline = axes[:, 1] * offset[2] - axes[:, 2] * offset[1]
        sigmas = self.sigma_east_mm, self.sigma_north_mm, self.sigma_height_mm
        total = np.diag(np.square(sigmas)) + axes @ covariance @ axes.T
        for by, sigma in (
            (by_azimuth, math.radians(self.sigma_azimuth_deg)),
            (by_incline, self.sigma_inclination_mm_per_m / 1000.0 / (1.0 + slope**2)),
            (along, self.sigma_distance_mm),
        ):
            total += np.outer(by, by) * sigma**2
        start = np.array([self.east_m, self.north_m, self.height_m])
        return start + from_start / 1000.0, total
