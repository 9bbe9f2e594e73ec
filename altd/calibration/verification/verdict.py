"""Tests of a verification: the smallest error that each detects, and the decision on the requirement.

A test of agreement compares the unit with the uncertainty that it states. It is decided only if it would find
an error that alone uses up the requirement. The requirement itself is decided by guarded acceptance and
guarded rejection (JCGM 106:2012, 8.3.2 and 8.3.3) with a guard band of the expanded uncertainty, k = 2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from statistics import NormalDist

from altd.calibration.verification.estimate import Estimate, Estimated, Scatter
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M
from altd.records import Limits
from altd.records.limits import NO_LIMITS

CONFIDENCE = 0.95
"""Probability that a unit without an error fails no test of agreement."""
POWER = 0.95
"""Probability with which an error of the stated smallest detectable size fails its test."""
MIN_DEGREES_OF_FREEDOM = 8.0
"""Minimum for a test; with fewer, a standard deviation is noticed only from 1.6 times the stated one on."""
STATED_DEGREES_OF_FREEDOM = 45.0
"""Degrees of freedom of the stated standard deviation: those left by a map from the usual 6 × 5 nodes."""

COVERAGE = 2.0
"""Coverage factor of a guard band, and of a unit's scatter within its greatest error."""
REQUIRED = 1.0
"""Greatest error that the requirement permits: mm of a displacement, mm/m of a slope (thesis, App. A.1)."""
_DEG_PER_MM_PER_M = math.degrees(1e-3)
_NORMAL = NormalDist()


def _angle_effects(axis: str, limit_mm_per_m: float) -> dict[str, float]:
    """Effects on a slope, mm/m, at the end of its range; an angle counts by 1 + slope² there."""
    per_deg = (1.0 + (1e-3 * limit_mm_per_m) ** 2) / _DEG_PER_MM_PER_M
    ends = {f"zero_{axis}_deg": per_deg, f"scale_{axis}_ppm": 1e-6 * limit_mm_per_m}
    return {**ends, "standard_deviation_deg": COVERAGE * per_deg}


_EFFECTS = {
    "x_mm": {"scale_x_ppm": 70e-6, "square_mrad": 55e-3 / 2, "standard_deviation_mm": COVERAGE},
    "y_mm": {"scale_y_ppm": 55e-6, "square_mrad": 70e-3 / 2, "standard_deviation_mm": COVERAGE},
    "yaw_mm_per_m": _angle_effects("yaw", MAX_YAW_MM_PER_M),
    "pitch_mm_per_m": _angle_effects("pitch", MAX_PITCH_MM_PER_M),
}
"""Effect of each tested number on the greatest error of each quantity, within 140 × 110 mm and its range."""
_REMEDIES = {
    "zero calibration": "calibrate with a second scan, the unit turned",
    "zero reference": "state the seat, or the beam's direction, better",
    "calibration": "calibrate with smaller limits",
    "reference": "use a reference that is known better",
}
"""Remedy for too little power, by the largest part of the uncertainty; of measurements: more of them."""


