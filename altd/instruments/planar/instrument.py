"""The instrument ``planar``: identifies the LEDs among the lights of a frame and solves the plate's pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from altd.instruments.planar.fitting import PlaneFit
from altd.instruments.planar.layout import PlateMatch, placed_mm, rigid_matches, wrapped_deg
from altd.instruments.planar.plane import Model
from altd.instruments.planar.pose import solve_pose
from altd.mapping.grid import edge_lines
from altd.measuring.calibration import CalibrationFile
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, FloatArray, Origin, Quantities, Quantity, Value, counted
from altd.vision.led_discs import Disc

QUANTITIES = Quantities(
    instrument="planar",
    of_unit=(
        Quantity("a_mm", "a", "mm", "place of the plate's origin in the fixed frame, along x", 4),
        Quantity("b_mm", "b", "mm", "the same, along y", 4),
        Quantity("phi_deg", "phi", "°", "turn of the plate, anticlockwise, in (−180°, 180°]", 5),
    ),
)

MIN_LEDS = 2
_MIN_SURE_LEDS = 3
"""Three lights hardly ever fit a layout by chance; two do, and look the same when the plate is turned."""
_TOLERANCE_SIGMAS = 6.0
_MIN_TOLERANCE_MM = 0.02
_AREA_RATIO_LIMITS = 0.7, 1.4
"""Limits of a disc's area relative to the calibrated LEDs; a light outside them is not an LED."""
_MAX_OUTSIDE_SHARE = 0.5
"""Maximum distance of an LED outside the hull of the calibrated positions, as a share of its diameter."""
_MAX_STEP_MM = 1.5
"""An LED that moved less than this since the frame before is the same one."""
_MAX_TURN_MARGIN_DEG = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class PlanarCalibration:
    """Calibration of the camera and the plate of one unit.

    ``frame_noise_px`` is the standard deviation of a centre in a single frame, ``hull_mm`` (n, 2) the hull of
    the LEDs in the fixed frame, ``known_phi_deg`` the turns of the known poses. ``rms`` holds the
    leave-one-out errors of the known poses by model, (a and b in mm, φ in °); empty for a single pose.
    """

    unit_serial: str
    created: datetime
    recording_note: str
    recording_sha256: str
    camera: CameraIdentity
    origin: Origin
    disc_mm: float
    fit: PlaneFit
    frame_noise_px: float
    hull_mm: FloatArray
    known_phi_deg: tuple[float, ...]
    rms: Mapping[Model, tuple[float, float]] = field(default_factory=dict)
    file: CalibrationFile | None = None

    @property
    def simulated(self) -> bool:
        """Whether the calibration is based on simulated frames."""
        return self.origin is Origin.SIMULATED

    @property
    def target_names(self) -> tuple[str, ...]:
        """Empty, because a plate has no beam targets."""
        return ()


@dataclass(frozen=True, slots=True, eq=False)
class Leds:
    """LEDs of one frame, or the mean of several: numbers (n,), centres (n, 2) px, frames of each (n,)."""

    numbers: tuple[int, ...]
    centres_px: FloatArray
    frames: tuple[int, ...]


