"""``python -m benchmarks.selfcheck``: detected drift, rate of false alarms, and corrections.

False alarms are counted twice. With pictures: checks of simulated units that are unchanged since their
calibration; each calibration has its own LED references, because they are the same in all its checks. With
positions alone, many more: LEDs with Gaussian noise through fit and test.
"""

import math
from collections import Counter

import numpy as np

from altd.measuring.calibration import Calibration
from altd.records import FloatArray
from altd.selfcheck.drift import chi2_limit, fit_similarity
from altd.selfcheck.history import DAY_S, History
from altd.selfcheck.records import LedState, Limits, SelfCheck, Similarity, TargetDrift, Verdict
from altd.selfcheck.verdict import SIGNIFICANT, Compensation, compensation_of, judge
from benchmarks.harness import Parser, end
from benchmarks.selfcheck_units import TIGHT, WIDE, CheckedUnit, calibrated
from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.measure import random_poses
from hw_sim.unit import CAMERAS

LED_NOISE_PX = 0.0055
"""Noise of one pair of hw_sim at 1000 lux, per axis."""
PAIRS = 2
CHECKS_A_CALIBRATION = 25
PX_A_DAY = 0.02
MISFIT_SIGMAS = 4.5
MISFIT_MM = 0.25 * 0.03
MM_PER_PX = 0.28
POSES = 40
MOVED_PX, TURNED_DEG = 0.6, 0.1


