"""Points of the machine against the beam, horizontally and vertically (docs/machine.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from altd.config import Installation, Machine
from altd.instruments.beam.solver import KEYS
from altd.records import FloatArray, Measurement, Quantity, Value
from altd.records.joint import Linear

BEAM_KEYS = ("x_mm", "y_mm", "yaw_mm_per_m", "pitch_mm_per_m")
"""Published numbers of a beam that the points depend on."""
_STEPS = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4])
"""Steps of central differences: x and y, mm; slopes, mm/m; roll and the three angles of the mounting, rad."""

_APART_S = 1.0
"""Maximum time between the beam of a measurement and its roll, s: a machine may roll meanwhile."""
_STEPS_OF_VERTICAL = 4
"""Steps of the fixed point for t, each 100 times as accurate as the one before at slopes of 0.1."""


def quantities_of_points(machine: Machine) -> tuple[Quantity, ...]:
    """Return two quantities for each point of the machine."""
    return tuple(
        Quantity(
            f"{point.name}_{axis}_mm",
            f"{point.name} {axis}",
            "mm",
            f"distance of the point {point.name} {meaning} of the beam, in the world of gravity",
            4,
            is_optional=True,
            point=point.name,
        )
        for point in machine.points
        for axis, meaning in (("right", "to the right"), ("up", "above the height"))
    )


class MachinePoints:
    """Distances of the machine's points from the beam of a finished measurement.

    Roll is that of the inclinometer, or without one that of the settings. A measurement without a beam, or
    whose roll is not known, has no points.
    """

    def __init__(self, machine: Machine, installation: Installation) -> None:
        self._machine, self._plane_mm = machine, installation.reference_plane_mm
        self._levers_mm = np.array([(of.x_mm, of.y_mm, of.z_mm) for of in machine.points])
        self._lever_variance = np.array([of.sigma_mm**2 for of in machine.points])
        self._signs = np.array([installation.signs[key] for key in KEYS], dtype=np.float64)
        self._offsets = np.array([getattr(installation, f"offset_{key}") for key in KEYS])
        angles_deg = machine.mount_yaw_deg, machine.mount_pitch_deg, machine.mount_roll_deg
        self._mount = [math.radians(angle) for angle in angles_deg]
        self._keys = [(f"{of.name}_right_mm", f"{of.name}_up_mm") for of in machine.points]

    def finish(self, measurement: Measurement) -> Measurement:
        """Return the measurement with the points; without those of an earlier roll."""
        own = {key for keys in self._keys for key in keys}
        values = {key: value for key, value in measurement.values.items() if key not in own}
        joint, roll = measurement.joint, self._roll(measurement)
        if not (values and self._keys and joint and roll and np.isfinite(joint.covariance).all()):
            return replace(measurement, values=values, linear={})
        numbers = [values[key].value for key in BEAM_KEYS]
        places, gradients = self._linear(numbers, roll[0])
        others = np.square(gradients[4:] * self._roll_and_mount(roll[1])[:, None, None]).sum(axis=0)
        others += self._lever_variance[:, None]
        linear = {
            key: Linear(gradients[:4, point, axis], float(others[point, axis]))
            for point, keys in enumerate(self._keys)
            for axis, key in enumerate(keys)
        }
        covariance, scatter = joint.at({}, None), joint.published(joint.scatter)
        for point, keys in enumerate(self._keys):
            for axis, key in enumerate(keys):
                of = linear[key]
                random = Linear(of.gradient, 0.0).sigma(scatter)
                values[key] = Value(float(places[point, axis]), of.sigma(covariance), random)
        return replace(measurement, values=values, linear=linear)

    def places(
        self, beam: Sequence[float], covariance: FloatArray, roll_deg: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the places (points, 3) to the right, up and along the beam, mm, with covariances, mm².

        ``beam`` are the published numbers of ``BEAM_KEYS`` with their ``covariance`` (4, 4), ``roll_deg`` is
        roll and its sigma. The way along the beam begins where the beam meets the front target.
        """
        places, gradients = self._linear(beam, roll_deg[0])
        whole = np.diag(np.concatenate([np.zeros(4), self._roll_and_mount(roll_deg[1])]) ** 2)
        whole[:4, :4] = covariance
        covariances: FloatArray = np.einsum("ipa,ij,jpb->pab", gradients, whole, gradients)
        return places, covariances + self._lever_variance[:, None, None] * np.eye(3)

    def _linear(self, beam: Sequence[float], roll_deg: float) -> tuple[FloatArray, FloatArray]:
        """Return the places (points, 3), mm, and their derivatives (8, points, 3) by ``_STEPS``."""
        at = np.array([*beam, math.radians(roll_deg), *self._mount])
        steps = np.diag(_STEPS)
        both = self._places_mm(np.concatenate([at + steps, at - steps, at[None]]))
        gradients = (both[: len(steps)] - both[len(steps) : -1]) / (2.0 * _STEPS[:, None, None])
        return both[-1], gradients

    def _roll_and_mount(self, roll_sigma_deg: float) -> FloatArray:
        """Return the sigmas of roll and of the three angles of the mounting, rad."""
        return np.radians([roll_sigma_deg, *[self._machine.mount_sigma_deg or 0.0] * 3])

    def _roll(self, measurement: Measurement) -> tuple[float, float] | None:
        """Return roll and its sigma, degrees; None: not known."""
        if (stated_deg := self._machine.roll_deg) is not None:
            return stated_deg, self._machine.roll_sigma_deg or 0.0
        said = measurement.from_sensors.get("roll_deg")
        if said is None or said.value is None or said.sigma is None:
            return None
        return said.value, math.hypot(said.sigma, said.rate * _APART_S)

    def _places_mm(self, at: FloatArray) -> FloatArray:
        """Return the places (k, points, 3) right, up and along, for k sets ``at`` (k, 8), see ``_STEPS``.

        In the unit frame the beam passes (x, y, plane) along d = (sx, sy, 1). The distance is r = o − (o·d)d
        with o from the beam to the point, d of length 1. Roll is the angle between y and the vertical u as
        seen along z, so u ~ (−sin roll, cos roll, t), with t from the beam's inclination. "To the right" is
        u × d, which is horizontal and perpendicular to the beam, "up" is d × (u × d). "Along" is counted from
        the plane z = 0.
        """
        xy = self._signs[:2] * (at[:, :2] - self._offsets[:2])
        angles = self._signs[2:] * (np.arctan(at[:, 2:4] / 1000.0) - np.radians(self._offsets[2:]))
        slopes = np.tan(angles)
        along = np.column_stack([slopes, np.ones(len(at))])
        length = np.linalg.norm(along, axis=1)
        along /= length[:, None]
        levers = self._in_unit_frame(at[:, 5:])
        beside = np.zeros_like(levers)
        beside[..., :2] = levers[..., :2] - xy[:, None] - slopes[:, None] * (levers[..., 2:] - self._plane_mm)
        ahead = beside @ along[:, :, None]
        beside -= ahead * along[:, None]
        ahead = ahead[..., 0] + levers[..., 2] * length[:, None]
        up = np.column_stack([-np.sin(at[:, 4]), np.cos(at[:, 4]), np.zeros(len(at))])
        incline = math.atan(self._machine.beam_inclination_mm_per_m / 1000.0)
        for _ in range(_STEPS_OF_VERTICAL):  # u · d = |u| sin(inclination)
            up[:, 2] = length * math.sin(incline) * np.hypot(1.0, up[:, 2]) - (up[:, :2] * slopes).sum(axis=1)
        right = np.cross(up, along)
        right /= np.linalg.norm(right, axis=1)[:, None]
        across = beside @ np.stack([right, np.cross(along, right)], axis=2)
        places: FloatArray = np.concatenate([across, ahead[..., None]], axis=2)
        return places

    def _in_unit_frame(self, mount: FloatArray) -> FloatArray:
        """Return the levers (k, points, 3) in the unit frame, for k mountings (k, 3): yaw, pitch, roll, rad.

        The mounting turns the unit's axes from the machine's: about its own axis clockwise, then up, then to
        the right.
        """
        (yaw, pitch, roll), still, full = mount.T, np.zeros(len(mount)), np.ones(len(mount))
        to_right = [
            [np.cos(yaw), still, np.sin(yaw)],
            [still, full, still],
            [-np.sin(yaw), still, np.cos(yaw)],
        ]
        up = [
            [full, still, still],
            [still, np.cos(pitch), np.sin(pitch)],
            [still, -np.sin(pitch), np.cos(pitch)],
        ]
        about = [
            [np.cos(roll), np.sin(roll), still],
            [-np.sin(roll), np.cos(roll), still],
            [still, still, full],
        ]
        one, two, three = (np.moveaxis(np.array(each), 2, 0) for each in (to_right, up, about))
        levers: FloatArray = self._levers_mm @ (one @ two @ three)
        return levers
