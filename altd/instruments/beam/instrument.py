"""The instrument ``beam``: a straight line fitted to the mean spots on two or more targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from altd.config import Installation, Machine, Measuring
from altd.instruments.beam.points import quantities_of_points
from altd.instruments.beam.refraction import Refraction
from altd.instruments.beam.solver import (
    KEYS,
    Beam,
    fit_beam,
    joint_covariance_mm2,
    joint_jacobian_mm_per_px,
    line_gain,
)
from altd.instruments.beam.systematics import Warmth, vibration_mm
from altd.measuring.calibration import Calibration
from altd.measuring.instrument import Solution
from altd.measuring.spot_shape import shape_doubts_mm
from altd.reasons import Reason
from altd.records import (
    Fault,
    FaultCause,
    FloatArray,
    MeanSpots,
    Quantities,
    Quantity,
    TargetPoint,
    Value,
)
from altd.records.joint import Joint
from altd.records.spots import CrossCheckedBeam, CrossCheckedSpot, Motion, SpotMotion

QUANTITIES = Quantities(
    instrument="beam",
    has_motion=True,
    has_cross_check=True,
    joint=("x_mm", "y_mm", "yaw_mm_per_m", "pitch_mm_per_m"),
    of_unit=(
        Quantity(
            "x_mm",
            "x",
            "mm",
            "displacement of the beam at the front target, to the right as seen along the beam",
            4,
        ),
        Quantity("y_mm", "y", "mm", "the same, upwards", 4),
        Quantity("yaw_deg", "yaw", "°", "direction of the beam, atan of its slope in x", 5),
        Quantity("pitch_deg", "pitch", "°", "atan of its slope in y", 5),
        Quantity("yaw_mm_per_m", "yaw", "mm/m", "1000 times the slope in x", 4, False, is_also="yaw_deg"),
        Quantity(
            "pitch_mm_per_m", "pitch", "mm/m", "1000 times the slope in y", 4, False, is_also="pitch_deg"
        ),
        Quantity(
            "roll_deg",
            "roll",
            "°",
            "needs an inclinometer, as it cannot be measured from the beam",
            5,
            False,
            True,
        ),
    ),
    of_target=(
        Quantity("x_mm", "x", "mm", "intersection of the beam with the target", 4, False),
        Quantity("y_mm", "y", "mm", "intersection of the beam with the target", 4, False),
    ),
)


def quantities_of(installation: Installation, machine: Machine | None = None) -> Quantities:
    """Return the quantities, with their meaning after plane, signs and offsets, and the machine's points."""
    plane_mm = installation.reference_plane_mm
    plane = f"in the plane z = {plane_mm:g} mm" if plane_mm else "at the front target"

    def meaning(quantity: Quantity) -> str:
        key = quantity.is_also or quantity.key
        if (sign := installation.signs.get(key)) is None:
            return quantity.meaning
        offset = getattr(installation, f"offset_{key}")
        return "".join(
            [
                quantity.meaning.replace("at the front target", plane),
                ", sign reversed" if sign < 0 else "",
                f", plus {offset:g} {'mm' if key.endswith('_mm') else '°'}" if offset else "",
            ]
        )

    of_beam = (replace(each, meaning=meaning(each)) for each in QUANTITIES.of_unit)
    return replace(QUANTITIES, of_unit=(*of_beam, *(quantities_of_points(machine) if machine else ())))


def values_of(beam: Beam) -> dict[str, Value]:
    """Quantities of a beam by key, without roll."""
    x, y, yaw, pitch = beam.scatter
    return {
        "x_mm": Value(beam.x_mm, beam.sigma_x_mm, x),
        "y_mm": Value(beam.y_mm, beam.sigma_y_mm, y),
        "yaw_deg": Value(beam.yaw_deg, beam.sigma_yaw_deg, yaw),
        "pitch_deg": Value(beam.pitch_deg, beam.sigma_pitch_deg, pitch),
        "yaw_mm_per_m": Value(beam.yaw_mm_per_m),
        "pitch_mm_per_m": Value(beam.pitch_mm_per_m),
    }