def detection(seed: int, checks: int) -> None:
    """Detect 0.3 px and 0.05° of either camera, with all LEDs, and with one dark and the border LEDs cut."""
    for name, field_half_mm, levels in (
        ("all LEDs", WIDE, (1.0,) * 6),
        ("one dark, others cut", TIGHT, (0.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
    ):
        calibration = calibrated(seed, field_half_mm)
        checked = CheckedUnit(seed, field_half_mm)
        for camera in CAMERAS:
            checked.unit.set_lights(camera, levels)
        for what, shift_px, turn_deg in (("0.3 px", 0.3, 0.0), ("0.05°", 0.0, 0.05), ("nothing", 0.0, 0.0)):
            _detect(f"{what}, {name}", checked, calibration, (shift_px, turn_deg), checks)


def _detect(
    what: str, checked: CheckedUnit, calibration: Calibration, drift: tuple[float, float], checks: int
) -> None:
    rng = np.random.default_rng(1)
    verdicts: Counter[str] = Counter()
    states: Counter[str] = Counter()
    significances = []
    for number in range(checks):
        camera = CAMERAS[number % 2]
        angle = rng.uniform(0, 2 * math.pi)
        shift = (drift[0] * math.cos(angle), drift[0] * math.sin(angle))
        checked.unit.displace(camera, Displacement(shift, drift[1]))
        check = judge(checked.views(PAIRS), calibration, None, Limits())
        checked.unit.displace(camera, Displacement())
        verdicts[str(check.verdict)] += 1
        states.update(str(state) for state in check.targets[camera].leds if state is not LedState.USED)
        significances.append(check.targets[camera].significance or 0.0)
    print(
        f"{what}: {dict(verdicts)}; LEDs not used {dict(states)}; significance {min(significances):.1f} "
        f"to {max(significances):.1f}, limit {SIGNIFICANT:g}",
        flush=True,
    )


def false_alarms(seed: int, checks: int) -> None:
    """Check an unchanged unit, with pictures, the beam anywhere."""
    of_unit = calibrated(seed)
    checked = CheckedUnit(seed)
    rng = np.random.default_rng([seed, 2])
    poses = random_poses(checks, 280.0, rng)
    verdicts: Counter[str] = Counter()
    squares: list[float] = []
    calibration = of_unit
    for number, pose in enumerate(poses):
        if number % CHECKS_A_CALIBRATION == 0:
            checked.unit.place(BeamPose(0.0, 0.0))
            calibration = checked.with_new_references(of_unit)
        checked.unit.place(pose)
        check = judge(checked.views(PAIRS), calibration, None, Limits())
        verdicts[str(check.verdict)] += 1
        squares += [(drift.significance or 0.0) ** 2 for drift in check.targets.values()]
    print(
        f"nothing moved, {checks} checks with pictures, references new every {CHECKS_A_CALIBRATION}: "
        f"{dict(verdicts)}; mean χ² {np.mean(squares):.2f} of 4, largest significance "
        f"{math.sqrt(max(squares)):.2f}, limit {SIGNIFICANT:g}",
        flush=True,
    )


def false_alarms_of_places(checks: int) -> None:
    """Run the fit and its tests alone, for positions with Gaussian noise; the sigma is known to 15 %."""
    rng = np.random.default_rng(3)
    references = np.array([(120, 66), (372, 24), (645, 62), (122, 400), (375, 453), (648, 422)], dtype=float)
    about = references.mean(axis=0)
    radius = float(np.sqrt(np.mean(np.sum((references - about) ** 2, axis=1))))
    sigma = LED_NOISE_PX * math.sqrt(0.5 + 0.5)
    significant = misfits = alarms = 0
    largest = 0.0
    for _ in range(checks):
        then = references + rng.normal(0, LED_NOISE_PX / math.sqrt(2), references.shape)
        now = references + rng.normal(0, LED_NOISE_PX / math.sqrt(2), references.shape)
        claimed = np.full(6, sigma * rng.normal(1.0, 0.15))
        fitted = fit_similarity(then, now, claimed, about, radius)
        vector = fitted.similarity.vector
        distance = math.sqrt(float(vector @ np.linalg.solve(fitted.similarity.covariance, vector)))
        largest = max(largest, distance)
        significant += distance > SIGNIFICANT
        is_misfit = fitted.chi2 > chi2_limit(fitted.degrees_of_freedom, MISFIT_SIGMAS)
        misfits += is_misfit
        moved = np.abs(fitted.similarity.now_px(references) - references).max() * MM_PER_PX
        left = np.hypot(*fitted.residuals_px.T).max() * MM_PER_PX
        alarms += (distance > SIGNIFICANT and moved > Limits().suspect_mm) or (is_misfit and left > MISFIT_MM)
    print(
        f"nothing moved, {checks} checks by places: {significant} significant (largest {largest:.2f}), "
        f"{misfits} misfits, {alarms} that reach the limits in mm",
        flush=True,
    )


def slow_drifts(calibrations: int, days: int) -> None:
    """Test a drift of 0.02 px a day, and none, through the history: one check a day, and 24."""
    rng = np.random.default_rng(4)
    for checks_a_day in (1, 24):
        found = [_day_found(rng, PX_A_DAY, checks_a_day, 15) for _ in range(calibrations)]
        alarms = sum(_day_found(rng, 0.0, checks_a_day, days) is not None for _ in range(calibrations))
        known = [day for day in found if day is not None]
        print(
            f"{PX_A_DAY} px and {checks_a_day} checks a day: found in {len(known)} of {calibrations} after "
            f"{np.mean(known):.1f} days, {max(known)} at most; no drift: {alarms} alarms in "
            f"{calibrations * days * checks_a_day} checks ({calibrations} calibrations)",
            flush=True,
        )


def _day_found(rng: np.random.Generator, px_a_day: float, checks_a_day: int, days: int) -> int | None:
    """Day on which a drift in one direction is reported; None if never."""
    radius = 330.0
    sigma = np.array([1.0, 1.0, math.degrees(1 / radius), 1e6 / radius]) * LED_NOISE_PX / math.sqrt(6)
    angle = rng.uniform(0, 2 * math.pi)
    offset = rng.normal(0, sigma / math.sqrt(2))
    covariance = np.diag(sigma**2 * (1 / 2 + 1))
    history = History.empty()
    for hour in range(days * checks_a_day):
        day = hour / checks_a_day
        found = offset + rng.normal(0, sigma / math.sqrt(PAIRS))
        found[:2] += px_a_day * day * np.array([math.cos(angle), math.sin(angle)])
        history = history.with_check(_check_of(found, covariance, radius), day * DAY_S)
        if history.slow_drifts:
            return math.ceil(day)
    return None


def _check_of(vector: FloatArray, covariance: FloatArray, radius: float) -> SelfCheck:
    u, v, turn, scale = vector.tolist()
    similarity = Similarity((375.0, 240.0), (u, v), turn, scale, covariance, radius)
    drift = TargetDrift("front", 6, 6, (LedState.USED,) * 6, similarity=similarity, rms_px=0.0)
    return SelfCheck(Verdict.GOOD, {"front": drift}, {})


def correction(seed: int) -> None:
    """Compare the same beams with 0.6 px and 0.1° of either camera, corrected, and without a drift."""
    calibration = calibrated(seed)
    checked = CheckedUnit(seed, exact=True)
    rng = np.random.default_rng([seed, 5])
    poses = random_poses(POSES, 280.0, rng)
    normal, normal_sigma = checked.measured(calibration, poses, None)
    _say(f"unit {seed}, as calibrated", normal, normal_sigma, normal)
    for camera in CAMERAS:
        angle = rng.uniform(0, 2 * math.pi)
        shift = (MOVED_PX * math.cos(angle), MOVED_PX * math.sin(angle))
        checked.unit.displace(camera, Displacement(shift, TURNED_DEG))
        left, left_sigma = checked.measured(calibration, poses, None)
        _say(f"unit {seed}, {camera} moved", left, left_sigma, normal)
        found = compensation_of(
            judge(checked.views(PAIRS), calibration, None, Limits()), calibration, Limits()
        )
        if not isinstance(found, Compensation):
            raise RuntimeError(found.detail)
        errors, sigmas = checked.measured(calibration, poses, found)
        _say(f"unit {seed}, {camera} moved and corrected", errors, sigmas, normal)
        checked.unit.displace(camera, Displacement())


def _say(what: str, errors: FloatArray, sigmas: FloatArray, normal: FloatArray) -> None:
    rms, usual = (np.sqrt(np.nanmean(e**2, axis=0)) for e in (errors, normal))
    ratio = np.sqrt(np.nanmean((errors / sigmas) ** 2))
    print(
        f"{what}: rms x {rms[0]:.4f} y {rms[1]:.4f} mm yaw {rms[2]:.5f} pitch {rms[3]:.5f}°, "
        f"yaw and pitch {np.sqrt(np.mean(rms[2:] ** 2) / np.mean(usual[2:] ** 2)):.2f} × normal, "
        f"rms(error/sigma) {ratio:.2f}, {np.isnan(errors[:, 0]).sum()} not measured",
        flush=True,
    )


def main() -> int:
    """Run and print the requested parts."""
    parser = Parser("benchmarks.selfcheck", __doc__)
    parser.add_argument("what", choices=("detection", "alarms", "places", "history", "correction"))
    parser.seed(3)
    parser.count("--checks", 40, "of each unit, or calibrations of the history")
    options = parser.parse_args()
    if options.what == "detection":
        detection(options.seed, options.checks)
    elif options.what == "alarms":
        false_alarms(options.seed, options.checks)
    elif options.what == "places":
        false_alarms_of_places(options.checks)
    elif options.what == "history":
        slow_drifts(options.checks, 200)
    else:
        correction(options.seed)
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.selfcheck")
