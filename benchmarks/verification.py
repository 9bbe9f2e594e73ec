"""``python -m benchmarks.verification``: how often ``altd verify`` fails right and wrong units.

200 simulated units are calibrated and verified without rendering: the simulated lenses project the positions
of the beam, a smooth random field represents print and speckle, and stages and beams have errors according to
their limits. A tenth of the units has changed since its calibration, by twice the expanded uncertainty (k =
2) of one of the tested numbers: scale of x or y, squareness, zero of yaw or pitch, distance of the targets.
Spots become measurements by altd's own maps and solver. The verification has three sets: the beam as it is
and deflected by a wedge, then the unit turned on its seat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from statistics import NormalDist

import numpy as np

from altd.calibration.verification.estimate import BeamSet, Mounting, beam_set, estimate
from altd.calibration.verification.verdict import CONFIDENCE, POWER, Judgement, Result, judge
from altd.instruments.beam.instrument import QUANTITIES, values_of
from altd.instruments.beam.solver import fit_beam, joint_covariance_mm2
from altd.mapping.grid import convex_hull_mm
from altd.mapping.lens import fit_lens_map
from altd.mapping.nodes import Nodes
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.records import FloatArray, Limits, MeanSpots, Measurement, Value
from altd.vision.settings import SpotSettings
from benchmarks.harness import Parser, end, show
from hw_sim.assembly import FRONT_FOCAL_MM, REAR_FOCAL_MM, make_lens
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens
from hw_sim.scan import USUAL, dense_grid

Z_MM = {"front": 0.0, "rear": 280.0}
PATTERN_PX = 0.035
"""Standard deviation of a node without a flat, as on the recorded unit (../shared/data/unit-a)."""
PATTERN_LENGTH_MM = 4.0
WAVES = 300
SCATTER_PX = 0.01
CALIBRATION_LIMITS = Limits(0.002, 50.0, 0.05, 0.04, 0.05)
"""As of a calibration with the unit turned on a seat of ``SEAT_MM_PER_M``."""
REFERENCE_LIMITS = Limits(0.002, 20.0, 0.02, 0.5)
SEAT_MM_PER_M = 0.05
DEFLECTION_DEG = (math.degrees(math.atan(0.05)),) * 2
DEFLECTION_SIGMA_DEG = 0.002
KINDS = ("scale_x_ppm", "scale_y_ppm", "square_mrad", "zero_yaw_deg", "zero_pitch_deg", "target_distance_mm")
CHECKED = dense_grid(5, 4)
TRAVEL_MM = 60.0
"""Half of the verification's grid along x; its nodes differ from those of the calibration."""


@dataclass(frozen=True, slots=True)
class Change:
    """Errors of a unit since its calibration, in scale, squareness, zero and distance of the targets."""

    scale_x_ppm: float = 0.0
    scale_y_ppm: float = 0.0
    square_mrad: float = 0.0
    zero_yaw_deg: float = 0.0
    zero_pitch_deg: float = 0.0
    target_distance_mm: float = 0.0
    pattern: float = 1.0
    """Factor of the pattern, such as from dirt."""


NO_CHANGE = Change()


@dataclass(frozen=True, slots=True, eq=False)
class _Pattern:
    """A smooth Gaussian field on a target: displacements of the spot in px by its position in mm."""

    waves: FloatArray
    phases: FloatArray

    @classmethod
    def made(cls, rng: np.random.Generator) -> _Pattern:
        return cls(rng.normal(0, 1 / PATTERN_LENGTH_MM, (WAVES, 2)), rng.uniform(0, 2 * math.pi, (2, WAVES)))

    def at(self, places_mm: FloatArray) -> FloatArray:
        angles = places_mm @ self.waves.T
        both = np.cos(angles[:, None] + self.phases[None]).sum(axis=2)
        field: FloatArray = PATTERN_PX * math.sqrt(2 / WAVES) * both
        return field


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A stage with its laser, drawn from its limits: scale, angle of the axes, beam, positioning."""

    shape: FloatArray
    slope: FloatArray
    sigma_mm: float

    @classmethod
    def made(cls, limits: Limits, rng: np.random.Generator) -> Stage:
        """Draw a stage from these limits."""
        scale = rng.normal(0, 1e-6 * (limits.stage_scale_ppm or 0.0), 2)
        square = rng.normal(0, 1e-3 * (limits.stage_square_mrad or 0.0))
        slope = rng.normal(0, 1e-3 * (limits.beam_normal_mm_per_m or 0.0), 2)
        return cls(np.array([[1 + scale[0], square], [0.0, 1 + scale[1]]]), slope, limits.stage_mm or 0.0)

    def places_mm(self, known_mm: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Positions (n, 2) of the beam at z = 0 for known positions (n, 2)."""
        places: FloatArray = known_mm @ self.shape.T + rng.normal(0, self.sigma_mm, known_mm.shape)
        return places