_LINE = [0, 2, 1, 3]
"""Rows of ``line_gain`` (x, slope x, y, slope y) in the order of ``KEYS``."""


def by_line(beam: Beam, installation: Installation) -> FloatArray:
    """Derivatives (4, 4) of the quantities of ``KEYS`` by the line of ``beam``, which is in the unit frame.

    They have the signs of the installation. yaw = atan(slope), so its derivative is 1 / (1 + slope²).
    """
    yaw, pitch = (
        math.degrees(math.cos(math.radians(angle)) ** 2) for angle in (beam.yaw_deg, beam.pitch_deg)
    )
    scale = np.array([1.0, 1.0, yaw, pitch]) * [installation.signs[key] for key in KEYS]
    derivatives: FloatArray = scale[:, None] * np.eye(4)[_LINE]
    return derivatives


def beam_motions(motion: SpotMotion, by_px: FloatArray) -> dict[str, Motion]:
    """Motion of each quantity of ``KEYS``.

    ``by_px`` (4, 2 T) are the quantities' derivatives by the spots. The maps are taken as linear over a few
    millimetres.
    """
    rate, onset = by_px @ motion.rate_px_per_s, by_px @ motion.onset_px_per_s
    rate_variance = _variances(by_px, motion.rate_covariance)
    vibration = np.sqrt(np.maximum(_variances(by_px, motion.vibration_px2), 0.0))
    return {
        key: Motion(
            rate=float(rate[row]),
            sigma_rate=math.sqrt(rate_variance[row]),
            vibration=float(vibration[row]),
            onset=float(onset[row]),
            onset_s=motion.onset_s,
            spread_s2=motion.spread_s2,
            at_s=motion.at_s,
        )
        for row, key in enumerate(KEYS)
    }


def _mm_per_m_per_deg(angle_deg: float) -> float:
    """Derivative of 1000 · tan(angle)."""
    return 1000.0 * math.radians(1.0) / math.cos(math.radians(angle_deg)) ** 2


