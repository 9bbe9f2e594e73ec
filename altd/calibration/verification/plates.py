"""Places of a plate's LEDs by a target's map against the known ones: a screen whose discs are moved.

What cannot be known of the screen's place is removed: shift and turn. If it was placed again, also its scale
and its tilt, so all of a homography. What remains is the map's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from altd.calibration.verification.estimate import WeightedFit
from altd.calibration.verification.verdict import COVERAGE, REQUIRED, LimitTest, why_no_scatter, with_parts
from altd.measuring.calibration import TargetCalibration
from altd.recording.header import PlateHeader
from altd.records import FloatArray, Limits
from altd.records.limits import NO_LIMITS

_MIN_SHIFT = 1 / 8
"""Least shift beyond whole pitches, in pitches, that brings discs between the places of a calibration."""
_MIN_DISCS = 8
UNTOUCHED_MM, UNTOUCHED_MRAD = 0.05, 1.0
"""Standard uncertainty of place and turn of a screen that was not touched: a pressed key, a warmer camera,
and what discs and map have in common over the area."""


@dataclass(frozen=True, slots=True, eq=False)
class PlateSet:
    """The LEDs of a plate within a target's area: ``known_mm``, ``read_mm`` (n, 2), ``covariance_mm2``.

    ``map_factor`` (n, 2, m) is the part of the covariance (n, 2, 2) that is common through the map.
    """

    plate: PlateHeader
    known_mm: FloatArray
    read_mm: FloatArray
    covariance_mm2: FloatArray
    map_factor: FloatArray

    @property
    def shift_mm(self) -> FloatArray:
        """Shift (2,) of the plate's middle from the target's."""
        counts = np.array([self.plate.columns, self.plate.rows])
        return np.asarray(self.plate.origin_mm) + (counts - 1) / 2 * self.plate.pitch_mm

    @property
    def is_between(self) -> bool:
        """Whether its discs are not at the places of a centred plate."""
        pitches = self.shift_mm / self.plate.pitch_mm
        return bool(np.abs(pitches - np.rint(pitches)).max() >= _MIN_SHIFT)


def plate_set(
    target: TargetCalibration, plate: PlateHeader, known_mm: FloatArray, px: FloatArray
) -> PlateSet:
    """Map spots (n, 2) px at known places to mm; those outside the calibrated area are left out.

    Raises ValueError if too few are within it.
    """
    read_mm, _, covariance_mm2 = target.inverse.to_mm(px)
    kept = np.isfinite(read_mm).all(axis=1)
    read_mm = read_mm[kept]
    if len(read_mm) < _MIN_DISCS or min(np.linalg.svd(read_mm - read_mm.mean(axis=0))[1]) < plate.pitch_mm:
        raise ValueError(f"{len(read_mm)} discs in the calibrated area; {_MIN_DISCS} in two rows are needed")
    factor = np.asarray(
        np.linalg.solve(target.map.jacobian(read_mm), target.map.errors_px(read_mm)), dtype=np.float64
    )
    return PlateSet(plate, known_mm[kept], read_mm, covariance_mm2[kept], factor)


def tests_of_plates(
    name: str, sets: Sequence[PlateSet], calibration: Limits
) -> tuple[list[LimitTest], list[FloatArray]]:
    """Return the tests of a target, without limits, and the remaining errors (n, 2) mm of each set.

    The sets show one screen that stayed where it was. ``placed`` of their plate states how well it lies on
    the target; 0 mm and 0° that it has not been touched since the calibration.
    """
    plate, scatter_name = sets[0].plate, f"{name}: standard deviation"
    test = LimitTest(f"{name}_standard_deviation_mm", scatter_name, " mm", 4, required=REQUIRED / COVERAGE)
    known, read, factor = (
        np.concatenate([getattr(of, key) for of in sets]) for key in ("known_mm", "read_mm", "map_factor")
    )
    is_untouched = plate.placed is not None and plate.placed.sigma_mm == plate.placed.sigma_deg == 0.0
    turn = _turn(known, read)
    turned = known @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    design = _design(turned, is_untouched)
    spread = factor.transpose(1, 0, 2).reshape(2 * len(known), -1)
    own = np.concatenate([of.covariance_mm2 for of in sets]) - factor @ factor.transpose(0, 2, 1)
    covariance = spread @ spread.T + np.block([[np.diag(own[:, i, j]) for j in (0, 1)] for i in (0, 1)])
    fit = WeightedFit.of(design, (read - turned).T.ravel(), covariance)
    scatter, stated, before = fit.scatter(), plate.limits, calibration
    if is_untouched:
        of_screen = {"plate_mm": UNTOUCHED_MM, "plate_turn_mrad": UNTOUCHED_MRAD}
        stated, before = replace(stated, **of_screen), NO_LIMITS
    parts, freedom = {"stated": scatter.stated}, scatter.degrees_of_freedom
    test = replace(
        test, value=scatter.experimental, sigma=scatter.stated, parts=parts, degrees_of_freedom=freedom,
        why_not=why_no_scatter(scatter, False),
    )  # fmt: skip
    unstated = "" if plate.placed else "the recording does not state --placed"
    tests = [test]
    for number, axis in enumerate("xy"):
        slips_mm = [slip for of in sets if of.is_between for slip in _slips_mm(of, number)]
        at = LimitTest(
            f"{name}_place_{axis}_mm", f"{name}: place of the screen in {axis}", " mm", 3,
            why_not=unstated, required=min(slips_mm, default=None),
        )  # fmt: skip
        tests.append(with_parts(at, fit.linear({number: 1.0}, 1.0), stated.plate_mm, before.plate_mm))
    of_turn = LimitTest(f"{name}_turn_mrad", f"{name}: turn of the screen", " mrad", 2, why_not=unstated)
    turned_by = fit.linear({2: 1.0}, 1e3)
    turned_by = replace(turned_by, value=turned_by.value + 1e3 * turn)
    tests.append(with_parts(of_turn, turned_by, stated.plate_turn_mrad, before.plate_turn_mrad))
    if not is_untouched:
        unstated = "" if plate.pitch_sigma_mm is not None else "the recording does not state SIGMA_MM"
        scale = LimitTest(f"{name}_scale_ppm", f"{name}: scale", " ppm", 0, why_not=unstated)
        found = fit.linear({3: 1.0}, 1e6)
        tests.append(with_parts(scale, found, stated.stage_scale_ppm, before.stage_scale_ppm))
    ends = np.cumsum([len(of.known_mm) for of in sets])[:-1]
    return tests, np.split(fit.residuals.reshape(2, -1).T, ends)


def _slips_mm(of: PlateSet, axis: int) -> list[float]:
    """Errors along an axis if the discs were not moved, to the other side, or along the other axis."""
    shift_mm = np.abs(of.shift_mm)
    slips_mm = (float(shift_mm.max()), 2.0 * float(shift_mm[axis]), float(np.ptp(of.shift_mm)))
    return [slip for slip in slips_mm if slip > _MIN_SHIFT / 2 * of.plate.pitch_mm]


def _turn(known_mm: FloatArray, read_mm: FloatArray) -> float:
    """Angle by which the places (n, 2) read are turned about their middle, radians."""
    known, read = ((of - of.mean(axis=0)) @ np.array([1, 1j]) for of in (known_mm, read_mm))
    return float(np.angle(np.vdot(known, read)))


def _design(places_mm: FloatArray, is_untouched: bool) -> FloatArray:
    """Effects (2 n, k) on x, then y: shift, turn; if placed again, scale, two shears, two keystones."""
    (x, y), none, one = places_mm.T, np.zeros(len(places_mm)), np.ones(len(places_mm))
    effects = [(one, none), (none, one), (-y, x)]
    if not is_untouched:
        effects += [(x, y), (x, -y), (y, x), (x * x / 100, x * y / 100), (x * y / 100, y * y / 100)]
    return np.array([np.concatenate(effect) for effect in effects]).T