class VerifiedUnit:
    """A unit of a seed with its calibration; ``verified`` measures two sets with a separate stage."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 25])
        focal = {"front": FRONT_FOCAL_MM, "rear": REAR_FOCAL_MM}
        self._lenses: dict[str, Lens] = {
            name: make_lens(focal[name], name == "front", self._rng) for name in Z_MM
        }
        self._patterns = {name: _Pattern.made(self._rng) for name in Z_MM}
        self._distance_mm = Z_MM["rear"] + self._rng.normal(0, CALIBRATION_LIMITS.target_distance_mm or 0.0)
        self.calibration = self._calibrated(seed)

    def _calibrated(self, seed: int) -> Calibration:
        nodes_mm = np.array(USUAL.nodes_mm())
        stage = Stage.made(CALIBRATION_LIMITS, self._rng)
        places_mm = stage.places_mm(nodes_mm, self._rng)
        targets = []
        for name, z_mm in Z_MM.items():
            true_z_mm = self._distance_mm if name == "rear" else z_mm
            px = self._seen(name, places_mm + true_z_mm * stage.slope, NO_CHANGE)
            hull = convex_hull_mm(nodes_mm)
            fit = fit_lens_map(Nodes.ordinary(nodes_mm, px), hull, (WIDTH_PX, HEIGHT_PX))
            check = CrossCheck(fit.map, fit.leave_one_out_px, 1.0, 0.0)
            targets.append(
                TargetCalibration(
                    name, z_mm, WIDTH_PX, HEIGHT_PX, SpotSettings(), None, fit.map, check,
                    fit.leave_one_out_px, 0.0, 0.0, 0.0, np.full(2, SCATTER_PX), np.zeros((0, 2)),
                )
            )  # fmt: skip
        return Calibration(
            f"SIM-{seed}",
            datetime(2026, 1, 1, tzinfo=UTC),
            "benchmarks",
            "0" * 64,
            tuple(targets),
            CALIBRATION_LIMITS,
        )

    def _seen(self, name: str, places_mm: FloatArray, change: Change) -> FloatArray:
        """Spots (n, 2) px of a beam at these positions of a target, in the unit's own axes."""
        px = np.column_stack(self._lenses[name].project(*places_mm.T))
        px += change.pattern * self._patterns[name].at(places_mm)
        return px + self._rng.normal(0, SCATTER_PX, px.shape)

    def verified(self, change: Change = NO_CHANGE, calibration: Limits = CALIBRATION_LIMITS) -> Judgement:
        """Verify with a separate stage and mounting, in both orientations and with a wedge."""
        stage = Stage.made(REFERENCE_LIMITS, self._rng)
        turn = self._rng.normal(0, 2e-3)
        wedge_deg = self._rng.normal(DEFLECTION_DEG, DEFLECTION_SIGMA_DEG)
        seats = self._rng.normal(0, 1e-3 * SEAT_MM_PER_M, (2, 2))
        sets = [
            self._set(stage, turn, Mounting(False), change, seats[0]),
            self._set(stage, turn, Mounting(False, 0.0, None, DEFLECTION_DEG), change, seats[0], wedge_deg),
            self._set(stage, turn, Mounting(True), change, seats[1]),
        ]
        return judge(estimate(sets), REFERENCE_LIMITS, calibration)

    def _set(
        self,
        stage: Stage,
        turn_rad: float,
        stated: Mounting,
        change: Change,
        seat: FloatArray,
        deflected_deg: FloatArray | None = None,
    ) -> BeamSet:
        known_mm = np.array(CHECKED.nodes_mm())
        known_mm *= TRAVEL_MM / known_mm.max()
        sign = -1.0 if stated.turned else 1.0
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        mounted = sign * np.array([[cos, -sin], [sin, cos]])
        deflected = np.zeros(2) if deflected_deg is None else deflected_deg
        offset_mm = self._rng.normal(0, 0.5, 2) - Z_MM["rear"] / 2 * np.tan(np.radians(deflected))
        places_mm = stage.places_mm(known_mm, self._rng) @ mounted.T + offset_mm
        slope = mounted @ np.tan(np.arctan(stage.slope) + np.radians(deflected)) + seat
        px = {}
        skew = 1e-3 * change.square_mrad / 2
        reads = np.array([[1 + 1e-6 * change.scale_x_ppm, skew], [skew, 1 + 1e-6 * change.scale_y_ppm]])
        zero = np.tan(np.radians([change.zero_yaw_deg, change.zero_pitch_deg]))
        for name, z_mm in (("front", 0.0), ("rear", self._distance_mm - change.target_distance_mm)):
            px[name] = self._seen(name, (places_mm + z_mm * slope) @ reads.T + z_mm * zero, change)
        measured = [self._measured(np.array([px[name][n] for name in Z_MM])) for n in range(len(known_mm))]
        mounting = replace(
            stated,
            stage_mm=REFERENCE_LIMITS.stage_mm or 0.0,
            seat_mm_per_m=SEAT_MM_PER_M,
            deflection_sigma_deg=DEFLECTION_SIGMA_DEG,
        )
        return beam_set(self.calibration, measured, known_mm, mounting)

    def _measured(self, spots_px: FloatArray) -> Measurement:
        targets = self.calibration.targets
        points = [target.point(*spot.tolist()) for target, spot in zip(targets, spots_px, strict=True)]
        known = [point for point in points if point is not None]
        mean = MeanSpots(tuple(Z_MM), spots_px, SCATTER_PX**2 * np.eye(4), 0, 1, 0)
        beam = fit_beam(list(Z_MM.values()), known, joint_covariance_mm2(mean, known))
        of_targets = {
            target.name: {"x_mm": Value(point.x_mm), "y_mm": Value(point.y_mm)}
            for target, point in zip(targets, known, strict=True)
        }
        return Measurement(0, 0, None, 1, QUANTITIES, values_of(beam), of_targets)