def _variances(by_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Variance of the quantity of each row."""
    variances: FloatArray = np.einsum("ij,jk,ik->i", by_px, covariance_px2, by_px)
    return variances


MAX_YAW_MM_PER_M = 110.0
MAX_PITCH_MM_PER_M = 250.0
"""Specified ranges of the unit, mm/m (App. A.1)."""
_CLOCKS_S = 0.5e-3
"""Uncertainty of the time between two cameras with clocks of their own: 0.2 to 0.3 ms on a busy computer."""
_MARGIN_SIGMAS = 3.0
_MAX_MARGIN_MM_PER_M = 1.0
"""Required accuracy, mm/m (App. A.1): a beam may exceed a range by its uncertainty, up to this limit."""


class BeamInstrument:
    """Solver without state; see ``measuring.instrument.Instrument``.

    A beam whose scatter exceeds ``measuring.max_sigma_…`` is a fault. ``installation`` converts the beam from
    the unit frame to the coordinates of the controller. ``celsius`` returns the temperature that its
    thermometer reads on the frame, None if it is not known: by its difference from that of the calibration
    the frame's expansion is corrected, and its uncertainty replaces the stated ``temperature_k``. An
    inclinometer adds the sigma of roll to the quantities, ``machine`` adds its points.
    """

    min_targets = 2

    def __init__(
        self,
        calibration: Calibration,
        measuring: Measuring,
        installation: Installation | None = None,
        celsius: Callable[[], float | None] = lambda: None,
        has_inclinometer: bool = False,
        machine: Machine | None = None,
    ) -> None:
        self._calibration = {target.name: target for target in calibration.targets}
        self._stated = calibration.limits
        self._calibrated_c, self._celsius = calibration.temperature_c, celsius
        self._measuring = measuring
        self._installation = installation or Installation()
        self.quantities = quantities_of(self._installation, machine)
        if has_inclinometer:
            self.quantities = self.quantities.with_sensor("roll_deg")
        self._refraction = Refraction.from_calibration(calibration)
        self._vibration = measuring.vibration_mm, measuring.vibration_mrad

    def solve(self, mean: MeanSpots) -> Solution | Fault:
        """Return the beam through the window's mean spots, or the fault that prevents it."""
        warmth = self._warmth
        places = self._places(mean, 1.0 if warmth is None else warmth.view_growth)
        if isinstance(places, Fault):
            return places
        points, checked = places
        targets = [self._calibration[target] for target in mean.targets]
        doubts_mm = shape_doubts_mm(mean, points, [target.spot.shape for target in targets])
        if isinstance(doubts_mm, Fault):
            return doubts_mm
        covariance = joint_covariance_mm2(mean, points) + np.diag(np.repeat(doubts_mm**2, 2))
        growth = 1.0 if warmth is None else warmth.distance_growth
        z_mm = [growth * target.z_mm for target in targets]
        plane_mm, refraction = self._installation.reference_plane_mm, self._refraction
        if refraction is not None and growth != 1.0:
            refraction = refraction.grown(growth)
        hidden_mm = None
        if mean.is_even and any(self._vibration):
            own_clocks_s = 0.0 if self._measuring.pair_by == "sequence" else _CLOCKS_S
            hidden_mm = vibration_mm(z_mm, *self._vibration, math.hypot(mean.apart_s, own_clocks_s))
        try:
            beam = fit_beam(z_mm, points, covariance, plane_mm, self._stated, refraction, hidden_mm, warmth)
        except np.linalg.LinAlgError:
            return Fault(Reason.CHECK_FAILED, detail="no beam fits the points with their covariance")
        if (unsteady := self._too_uncertain(beam)) is not None:
            return _unexplained(mean, points, doubts_mm, covariance) or unsteady
        if (doubt := range_fault(beam)) is not None:
            return doubt
        published, motions, vibration = installed(beam, self._installation), {}, None
        derivatives = by_line(beam, self._installation)
        per_slope = None if refraction is None else refraction.displaced_mm(beam.slopes, z_mm)[1]
        by_mm = derivatives @ line_gain(z_mm, covariance, plane_mm, per_slope)[0]
        pairs = list(zip(points, checked, strict=True))
        apart_mm = [d for point, by in pairs for d in (by.x_mm - point.x_mm, by.y_mm - point.y_mm)]
        *_, yaw_apart_deg, pitch_apart_deg = (by_mm @ apart_mm).tolist()
        if mean.motion is not None:
            by_px = by_mm @ joint_jacobian_mm_per_px(points)
            motions = beam_motions(mean.motion, by_px)
            vibration = by_px @ mean.motion.vibration_px2 @ by_px.T
        return Solution(
            values_of(published),
            {
                target: {"x_mm": Value(point.x_mm), "y_mm": Value(point.y_mm)}
                for target, point in zip(mean.targets, points, strict=True)
            },
            motions,
            Joint(
                KEYS,
                derivatives @ beam.line_covariance @ derivatives.T,
                derivatives @ beam.line_scatter @ derivatives.T,
                np.array([1.0, 1.0, *map(_mm_per_m_per_deg, (published.yaw_deg, published.pitch_deg))]),
                vibration,
            ),
            CrossCheckedBeam(
                published.yaw_deg + yaw_apart_deg,
                published.pitch_deg + pitch_apart_deg,
                dict(zip(mean.targets, checked, strict=True)),
            ),
        )

    @property
    def _warmth(self) -> Warmth | None:
        """Warmth of a frame that has a thermometer; None: as the limits state."""
        if self._calibrated_c is None or self._installation.thermometer is None:
            return None
        return Warmth.measured(
            self._celsius(), self._calibrated_c, self._stated.temperature_k, self._installation.expansion
        )

    def _places(
        self, mean: MeanSpots, growth: float
    ) -> tuple[list[TargetPoint], list[CrossCheckedSpot]] | Fault:
        """Return the beam's places on the targets, and the same by the second maps."""
        points, checked = list[TargetPoint](), list[CrossCheckedSpot]()
        for target, (u_px, v_px) in zip(mean.targets, mean.px, strict=True):
            point = self._calibration[target].point(float(u_px), float(v_px))
            if point is None:
                detail = f"{target} spot at u {u_px:.1f} v {v_px:.1f} px lies outside the calibrated area"
                return Fault(Reason.OUT_OF_RANGE, detail=detail)
            spot = self._calibration[target].cross_checked(point, float(u_px), float(v_px))
            if isinstance(spot, str):
                return Fault(Reason.IMPLAUSIBLE, target, spot)
            if growth != 1.0:
                point = replace(point, x_mm=growth * point.x_mm, y_mm=growth * point.y_mm)
                spot = replace(spot, x_mm=growth * spot.x_mm, y_mm=growth * spot.y_mm)
            points.append(point)
            checked.append(spot)
        return points, checked

    def _too_uncertain(self, beam: Beam) -> Fault | None:
        """Fault of a beam that scatters more than the required accuracy; calibration limits are ignored."""
        x_mm, y_mm, yaw_deg, pitch_deg = beam.scatter
        sigma_mm, sigma_mm_per_m = max(x_mm, y_mm), 1000 * math.radians(max(yaw_deg, pitch_deg))
        if sigma_mm > self._measuring.max_sigma_mm:
            return Fault(Reason.UNSTEADY, detail=f"displacement is uncertain by {sigma_mm:.2f} mm")
        if sigma_mm_per_m > self._measuring.max_sigma_mm_per_m:
            return Fault(Reason.UNSTEADY, detail=f"direction is uncertain by {sigma_mm_per_m:.2f} mm/m")
        return None


def _unexplained(
    mean: MeanSpots, points: Sequence[TargetPoint], doubts_mm: FloatArray, covariance_mm2: FloatArray
) -> Fault | None:
    """Fault of the target whose light makes a measurement too uncertain; None where motion causes that."""
    scale = [math.sqrt(abs(float(np.linalg.det(point.jacobian_mm_per_px)))) for point in points]
    unexplained_mm = np.hypot(np.array(mean.excess_px) * scale, doubts_mm)
    worst = int(unexplained_mm.argmax())
    if unexplained_mm[worst] ** 2 < covariance_mm2[2 * worst, 2 * worst] / 2:
        return None
    detail = f"{unexplained_mm[worst]:.2f} mm uncertain beyond light and view"
    if changed := max(mean.changed_light, default=0.0):
        detail += f"; the targets' light changed by {changed:.0%} against each other"
    return Fault(Reason.DISTORTED, mean.targets[worst], detail, FaultCause.UNCERTAIN_PLACE)


def range_fault(beam: Beam) -> Fault | None:
    """Fault of a beam, in the unit frame before signs and offsets, that exceeds the specified ranges.

    None for a beam that is not finite: the gate rejects it.
    """
    if not (math.isfinite(beam.yaw_deg) and math.isfinite(beam.pitch_deg)):
        return None
    for name, slope, sigma_deg, limit in (
        ("yaw", beam.yaw_mm_per_m, beam.sigma_yaw_deg, MAX_YAW_MM_PER_M),
        ("pitch", beam.pitch_mm_per_m, beam.sigma_pitch_deg, MAX_PITCH_MM_PER_M),
    ):
        sigma = math.radians(sigma_deg) * (1000.0 + slope * slope / 1000.0)
        if abs(slope) > limit + min(_MARGIN_SIGMAS * sigma, _MAX_MARGIN_MM_PER_M):
            detail = f"{name} is {slope:.1f} mm/m, the unit measures up to {limit:g}"
            return Fault(Reason.OUT_OF_RANGE, detail=detail, cause=FaultCause.TOO_OBLIQUE)
    return None


def installed(beam: Beam, installation: Installation) -> Beam:
    """Beam in the controller's coordinates: sign first, then offset; the sigmas do not change."""
    return replace(
        beam,
        x_mm=installation.sign_x * beam.x_mm + installation.offset_x_mm,
        y_mm=installation.sign_y * beam.y_mm + installation.offset_y_mm,
        yaw_deg=installation.sign_yaw * beam.yaw_deg + installation.offset_yaw_deg,
        pitch_deg=installation.sign_pitch * beam.pitch_deg + installation.offset_pitch_deg,
    )