class PlanarInstrument:
    """Identifies the plate's LEDs among lights and solves the pose; without state."""

    quantities = QUANTITIES

    def __init__(self, calibration: PlanarCalibration) -> None:
        self._calibration = calibration
        self._fit = calibration.fit
        self._turns = _allowed_turns(calibration.known_phi_deg)
        self._edges = edge_lines(calibration.hull_mm)
        span = calibration.hull_mm[:, None, :] - calibration.hull_mm[None, :, :]
        self._margin_mm = _MAX_OUTSIDE_SHARE * float(np.linalg.norm(span, axis=2).max())

    def identify(self, discs: Sequence[Disc], before: Leds | None = None) -> Leds | Fault:
        """Return the discs that are LEDs, or a fault; ``before`` holds the LEDs of the frame just before.

        Three or more discs are LEDs when they fit the layout within the uncertainty, no other discs do, and
        the others are fewer. Two discs are LEDs when there are no others, they fit in one way alone, and the
        plate is not upside down: it was there in the frame before, or its turn is near the known ones.
        Everything else is a fault.
        """
        discs = self._of_led_size(discs)
        if len(discs) < MIN_LEDS:
            return _missing(len(discs))
        points_px = np.array([(disc.u_px, disc.v_px) for disc in discs])
        points_mm = self._fit.camera.to_mm(points_px)
        known = np.isfinite(points_mm).all(axis=1)
        points_px, points_mm = points_px[known], points_mm[known]
        ways = rigid_matches(self._fit.leds_mm, points_mm, self._tolerance_mm(points_mm))
        if not ways:
            return Fault(
                Reason.LEDS_MISFIT, detail=f"{counted(len(points_mm), 'light')}, no two fit the layout"
            )
        if len(ways[0].pairs) < _MIN_SURE_LEDS:
            way = self._of_two(ways, points_px, before)
        else:
            way = _of_three_or_more(ways, len(points_mm), len(self._fit.leds_mm))
        if isinstance(way, Fault):
            return way
        led, light = (list(column) for column in zip(*way.pairs, strict=True))
        return Leds(tuple(led), points_px[light], (1,) * len(led))

    def solve(self, leds: Leds) -> dict[str, Value] | Fault:
        """Return the quantities, or the fault that prevents them."""
        if len(leds.numbers) < MIN_LEDS:
            return _missing(len(leds.numbers))
        calibration = self._calibration
        noise_px = calibration.frame_noise_px / np.sqrt(np.array(leds.frames, dtype=np.float64))
        numbers = np.array(leds.numbers)
        solved = solve_pose(self._fit, calibration.disc_mm, numbers, leds.centres_px, noise_px)
        if not solved.fits:
            return Fault(
                Reason.LEDS_MISFIT, detail=f"{len(numbers)} LEDs are not where a rigid plate has them"
            )
        outside_mm = self._outside_mm(placed_mm(self._fit.leds_mm[numbers], solved.pose))
        if outside_mm > self._margin_mm:
            detail = f"an LED is {outside_mm:.0f} mm outside the calibrated area"
            return Fault(Reason.OUT_OF_RANGE, detail=detail)
        sigma, random = (np.sqrt(np.diag(part)) for part in (solved.covariance, solved.scatter))
        keys = (quantity.key for quantity in QUANTITIES.of_unit)
        return {
            key: Value(float(value), float(of_all), float(min(of_random, of_all)))
            for key, value, of_all, of_random in zip(keys, solved.pose, sigma, random, strict=True)
        }

    def _of_led_size(self, discs: Sequence[Disc]) -> list[Disc]:
        at_mm = self._fit.camera.to_mm(np.array([(d.u_px, d.v_px) for d in discs]).reshape(-1, 2))
        area_px2 = np.abs(np.linalg.det(self._fit.camera.px_per_mm(at_mm)))
        of_led_px = math.pi / 4 * self._calibration.disc_mm**2 * area_px2
        low, high = _AREA_RATIO_LIMITS
        return [
            disc
            for disc, area in zip(discs, of_led_px.tolist(), strict=True)
            if low * area < disc.area_px < high * area
        ]

    def _tolerance_mm(self, points_mm: FloatArray) -> FloatArray:
        """Maximum distance of each light from its LED, (n,) mm."""
        fit, per_mm = self._fit, self._fit.camera.px_per_mm(points_mm)
        slopes = fit.camera.jacobian(points_mm)
        parameters = len(fit.camera.parameters)
        of_camera = slopes @ fit.covariance[:parameters, :parameters] @ np.swapaxes(slopes, 1, 2)
        variance_px2 = of_camera + (fit.noise_px**2 + self._calibration.frame_noise_px**2) * np.eye(2)
        inverse = np.linalg.inv(per_mm)
        variance_mm2 = inverse @ variance_px2 @ np.swapaxes(inverse, 1, 2)
        sigma_mm = np.sqrt(np.trace(variance_mm2, axis1=1, axis2=2) / 2 + fit.sigma_led_mm**2)
        return np.asarray(np.maximum(_TOLERANCE_SIGMAS * sigma_mm, _MIN_TOLERANCE_MM))

    def _of_two(
        self, ways: Sequence[PlateMatch], points_px: FloatArray, before: Leds | None
    ) -> PlateMatch | Fault:
        """Return the only way in which two lights can be LEDs, or a fault."""
        if len(points_px) > MIN_LEDS:
            detail = (
                f"of {len(points_px)} lights no three fit the layout: two are not enough to identify LEDs"
            )
            return Fault(Reason.LEDS_MISFIT, detail=detail)
        followed = [way for way in ways if before is not None and self._is_followed(way, points_px, before)]
        if len(followed) == 1:
            return followed[0]
        near = [way for way in ways if self._is_upright(way.pose[2])]
        if len(near) == 1:
            return near[0]
        detail = "two LEDs look the same when the plate is turned; a third is needed"
        return Fault(Reason.LEDS_MISFIT, detail=detail)

    def _is_followed(self, way: PlateMatch, points_px: FloatArray, before: Leds) -> bool:
        """Whether the LEDs were close to these positions in the frame before."""
        if not {led for led, _ in way.pairs} <= set(before.numbers):
            return False
        led, light = (list(column) for column in zip(*way.pairs, strict=True))
        were_px = before.centres_px[[before.numbers.index(number) for number in led]]
        moved_mm = self._fit.camera.to_mm(points_px[light]) - self._fit.camera.to_mm(were_px)
        return bool(np.all(np.linalg.norm(moved_mm, axis=1) < _MAX_STEP_MM))

    def _is_upright(self, phi_deg: float) -> bool:
        if self._turns is None:
            return False
        middle_deg, half_deg = self._turns
        return abs(wrapped_deg(phi_deg - middle_deg)) <= half_deg

    def _outside_mm(self, points_mm: FloatArray) -> float:
        """Distance of the farthest of places (n, 2) outside the hull, mm; negative: all are inside."""
        return float((points_mm @ self._edges[:, :2].T - self._edges[:, 2]).max())


