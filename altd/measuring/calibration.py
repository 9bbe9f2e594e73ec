"""Calibration data of one unit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property

import numpy as np

from altd.mapping.grid import moved_outwards
from altd.mapping.inverse import InverseMap
from altd.mapping.tensor_map import TensorMap
from altd.measuring.cross_check import CrossCheck
from altd.records import CameraIdentity, FloatArray, Glass, Limits, Origin, TargetPoint
from altd.records.limits import NO_LIMITS
from altd.records.spots import CrossCheckedSpot
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.settings import UNKNOWN_SPOT, SpotReference, SpotSettings


@dataclass(frozen=True)
class TargetCalibration:
    """One target: settings of its localiser, its map, quality of the fit, and the map that checks it.

    ``flat`` is the target's response to even light, None for a target treated as plain. ``leave_one_out_px``
    is the rms of the map's leave-one-out residuals; ``residual_mean_mm``, ``residual_std_mm`` and
    ``residual_max_mm`` describe the nodes' distances from the map; ``repeatability_px`` (2,) is the scatter
    of single frames at one node in u and v; ``leds_px`` (n, 2) are the frame LEDs' reference positions;
    ``spot`` holds the figures of its laser spots. ``camera`` is the calibrated camera, ``fingerprint`` the
    fixed pattern of its images; None: not known. ``origin`` is the origin of the calibration's frames, except
    those of a recorded flat: see ``simulated``. ``glass`` is the glass that the beam passes behind the
    printed surface.
    """

    name: str
    z_mm: float
    width: int
    height: int
    localiser: SpotSettings
    flat: Flat | None
    map: TensorMap
    cross_check: CrossCheck
    leave_one_out_px: float
    residual_mean_mm: float
    residual_std_mm: float
    residual_max_mm: float
    repeatability_px: FloatArray
    leds_px: FloatArray
    spot: SpotReference = UNKNOWN_SPOT
    camera: CameraIdentity = field(default_factory=CameraIdentity)
    fingerprint: Fingerprint | None = None
    origin: Origin = Origin.CAMERA
    glass: Glass | None = None

    @property
    def simulated(self) -> bool:
        """Whether any frame used for this calibration was simulated."""
        frames = self.origin, self.origin if self.flat is None else self.flat.origin
        return Origin.SIMULATED in frames

    @cached_property
    def inverse(self) -> InverseMap:
        """Map from px to mm."""
        return InverseMap(self.map)

    @cached_property
    def px_per_mm(self) -> float:
        """Scale of the picture in the middle of the area: the root of the pixels per mm²."""
        jacobian = self.map.jacobian(self.map.hull_mm.mean(axis=0, keepdims=True))[0]
        return math.sqrt(abs(float(np.linalg.det(jacobian))))

    @property
    def valid_mm(self) -> FloatArray:
        """Corners (n, 2) of the area in which spots are valid, to 0.01 mm: the nodes' hull and its margin.

        ``InverseMap.outside_mm`` is at most the margin there.
        """
        corners: FloatArray = np.round(moved_outwards(self.map.hull_mm, self.map.margin_mm), 2)
        return corners

    def point(self, u_px: float, v_px: float) -> TargetPoint | None:
        """Return the intersection of the beam with the target; None outside the calibrated area."""
        point, jacobian, covariance = self.inverse.to_mm(np.array([[u_px, v_px]]))
        if not np.isfinite(point).all():
            return None
        if self.flat is not None and self.flat.learnt is not None:
            unknown_px = self.flat.learnt.unknown_px(u_px, v_px)
            covariance = covariance + unknown_px**2 * jacobian @ jacobian.swapaxes(1, 2)
        return TargetPoint(float(point[0, 0]), float(point[0, 1]), jacobian[0], covariance[0])

    def cross_checked(self, point: TargetPoint, u_px: float, v_px: float) -> CrossCheckedSpot | str:
        """Return the spot (u, v) of ``point`` with its place by the second map; text if it is implausible.

        The place is one Newton step from ``point``: over 12 simulated lenses (f = 3.6 to 12 mm) it is
        within 0.0002 mm of the second map's inverse.
        """
        du_px, dv_px = self.cross_check.difference_px(point.x_mm, point.y_mm, u_px, v_px)
        difference_px = math.hypot(du_px, dv_px)
        outside_mm = self.inverse.outside_mm(point.x_mm, point.y_mm)
        limit_px = self.cross_check.limit_at_px(self.map, outside_mm)
        if difference_px <= limit_px:
            (xu, xv), (yu, yv) = point.jacobian_mm_per_px.tolist()
            x_mm, y_mm = point.x_mm + xu * du_px + xv * dv_px, point.y_mm + yu * du_px + yv * dv_px
            return CrossCheckedSpot(u_px, v_px, x_mm, y_mm)
        models = f"the {self.map.model} and the {self.cross_check.map.model} map"
        return (
            f"{models} are {difference_px:.2f} px apart at "
            f"x {point.x_mm:.1f} y {point.y_mm:.1f} mm, the bound is {limit_px:.2f} px"
        )


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """File that a calibration was read from: SHA-256 of its bytes, and the checksum stored in it."""

    sha256: str
    checksum: str


@dataclass(frozen=True)
class Calibration:
    """Targets of one unit in beam order, and the origin of the data.

    ``limits`` are the uncertainties that its recordings do not show. ``temperature_c`` is the temperature of
    the frame in its scans; None: not known. ``file`` is None if the calibration was computed and not read
    from a file.
    """

    unit_serial: str
    created: datetime
    recording_note: str
    recording_sha256: str
    targets: tuple[TargetCalibration, ...]
    limits: Limits = NO_LIMITS
    temperature_c: float | None = None
    file: CalibrationFile | None = None

    @property
    def simulated(self) -> bool:
        """Whether any frame used for this calibration was simulated."""
        return any(target.simulated for target in self.targets)

    def other_place_of(self, camera: CameraIdentity, target: str) -> str:
        """Return the other target where the camera was calibrated, as the end of a sentence; empty: none."""
        for other in self.targets:
            if other.name != target and camera.serial is not None and other.camera.serial == camera.serial:
                return f": it is the camera of target {other.name!r}, the cameras are swapped"
        return ""

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets in beam order."""
        return tuple(target.name for target in self.targets)

    def target(self, name: str) -> TargetCalibration | None:
        """Return the target of that name, or None."""
        return next((target for target in self.targets if target.name == name), None)
