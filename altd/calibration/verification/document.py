"""A verification as plain JSON types, and its comparison with an earlier one (docs/verify.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, ValidationError

from altd import __version__
from altd.calibration.verification.estimate import KEYS, BeamSet, Estimate
from altd.calibration.verification.plates import PlateSet
from altd.calibration.verification.verdict import CONFIDENCE, POWER, Judgement, LimitTest
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import read_file
from altd.records import FloatArray, utc_text

FORMAT: Literal["altd-verification/1"] = "altd-verification/1"
_MAX_BYTES = 1 << 24
_DIGITS = 6
"""Significant digits of a number in the document."""


def head_object(judgement: Judgement, unit: str, created: datetime, is_simulated: bool) -> dict[str, Any]:
    """Verdict, reasons and tests as plain JSON types."""
    return {
        "format": FORMAT,
        "made_by": f"altd {__version__}",
        "created": utc_text(created),
        "unit": unit,
        "origin": "simulated" if is_simulated else "camera",
        "verdict": str(judgement.verdict),
        "reasons": list(judgement.reasons),
        "confidence": CONFIDENCE,
        "power": POWER,
        "tests": [_test_object(test) for test in judgement.tests],
    }


def _test_object(test: LimitTest) -> dict[str, Any]:
    return {
        **{key: _short(value) for key, value in asdict(test).items() if key not in ("parts", "why_not")},
        "parts": {name: _short(sigma) for name, sigma in test.parts.items()},
        "result": str(test.result),
        "why_not": test.why_undecided,
    }


def set_objects(estimate: Estimate) -> list[dict[str, Any]]:
    """Estimated mounting of each set, in the order of the estimate."""
    return [
        {
            "offset_mm": [_short(value) for value in offset],
            "rotation_mrad": _short(rotation),
            "direction_deg": [_short(value) for value in direction],
        }
        for offset, rotation, direction in zip(
            estimate.offsets_mm.tolist(),
            estimate.rotations_mrad.tolist(),
            estimate.directions_deg.tolist(),
            strict=True,
        )
    ]


def residual_objects(one: BeamSet, residuals: FloatArray) -> list[dict[str, Any]]:
    """Measured places of a set, with the residual of each value after the fit."""
    return [
        {
            **dict(zip(("x_mm", "y_mm"), map(_short, values[:2]), strict=True)),
            **{f"d{key}": _short(value) for key, value in zip(KEYS, left, strict=True)},
        }
        for values, left in zip(one.values.tolist(), residuals.tolist(), strict=True)
    ]


def plate_object(target: str, one: PlateSet, errors_mm: FloatArray) -> dict[str, Any]:
    """Plate on a target, and its remaining errors (n, 2) mm."""
    distances_mm = np.linalg.norm(errors_mm, axis=1)
    ratios = errors_mm / np.sqrt(np.diagonal(one.covariance_mm2, axis1=1, axis2=2))
    return {
        "target": target,
        "shift_mm": [_short(value) for value in one.shift_mm.tolist()],
        "positions": one.plate.columns * one.plate.rows,
        "valid": len(one.known_mm),
        "rms_mm": _short(float(np.sqrt(np.mean(np.square(distances_mm))))),
        "max_mm": _short(float(distances_mm.max())),
        "rms_of_sigma": _short(float(np.sqrt(np.mean(np.square(ratios))))),
    }


def plate_residual_objects(number: int, one: PlateSet, errors_mm: FloatArray) -> list[dict[str, Any]]:
    """Known places of a set's discs, with the remaining error of each."""
    return [
        {"set": number, **dict(zip(("x_mm", "y_mm", "dx_mm", "dy_mm"), map(_short, row), strict=True))}
        for row in np.hstack([one.known_mm, errors_mm]).tolist()
    ]


def _short(value: Any) -> Any:
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class _EarlierCalibration(_Model):
    sha256: str


class _EarlierTest(_Model):
    key: str
    value: float | None
    parts: Mapping[str, float]
    degrees_of_freedom: float | None = None


class Earlier(_Model):
    """The part of an earlier verification that a comparison needs; unknown keys are ignored."""

    format: Literal["altd-verification/1"]
    unit: str
    created: AwareDatetime
    verdict: str
    calibration: _EarlierCalibration
    tests: tuple[_EarlierTest, ...]


def read_earlier(path: Path, unit: str) -> Earlier:
    """Read a verification; raises BadInputError if the file is invalid or belongs to another unit."""
    content = read_file(path, _MAX_BYTES)
    try:
        earlier = Earlier.model_validate(parse_json(content))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise BadInputError(
            path, f"is not an output of `altd verify --json`: {place}: {first['msg']}"
        ) from error
    except ValueError as error:
        raise BadInputError(path, f"is not an output of `altd verify --json`: {error}") from error
    if earlier.unit != unit:
        raise BadInputError(path, f"is of unit {earlier.unit!r}, not {unit!r}")
    return earlier


def comparison(earlier: Earlier, tests: Sequence[LimitTest], calibration_sha256: str) -> dict[str, Any]:
    """Compute the change of each tested number since an earlier verification, with its uncertainty.

    The calibration's own limits count if another calibration was verified then. Those of the reference always
    count, since it may be another reference. All changes together have the confidence ``CONFIDENCE``.
    """
    same = earlier.calibration.sha256 == calibration_sha256
    before = {test.key: test for test in earlier.tests}
    pairs = []
    for test in tests:
        old = before.get(test.key)
        if old is None or old.value is None or test.value is None:
            continue
        sigmas = (
            _sigma(old.value, old.parts, old.degrees_of_freedom, same),
            _sigma(test.value, test.parts, test.degrees_of_freedom, same),
        )
        pairs.append((test, test.value, old.value, math.hypot(*sigmas)))
    factor = NormalDist().inv_cdf(1.0 - (1.0 - CONFIDENCE) / (2 * max(len(pairs), 1)))
    changes = [
        {
            "key": test.key,
            "name": test.name,
            "unit": test.unit,
            "decimals": test.decimals,
            "before": old,
            "now": _short(new),
            "change": _short(new - old),
            "sigma": _short(sigma),
            "limit": _short(factor * sigma),
            "changed": abs(new - old) > factor * sigma,
        }
        for test, new, old, sigma in pairs
    ]
    return {
        "created": utc_text(earlier.created),
        "verdict": earlier.verdict,
        "same_calibration": same,
        "changed": any(change["changed"] for change in changes),
        "changes": changes,
    }


def _sigma(
    value: float, parts: Mapping[str, float], degrees_of_freedom: float | None, same_calibration: bool
) -> float:
    """Standard uncertainty of one of the two numbers of a change."""
    if degrees_of_freedom is not None:
        return abs(value) / math.sqrt(2.0 * max(degrees_of_freedom, 1.0))
    return math.hypot(
        *(sigma for name, sigma in parts.items() if not (same_calibration and name == "calibration"))
    )