class Result(StrEnum):
    """Result of a test, or of all tests."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_DECIDED = "not decided"


@dataclass(frozen=True, slots=True)
class LimitTest:
    """One number and its limits.

    ``sigma`` is the combined standard uncertainty of ``value``, with its parts by origin in ``parts``; for an
    experimental standard deviation it is the stated one. The test fails if the magnitude of ``value`` exceeds
    ``limit``; an error of ``detectable`` fails with probability ``POWER``. Both are None if the test was not
    made, for the reason in ``why_not``. ``required`` is the error that the requirement permits, of a test of
    agreement that which alone would use it up. A test that passes although it cannot detect that is not
    decided. A greatest error has no ``detectable``: up to ``limit`` it is within the requirement, from
    ``rejection`` on it is not, between them nothing is decided.
    """

    key: str
    name: str
    unit: str
    decimals: int
    value: float | None = None
    sigma: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    limit: float | None = None
    detectable: float | None = None
    degrees_of_freedom: float | None = None
    why_not: str = ""
    required: float | None = None
    rejection: float | None = None

    @property
    def result(self) -> Result:
        """Result of the test; not decided without a value, a limit or the necessary power."""
        if self.value is None or self.limit is None:
            return Result.NOT_DECIDED
        if abs(self.value) > (self.limit if self.rejection is None else self.rejection):
            return Result.FAILED
        return Result.NOT_DECIDED if self.why_undecided else Result.PASSED

    @property
    def why_undecided(self) -> str:
        """Reason why a value that does not fail decides nothing; empty if there is none."""
        if self.why_not or self.value is None or self.limit is None or self.required is None:
            return self.why_not
        required = f"required is {self._text(self.required)}"
        if self.detectable is not None and self.detectable > self.required:
            largest = max(self.parts, key=lambda part: self.parts[part])
            by_more = "measure more positions, angles by a larger deflection"
            remedy = _REMEDIES.get(f"{self.key[:4]} {largest}") or _REMEDIES.get(largest, by_more)
            return f"cannot detect less than {self._text(self.detectable)}, {required}: {remedy}"
        if self.rejection is not None and abs(self.value) > self.limit:
            return f"{self._text(self.value)} is within its expanded uncertainty of the limit, {required}"
        return ""

    @property
    def own_sigma(self) -> float:
        """Standard uncertainty with which the unit's error is known, whatever the unit states about it."""
        if self.degrees_of_freedom is not None:
            return (self.value or 0.0) / math.sqrt(2.0 * self.degrees_of_freedom)
        return math.hypot(self.parts["measurements"], self.parts["reference"])

    def _text(self, number: float) -> str:
        return f"{number:.{self.decimals}f}{self.unit}"


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict, its reasons where it is not ``passed``, and all tests."""

    verdict: Result
    reasons: tuple[str, ...]
    tests: tuple[LimitTest, ...]

    @property
    def agreement(self) -> tuple[LimitTest, ...]:
        """Tests against the stated uncertainty, without the greatest errors."""
        return tuple(test for test in self.tests if test.rejection is None)

    @property
    def made(self) -> int:
        """Number of tests of agreement made."""
        return sum(test.limit is not None for test in self.agreement)


def judge(
    estimate: Estimate, reference: Limits | None, calibration: Limits, further_reasons: Sequence[str] = ()
) -> Judgement:
    """Test an estimate against the limits of reference and calibration, and against the requirement.

    ``reference`` None: it states no limits, and nothing is tested. A limit that the calibration does not
    state counts as 0. ``further_reasons`` against a decision are added to those of the tests; they do not
    prevent a failure. Each of m tests has the confidence 1 - (1 - ``CONFIDENCE``)/m (Bonferroni).
    """
    planned = [
        *_of_scatter(estimate, reference),
        *_of_shape(estimate, reference or NO_LIMITS, calibration),
        *_of_zero(estimate, reference or NO_LIMITS, calibration),
        *_of_angles(estimate, reference or NO_LIMITS, calibration),
    ]
    planned = [replace(test, required=_required(test.key, estimate.stated_distance_mm)) for test in planned]
    why = ""
    if reference is None:
        why = "the uncertainty of the reference is unknown: its header states no limits"
        planned = [replace(test, why_not=why) for test in planned]
    agreement = _with_limits(planned)
    missing = (why,) if why else None
    return _decided((*agreement, *_greatest_errors(agreement)), further_reasons, missing)


def judge_agreement(planned: Sequence[LimitTest], further_reasons: Sequence[str]) -> Judgement:
    """Decide by tests of agreement alone, as ``judge`` does; they have no limits yet."""
    return _decided(tuple(_with_limits(planned)), further_reasons)


def _with_limits(planned: Sequence[LimitTest]) -> list[LimitTest]:
    made = sum(not test.why_not for test in planned)
    return [test if test.why_not else _with_limit(test, made) for test in planned]


def _decided(
    tests: tuple[LimitTest, ...], further_reasons: Sequence[str], missing: Sequence[str] | None = None
) -> Judgement:
    """Return the verdict; ``missing`` replaces the reasons of tests that decide nothing."""
    failed = [f"{test.name} is beyond its limit" for test in tests if test.result is Result.FAILED]
    if failed:
        return Judgement(Result.FAILED, tuple(failed), tests)
    if missing is None:
        missing = [f"{test.name}: {test.why_undecided}" for test in tests if test.why_undecided]
    reasons = (*further_reasons, *missing)
    return Judgement(Result.NOT_DECIDED if reasons else Result.PASSED, reasons, tests)


def _required(key: str, distance_mm: float) -> float:
    """Error of a tested number that alone uses up the requirement."""
    if key == "target_distance_mm":
        return REQUIRED * distance_mm / MAX_PITCH_MM_PER_M
    return REQUIRED / max(effects.get(key, 0.0) for effects in _EFFECTS.values())


def _greatest_errors(agreement: Sequence[LimitTest]) -> Iterator[LimitTest]:
    """Yield the greatest error of each quantity against the requirement, where all its numbers were found.

    Its uncertainty is that of the verification alone: the calibration's does not change what was found.
    """
    numbers = {test.key: (test.value, test.own_sigma) for test in agreement if test.limit is not None}
    for key, effects in _EFFECTS.items():
        if effects.keys() <= numbers.keys():
            value = sum(effect * abs(numbers[of][0] or 0.0) for of, effect in effects.items())
            sigma = math.hypot(*(effect * numbers[of][1] for of, effect in effects.items()))
            name, unit = key.split("_", 1)
            test = LimitTest(f"error_{key}", f"greatest error of {name}", f" {unit.replace('_per_', '/')}", 3)
            limit, rejection = REQUIRED - COVERAGE * sigma, REQUIRED + COVERAGE * sigma
            yield replace(test, value=value, sigma=sigma, limit=limit, required=REQUIRED, rejection=rejection)


def _of_scatter(estimate: Estimate, reference: Limits | None) -> list[LimitTest]:
    names = (
        ("standard_deviation_mm", "standard deviation of x, y", " mm", 4, estimate.displacement),
        ("standard_deviation_deg", "standard deviation of yaw, pitch", "°", 4, estimate.direction),
    )
    unstated = reference is not None and reference.stage_mm is None
    return [
        LimitTest(
            key, name, unit, decimals, scatter.experimental, scatter.stated, {"stated": scatter.stated},
            degrees_of_freedom=scatter.degrees_of_freedom,
            why_not=why_no_scatter(scatter, unstated and unit == " mm"),
        )
        for key, name, unit, decimals, scatter in names
    ]  # fmt: skip


def why_no_scatter(scatter: Scatter, is_unstated: bool) -> str:
    """Return why a standard deviation is not tested; empty if it is."""
    if scatter.degrees_of_freedom < MIN_DEGREES_OF_FREEDOM:
        return (
            f"too few positions: {scatter.degrees_of_freedom:.1f} degrees of freedom, "
            f"at least {MIN_DEGREES_OF_FREEDOM:g} are needed"
        )
    return "the reference's limits do not state stage_mm" if is_unstated else ""


def _of_shape(estimate: Estimate, reference: Limits, calibration: Limits) -> list[LimitTest]:
    along_x, along_y = estimate.scale_ppm
    limits = reference, calibration
    square = LimitTest("square_mrad", "squareness", " mrad", 3)
    return [
        _against(LimitTest("scale_x_ppm", "scale of x", " ppm", 0), along_x, "stage_scale_ppm", limits),
        _against(LimitTest("scale_y_ppm", "scale of y", " ppm", 0), along_y, "stage_scale_ppm", limits),
        _against(square, estimate.square_mrad, "stage_square_mrad", limits),
    ]


def _against(test: LimitTest, found: Estimated, limit: str, limits: tuple[Limits, Limits]) -> LimitTest:
    """Return the test with the found value; its sigma includes this limit of reference and calibration."""
    of_reference, of_calibration = (getattr(of, limit) for of in limits)
    why_not = "" if of_reference is not None else f"the reference's limits do not state {limit}"
    return with_parts(replace(test, why_not=why_not), found, of_reference, of_calibration)


def with_parts(
    test: LimitTest, found: Estimated | None, of_reference: float | None, of_calibration: float | None
) -> LimitTest:
    """Return the test with the found value, if there is one, and its combined uncertainty."""
    if found is None:
        return test
    parts = {
        "measurements": found.sigma,
        "reference": math.hypot(found.reference or 0.0, of_reference or 0.0),
        "calibration": of_calibration or 0.0,
    }
    return replace(test, value=found.value, sigma=math.hypot(*parts.values()), parts=parts)


def _of_zero(estimate: Estimate, reference: Limits, calibration: Limits) -> list[LimitTest]:
    """Tests of the zero of yaw and pitch: by both orientations, else by a beam of stated direction."""
    both, stated = estimate.zero_deg, reference.beam_normal_mm_per_m
    found, why_not = both or estimate.upright_deg or (None, None), ""
    if both is None and stated is None:
        why_not = (
            "needs a set with the unit turned by 180°, or beam_normal_mm_per_m in the reference's limits"
        )
    elif found[0] is None:
        why_not = "needs a set with the unit not turned"
    elif both is not None and found[0].reference is None:
        why_not = "the sets do not state seat_mm_per_m"
    of_beam_deg = 0.0 if both or stated is None else stated * _DEG_PER_MM_PER_M
    calibrated_deg = (calibration.beam_normal_mm_per_m or 0.0) * _DEG_PER_MM_PER_M
    tests = (LimitTest(f"zero_{of}_deg", f"zero of {of}", "°", 4, why_not=why_not) for of in ("yaw", "pitch"))
    return [
        with_parts(test, one, of_beam_deg, calibrated_deg) for test, one in zip(tests, found, strict=True)
    ]


def _of_angles(estimate: Estimate, reference: Limits, calibration: Limits) -> list[LimitTest]:
    """Tests of the scale of yaw and pitch, and of the distance of the targets that follows from it."""
    mm_per_ppm, stated_mm = 1e-6 * estimate.stated_distance_mm, calibration.target_distance_mm or 0.0
    calibrated_ppm = math.hypot(stated_mm / mm_per_ppm, calibration.stage_scale_ppm or 0.0)
    tests = []
    for name, found in zip(("yaw", "pitch"), estimate.angle_scale_ppm, strict=True):
        why_not = _why_no_angle(found, name)
        test = LimitTest(f"scale_{name}_ppm", f"scale of {name}", " ppm", 0, why_not=why_not)
        tests.append(with_parts(test, found, None, calibrated_ppm))
    why_not = _why_no_angle(estimate.distance_mm, "yaw or pitch")
    if not why_not and reference.stage_scale_ppm is None:
        why_not = "the reference's limits do not state stage_scale_ppm"
    test = LimitTest("target_distance_mm", "distance of the targets", " mm", 3, why_not=why_not)
    of_stage_mm = mm_per_ppm * (reference.stage_scale_ppm or 0.0)
    return [*tests, with_parts(test, estimate.distance_mm, of_stage_mm, stated_mm)]


def _why_no_angle(found: Estimated | None, name: str) -> str:
    if found is None:
        return f"needs a set with the beam deflected by a known {name}, after one of that orientation without"
    return "" if found.reference is not None else "the set does not state deflection_sigma_deg"


def _with_limit(test: LimitTest, made: int) -> LimitTest:
    """Return the test with its limit and detectable error, as one of ``made`` tests."""
    share = (1.0 - CONFIDENCE) / made
    if test.sigma is None:
        return test
    if (freedom := test.degrees_of_freedom) is not None:
        high, low = (
            variance_ratio_quantile(probability, freedom, STATED_DEGREES_OF_FREEDOM)
            for probability in (1.0 - share, 1.0 - POWER)
        )
        limit = test.sigma * math.sqrt(high)
        detectable = limit / math.sqrt(low)
    else:
        factor = _NORMAL.inv_cdf(1.0 - share / 2)
        limit, detectable = factor * test.sigma, (factor + _NORMAL.inv_cdf(POWER)) * test.sigma
    return replace(test, limit=limit, detectable=detectable)


def variance_ratio_quantile(probability: float, freedom: float, freedom_below: float) -> float:
    """Quantile of the ratio of two estimates of one variance, Fisher's F, by their degrees of freedom.

    It uses Wilson and Hilferty's cube roots (1931), applied to the ratio by Paulson (1942). It is accurate to
    0.5 % from 8 degrees of freedom on, at probabilities of 0.05 to 0.995.
    """
    above, below = 2.0 / (9.0 * freedom), 2.0 / (9.0 * freedom_below)
    z = _NORMAL.inv_cdf(probability)
    # ((1 - b) y - (1 - a)) / sqrt(b y² + a) = z for the cube root y of the ratio
    square = (1.0 - below) ** 2 - z**2 * below
    inside = above * (1.0 - below) ** 2 + below * (1.0 - above) ** 2 - z**2 * above * below
    return (((1.0 - above) * (1.0 - below) + z * math.sqrt(inside)) / square) ** 3