def _of_three_or_more(ways: Sequence[PlateMatch], lights: int, leds: int) -> PlateMatch | Fault:
    """Return the best match, or a fault if other lights could be the plate or most lights are not its LEDs.

    Two lights at the distance of two LEDs may belong to a plate whose other LEDs are dark. This is excluded
    only where all LEDs are found.
    """
    best = ways[0]
    used = {light for _, light in best.pairs}
    min_own = MIN_LEDS if len(best.pairs) < leds else _MIN_SURE_LEDS
    for other in ways[1:]:
        own = {light for _, light in other.pairs} - used
        if len(other.pairs) == len(best.pairs) or len(own) >= min_own:
            return Fault(Reason.LEDS_MISFIT, detail="the lights fit the layout in more than one way")
    if lights - len(best.pairs) >= len(best.pairs):
        detail = f"of {lights} lights {len(best.pairs)} fit the layout: the others may be the plate"
        return Fault(Reason.LEDS_MISFIT, detail=detail)
    return best


def _missing(count: int) -> Fault:
    return Fault(Reason.LEDS_MISSING, detail=f"{counted(count, 'LED')} seen, a pose needs {MIN_LEDS}")


def _allowed_turns(known_deg: Sequence[float]) -> tuple[float, float] | None:
    """Middle and half width of the turns accepted for a pair of LEDs; None: known turns span 180° or more.

    These are the known turns with a margin on both sides, such that no turn and its opposite are both
    accepted.
    """
    turns = np.sort(np.mod(known_deg, 360.0))
    gaps = np.diff(np.append(turns, turns[0] + 360.0))
    widest = int(gaps.argmax())
    half_deg = (360.0 - float(gaps[widest])) / 2
    middle_deg = float(turns[(widest + 1) % len(turns)]) + half_deg
    if half_deg >= 90.0:
        return None
    return middle_deg, min(half_deg + _MAX_TURN_MARGIN_DEG, (half_deg + 90.0) / 2)
