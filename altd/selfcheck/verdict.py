"""The verdict of one check: LEDs on and off against the calibration (thesis 3.4, docs/selfcheck.md)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from altd.measuring.calibration import Calibration
from altd.records import Value
from altd.selfcheck.compensation import WorstEffect, beam_effects, place_effect, worst_effect
from altd.selfcheck.drift import drift_of
from altd.selfcheck.records import LedState, LedView, Limits, PartVerdict, SelfCheck, TargetDrift, Verdict

NOT_LOOKED_AT = "no frames with the LEDs on and off"
SIGNIFICANT = 7.0
"""The Mahalanobis distance from which a drift is none of chance: 6 in 10⁹ with four degrees of freedom, and
still below 1 in 10,000 where the noise is known to 15 % only (``benchmarks.selfcheck places``)."""
_SIGMAS = 3.0
"""A limit must be so many sigmas away from what is not seen, for the verdict to be good."""
_ORDER = (Verdict.GOOD, Verdict.UNKNOWN, Verdict.SUSPECT, Verdict.BAD)


def judge(
    views: Mapping[str, LedView],
    calibration: Calibration,
    at: Mapping[str, tuple[float, float]] | None,
    limits: Limits,
    *,
    previous: Verdict | None = None,
    reference_plane_mm: float = 0.0,
) -> SelfCheck:
    """The state of the unit's geometry, from LEDs on and off by target. Pure; takes 10 to 50 ms a target.

    ``at`` is where the spots are now, (u, v) px by target, uncorrected; of a target that is not in it, or
    without it, the middle of the calibrated area counts. ``previous`` is, for the hysteresis, the last
    verdict that was not unknown: after a bad one a check that sees only a part is unknown, unless that
    part is bad. ``reference_plane_mm`` is the plane of x and y. A target of the calibration that is not in
    ``views`` makes the verdict unknown, as does one without LED references; a view of a target that the
    calibration does not know raises KeyError, frames of another size ValueError.
    """
    known = {target.name: target for target in calibration.targets}
    seen = {name: drift_of(name, view, known[name], limits) for name, view in views.items()}
    drifts = {
        name: seen.get(name) or TargetDrift(name, len(known[name].leds_px), 0, (), detail=NOT_LOOKED_AT)
        for name in known
    }
    worst = {
        name: worst_effect(known[name], drift.similarity)
        for name, drift in drifts.items()
        if drift.similarity is not None
    }
    parts = [
        opinion
        for name, drift in drifts.items()
        for opinion in _of_target(drift, worst.get(name), limits, previous)
    ]
    if len(worst) >= 2:
        z_mm = [known[name].z_mm for name in worst]
        significant = any(_is_significant(drifts[name]) for name in worst)
        parts.append(
            _of_direction(list(worst.values()), max(z_mm) - min(z_mm), significant, limits, previous)
        )
    parts.sort(key=lambda opinion: -_ORDER.index(opinion.verdict))
    verdict = parts[0].verdict
    is_whole = all(opinion.verdict is not Verdict.UNKNOWN for opinion in parts)
    if verdict is Verdict.SUSPECT and not is_whole and previous is Verdict.BAD:
        verdict = Verdict.UNKNOWN  # the hidden LEDs may be those that were bad
    return SelfCheck(
        verdict=verdict,
        targets=drifts,
        effects=_effects(drifts, calibration, at or {}, reference_plane_mm),
        reasons=tuple(opinion.reason for opinion in parts if opinion.verdict is not Verdict.GOOD),
        is_whole=is_whole,
        parts=tuple(parts),
    )


def _effects(
    drifts: Mapping[str, TargetDrift],
    calibration: Calibration,
    at: Mapping[str, tuple[float, float]],
    reference_plane_mm: float,
) -> Mapping[str, Value]:
    """By the beam's keys; empty unless every target of two or more was judged."""
    places = []
    for target in calibration.targets:
        drift = drifts[target.name]
        if drift.similarity is None:
            return {}
        places.append(place_effect(target, drift.similarity, at.get(target.name)))
    if len(places) < 2:
        return {}
    return beam_effects([target.z_mm for target in calibration.targets], places, reference_plane_mm)


def _of_target(
    drift: TargetDrift, worst: WorstEffect | None, limits: Limits, previous: Verdict | None
) -> Iterator[PartVerdict]:
    """The effect of one target's drift; where its LEDs contradict each other, that and the unknown part."""
    name = drift.target
    bounds = (limits.suspect_mm, limits.bad_mm)
    if worst is None:
        yield PartVerdict(name, Verdict.UNKNOWN, f"{name}: {drift.detail}", "mm", None, None, *bounds)
        return
    opinion = _against(
        name,
        f"{name}: the picture moved by up to",
        ("mm", worst, *bounds),
        (_is_significant(drift), limits, previous),
    )
    displaced = LedState.DISPLACED in drift.leds
    contradicts = (not drift.is_similarity or displaced) and opinion.verdict is not Verdict.BAD
    if contradicts:
        yield replace(opinion, verdict=Verdict.SUSPECT, reason=f"{name}: {drift.detail}")
    if not contradicts or opinion.verdict is Verdict.UNKNOWN:
        yield opinion


def _of_direction(
    worst: list[WorstEffect], distance_mm: float, significant: bool, limits: Limits, previous: Verdict | None
) -> PartVerdict:
    """The effect of the drifts of all targets on yaw and pitch, wherever the beam meets each of them."""
    error = sum(effect.error_mm for effect in sorted(worst, key=lambda effect: -effect.error_mm)[:2])
    sigma = math.hypot(*(effect.sigma_mm for effect in worst))
    turned = WorstEffect(math.degrees(error / distance_mm), math.degrees(sigma / distance_mm))
    bounds = (limits.suspect_deg, limits.bad_deg)
    what = "yaw or pitch are off by up to"
    return _against("yaw, pitch", what, ("°", turned, *bounds), (significant, limits, previous))


def _against(
    of: str,
    what: str,
    figures: tuple[str, WorstEffect, float, float],
    state: tuple[bool, Limits, Verdict | None],
) -> PartVerdict:
    """An error and its sigma against (suspect, bad); a verdict once reached ends below a share of it."""
    significant, limits, previous = state
    unit, worst, suspect, bad = figures
    certain = suspect / _SIGMAS
    if previous is Verdict.BAD:
        bad *= limits.release_share
    if previous in (Verdict.SUSPECT, Verdict.BAD):
        suspect *= limits.release_share
    error, sigma = worst.error_mm, worst.sigma_mm
    reason = f"{what} {error:.3f} {unit}, known to {sigma:.3f} {unit}"
    verdict = Verdict.GOOD
    if significant and error > bad:
        verdict = Verdict.BAD
    elif significant and error > suspect:
        verdict = Verdict.SUSPECT
    elif error > suspect or sigma > certain:
        verdict, reason = Verdict.UNKNOWN, f"{reason}: too uncertain to tell"
    return PartVerdict(of, verdict, reason, unit, error, sigma, suspect, bad)


def _is_significant(drift: TargetDrift) -> bool:
    return drift.significance is not None and drift.significance > SIGNIFICANT
