"""The content of a calibration as plain JSON types, and the valid areas and names of its targets.

The result is small for any file: texts are cut, and arrays appear as their size or limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from altd.calibration.report.prediction import EXPOSURES, predict
from altd.config import Config
from altd.errors import one_line
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.planar.instrument import QUANTITIES as PLANAR_QUANTITIES
from altd.instruments.planar.instrument import PlanarCalibration
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import utc_text
from altd.status.measurement_json import reserved_names
from altd.status.target_area import TargetArea
from altd.tables import measurement_columns
from altd.vision.fingerprint import Fingerprint


def target_areas_of(config: Config, calibration: Calibration) -> tuple[TargetArea, ...]:
    """Return the valid areas of the config's targets, in beam order."""
    known = [(target, calibration.target(target.name)) for target in config.targets]
    return tuple(
        TargetArea(
            target.name, target.z_mm, tuple((x, y) for x, y in fitted.valid_mm.tolist()), target.camera
        )
        for target, fitted in known
        if fitted is not None
    )


_RESERVED = reserved_names(QUANTITIES)


def why_unusable(name: str) -> str:
    """Return why a target cannot have this name, as the end of a sentence; empty: it can."""
    if name in _RESERVED:
        return "is a key of the measurement in JSON"
    columns = [column.name for column in measurement_columns(QUANTITIES, [name], of_scan=True)]
    twice = [column for column in columns if columns.count(column) > 1]
    return f"makes {twice[0]} of its own, which is a column of the measurement" if twice else ""


MAX_TEXT_CHARACTERS = 300
_DIGITS = 4
_SIGMA_DIGITS = 7
"""Significant digits of a sigma; more than are shown, for rounding twice could differ from the report."""


def summary_of(calibration: Calibration, targets: Iterable[str], name: str) -> dict[str, Any]:
    """Return the calibration of these targets from the file ``name``."""
    chosen = [target for each in targets if (target := calibration.target(each)) is not None]
    of_targets = [_target(target) for target in chosen]
    return {
        **_of_file(calibration, name),
        "expected_sigma": _expected_sigma(calibration),
        "targets": of_targets,
    }


def planar_summary_of(calibration: PlanarCalibration, name: str) -> dict[str, Any]:
    """Return the calibration of a plate from the file ``name``; the sigma is that of the known poses."""
    of_place_mm, of_phi_deg = calibration.rms.get(calibration.fit.camera.model, (math.nan, math.nan))
    keys = (quantity.key for quantity in PLANAR_QUANTITIES.of_unit)
    sigmas = zip(keys, (of_place_mm, of_place_mm, of_phi_deg), strict=True)
    expected = {key: _rounded(sigma, _SIGMA_DIGITS) for key, sigma in sigmas}
    return {**_of_file(calibration, name), "expected_sigma": expected, "targets": []}


def _of_file(calibration: Calibration | PlanarCalibration, name: str) -> dict[str, Any]:
    file = calibration.file
    return {
        "unit": _shown(calibration.unit_serial),
        "created": utc_text(calibration.created),
        "simulated": calibration.simulated,
        "recording": {
            "note": _shown(calibration.recording_note),
            "sha256": _shown(calibration.recording_sha256),
        },
        "file": {
            "name": _shown(name),
            "sha256": None if file is None else file.sha256,
            "checksum": None if file is None else file.checksum,
        },
        "exposures": EXPOSURES,
    }


def _expected_sigma(calibration: Calibration) -> dict[str, float | None]:
    """Return the report's sigma by quantity; empty if the targets have no common area."""
    try:
        prediction = predict(calibration)
    except ValueError:
        return {}
    return {key: _rounded(prediction.rms(key), _SIGMA_DIGITS) for key in prediction.quantities}


def _target(target: TargetCalibration) -> dict[str, Any]:
    low, high = target.valid_mm.min(axis=0).tolist(), target.valid_mm.max(axis=0).tolist()
    check = target.cross_check
    return {
        "name": target.name,
        "z_mm": target.z_mm,
        "simulated": target.simulated,
        "camera": {
            "serial": _known(target.camera.serial),
            "model": _known(target.camera.model),
            "driver": _known(target.camera.driver),
        },
        "width": target.width,
        "height": target.height,
        "map": target.map.name,
        "x_mm": [low[0], high[0]],
        "y_mm": [low[1], high[1]],
        "left_out_px": _rounded(target.leave_one_out_px),
        "residuals": {
            "mean_mm": _rounded(target.residual_mean_mm),
            "std_mm": _rounded(target.residual_std_mm),
            "max_mm": _rounded(target.residual_max_mm),
        },
        "repeatability_px": [_rounded(each) for each in target.repeatability_px],
        "leds": len(target.leds_px),
        "cross_check": {
            "map": check.map.name,
            "left_out_px": _rounded(check.leave_one_out_px),
            "bound_px": _rounded(check.limit_px),
            "largest_px": _rounded(check.max_difference_px),
        },
        "flat": None if target.flat is None else target.flat.source,
        "fingerprint": _fingerprint(target.fingerprint),
    }


def _fingerprint(fingerprint: Fingerprint | None) -> dict[str, Any] | None:
    if fingerprint is None:
        return None
    return {"hot_px": len(fingerprint.hot.permanent), "texture": fingerprint.source}


def _known(text: str | None) -> str | None:
    return None if text is None else _shown(text)


def _shown(text: str) -> str:
    """Return a text of the file, cut, with escapes for unprintable characters."""
    return one_line(text if len(text) <= MAX_TEXT_CHARACTERS else f"{text[:MAX_TEXT_CHARACTERS]}…")


def _rounded(number: float, digits: int = _DIGITS) -> float | None:
    """Round to ``digits`` significant digits; None if not finite, which JSON cannot represent."""
    value = float(number)
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None