@dataclass(slots=True)
class Outcome:
    """Numbers of units without and with an error, and how many of them failed.

    ``wrong`` units are wrong by twice the expanded uncertainty; ``expected`` of them fail by the power of the
    tests. ``detectable`` of the same units fail with an error of the smallest detectable size.
    """

    right: int = 0
    false_alarms: int = 0
    wrong: int = 0
    detected: int = 0
    expected: float = 0.0
    detectable: int = 0
    missed: list[str] = field(default_factory=list)


def run(first_seed: int, units: int, wrong_every: int) -> Outcome:
    """Verify units; each ``wrong_every``-th is wrong by 4 combined standard uncertainties of one number."""
    outcome = Outcome()
    for number in range(units):
        unit = VerifiedUnit(first_seed + number)
        before = unit.verified()
        if number % wrong_every:
            outcome.right += 1
            outcome.false_alarms += before.verdict is Result.FAILED
        else:
            kind, sign = KINDS[outcome.wrong % len(KINDS)], 1.0 if outcome.wrong % 2 else -1.0
            test = next(test for test in before.tests if test.key == kind)
            outcome.wrong += 1
            outcome.expected += power(4.0, before.made)
            is_detected, is_detectable = (
                unit.verified(Change(**{kind: sign * (error or 0.0)})).verdict is Result.FAILED
                for error in (4.0 * (test.sigma or 0.0), test.detectable)
            )
            outcome.detected += is_detected
            outcome.detectable += is_detectable
            outcome.missed += [] if is_detected else [kind]
        show(f"{number + 1}/{units} units" if number + 1 < units else "")
    return outcome


def power(error_sigmas: float, tests: int) -> float:
    """Probability that an error in standard uncertainties fails its test, one of ``tests``."""
    normal = NormalDist()
    factor = normal.inv_cdf(1.0 - (1.0 - CONFIDENCE) / (2 * tests))
    return normal.cdf(error_sigmas - factor) + normal.cdf(-error_sigmas - factor)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print."""
    parser = Parser("benchmarks.verification", __doc__)
    parser.count("--units", 200, "without and with an error")
    parser.seed(1000)
    options = parser.parse_args(arguments)
    outcome = run(options.seed, options.units, 10)
    print(
        f"units without an error: {outcome.right}, failed {outcome.false_alarms} "
        f"({100 * outcome.false_alarms / outcome.right:.1f} %, stated at most {100 * (1 - CONFIDENCE):.0f} %)"
    )
    print(
        f"units wrong by twice the expanded uncertainty: {outcome.wrong}, failed {outcome.detected}, "
        f"by the stated power {outcome.expected:.1f}; missed: {', '.join(outcome.missed) or 'none'}"
    )
    print(
        f"the same wrong by the smallest detectable error: failed {outcome.detectable}, "
        f"by the stated power {POWER * outcome.wrong:.1f}"
    )
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.verification")
