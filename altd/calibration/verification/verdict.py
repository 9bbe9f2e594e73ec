"""Tests of a verification at a stated confidence, and the smallest error that each one detects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from statistics import NormalDist

from altd.calibration.verification.estimate import Estimate, Estimated, Scatter
from altd.records import Limits
from altd.records.limits import NO_LIMITS

CONFIDENCE = 0.95
"""Probability that a unit without an error passes all tests together."""
POWER = 0.95
"""Probability with which an error of the stated smallest detectable size fails its test."""
MIN_DEGREES_OF_FREEDOM = 8.0
"""Minimum for a test; with fewer, a standard deviation is noticed only from 1.6 times the stated one on."""
STATED_DEGREES_OF_FREEDOM = 45.0
"""Degrees of freedom of the stated standard deviation: those left by a map from the usual 6 × 5 nodes."""

_DEG_PER_MM_PER_M = math.degrees(1e-3)
_NORMAL = NormalDist()


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
    made, for the reason in ``why_not``. ``is_optional``: whether a verification can pass without it.
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
    is_optional: bool = False

    @property
    def result(self) -> Result:
        """Result of the test; not decided without a value or a limit."""
        if self.value is None or self.limit is None:
            return Result.NOT_DECIDED
        return Result.PASSED if abs(self.value) <= self.limit else Result.FAILED


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict, its reasons where it is not ``passed``, and all tests."""

    verdict: Result
    reasons: tuple[str, ...]
    tests: tuple[LimitTest, ...]

    @property
    def made(self) -> int:
        """Number of tests made."""
        return sum(test.limit is not None for test in self.tests)


def judge(
    estimate: Estimate, reference: Limits | None, calibration: Limits, further_reasons: Sequence[str] = ()
) -> Judgement:
    """Test an estimate against the limits of the reference and of the unit's calibration.

    ``reference`` None: it states no limits, and nothing is tested. A limit that the calibration does not
    state counts as 0. ``further_reasons`` against a decision are added to those of the tests; they do not
    prevent a failure. Each of m tests has the confidence 1 - (1 - ``CONFIDENCE``)/m (Bonferroni).
    """
    planned = [
        *_of_scatter(estimate, reference),
        *_of_shape(estimate, reference or NO_LIMITS, calibration),
        *_of_zero(estimate, reference or NO_LIMITS, calibration),
    ]
    why = ""
    if reference is None:
        why = "the uncertainty of the reference is unknown: its header states no limits"
        planned = [replace(test, why_not=why) for test in planned]
    made = sum(not test.why_not for test in planned)
    tests = tuple(test if test.why_not else _with_limit(test, made) for test in planned)
    failed = [f"{test.name} is beyond its limit" for test in tests if test.result is Result.FAILED]
    if failed:
        return Judgement(Result.FAILED, tuple(failed), tests)
    missing = [f"{test.name}: {test.why_not}" for test in tests if test.why_not and not test.is_optional]
    reasons = (*further_reasons, *([why] if why else missing))
    return Judgement(Result.NOT_DECIDED if reasons else Result.PASSED, reasons, tests)


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
            why_not=_why_no_scatter(scatter, unstated and unit == " mm"),
        )
        for key, name, unit, decimals, scatter in names
    ]  # fmt: skip


def _why_no_scatter(scatter: Scatter, is_unstated: bool) -> str:
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
    parts = {
        "measurements": found.sigma,
        "reference": of_reference or 0.0,
        "calibration": of_calibration or 0.0,
    }
    why_not = "" if of_reference is not None else f"the reference's limits do not state {limit}"
    return replace(test, value=found.value, sigma=math.hypot(*parts.values()), parts=parts, why_not=why_not)


def _of_zero(estimate: Estimate, reference: Limits, calibration: Limits) -> list[LimitTest]:
    """Tests of the zero of yaw and pitch: by both orientations, else by a beam of stated direction."""
    normal = (calibration.beam_normal_mm_per_m or 0.0) * _DEG_PER_MM_PER_M
    both = estimate.zero_deg
    stated = reference.beam_normal_mm_per_m
    of_reference = 0.0 if both or stated is None else stated * _DEG_PER_MM_PER_M
    found = both or estimate.upright_deg
    why_not = ""
    if both is None and stated is None:
        why_not = (
            "needs a set with the unit turned by 180°, or beam_normal_mm_per_m in the reference's limits"
        )
    elif found is None:
        why_not = "needs a set with the unit not turned"
    tests = []
    for number, (key, name) in enumerate(
        (("zero_yaw_deg", "zero of yaw"), ("zero_pitch_deg", "zero of pitch"))
    ):
        one = None if found is None else found[number]
        parts = {
            "measurements": 0.0 if one is None else one.sigma,
            "reference": of_reference,
            "calibration": normal,
        }
        tests.append(
            LimitTest(
                key, name, "°", 4, None if one is None else one.value, math.hypot(*parts.values()), parts,
                why_not=why_not, is_optional=True,
            )
        )  # fmt: skip
    return tests


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
