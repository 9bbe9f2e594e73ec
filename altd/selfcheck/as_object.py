"""A check as plain JSON types (docs/selfcheck.md)."""

from __future__ import annotations

from typing import Any

from altd.selfcheck.records import SelfCheck, TargetDrift

_DECIMALS = {"x_mm": 4, "y_mm": 4, "yaw_deg": 5, "pitch_deg": 5}
_KEYS = ("yaw_deg", "pitch_deg", "x_mm", "y_mm")


def as_object(check: SelfCheck) -> dict[str, Any]:
    """What ``altd selfcheck`` answers; what is not known is null."""
    effects = check.effects
    values = {key: round(effects[key].value, _DECIMALS[key]) if key in effects else None for key in _KEYS}
    sigmas = {key: effects[key].sigma if key in effects else None for key in _KEYS}
    return {
        "verdict": str(check.verdict),
        "reasons": list(check.reasons),
        "targets": {name: _of_target(drift) for name, drift in check.targets.items()},
        **values,
        "sigma": {
            key: None if sigma is None else round(sigma, _DECIMALS[key]) for key, sigma in sigmas.items()
        },
    }


def _of_target(drift: TargetDrift) -> dict[str, Any]:
    fitted = drift.similarity
    return {
        "leds_expected": drift.leds_expected,
        "leds_found": drift.leds_found,
        "shift_px": None if fitted is None else [round(part, 4) for part in fitted.shift_px],
        "turn_deg": None if fitted is None else round(fitted.turn_deg, 5),
        "scale_ppm": None if fitted is None else round(fitted.scale_ppm, 1),
        "rms_px": None if drift.rms_px is None else round(drift.rms_px, 4),
        "significance": None if drift.significance is None else round(drift.significance, 2),
        "is_similarity": None if fitted is None else drift.is_similarity,
        "leds": [str(state) for state in drift.leds],
        "foreign_px": [[round(u, 1), round(v, 1)] for u, v in drift.foreign_px],
        "detail": drift.detail,
    }
