"""The content of a calibration as plain JSON types, and the valid areas and names of its targets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from altd.calibration.report.budget import budget_of
from altd.calibration.report.prediction import EXPOSURES
from altd.config import Config
from altd.files.record_tables import table_from
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.planar.instrument import QUANTITIES as PLANAR_QUANTITIES
from altd.instruments.planar.instrument import PlanarCalibration
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.status.calibration_summary import (
    CalibratedTarget,
    CalibrationFigures,
    CalibrationFileFacts,
    rounded,
    shown,
)
from altd.status.measurement_json import reserved_names
from altd.status.target_area import TargetArea
from altd.tables import measurement_columns


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


_SIGMA_DIGITS = 7
"""Significant digits of a sigma; more than are shown, for rounding twice could differ from the report."""


def summary_of(calibration: Calibration, targets: Iterable[str], name: str) -> CalibrationFigures:
    """Return the calibration of these targets from the file ``name``."""
    chosen = [target for each in targets if (target := calibration.target(each)) is not None]
    return _summary(calibration, name, _expected_sigma(calibration), chosen)


def planar_summary_of(calibration: PlanarCalibration, name: str) -> CalibrationFigures:
    """Return the calibration of a plate from the file ``name``; the sigma is that of the known poses."""
    of_place_mm, of_phi_deg = calibration.rms.get(calibration.fit.camera.model, (math.nan, math.nan))
    keys = (quantity.key for quantity in PLANAR_QUANTITIES.of_unit)
    sigmas = zip(keys, (of_place_mm, of_place_mm, of_phi_deg), strict=True)
    return _summary(calibration, name, dict(sigmas))


def _summary(
    calibration: Calibration | PlanarCalibration,
    name: str,
    expected_sigma: Mapping[str, float],
    targets: Iterable[TargetCalibration] = (),
) -> CalibrationFigures:
    return table_from(
        CalibrationFigures,
        calibration,
        file=table_from(CalibrationFileFacts, calibration, name=shown(name)),
        exposures=EXPOSURES,
        expected_sigma={key: rounded(sigma, _SIGMA_DIGITS) for key, sigma in expected_sigma.items()},
        targets=[table_from(CalibratedTarget, target) for target in targets],
    )


def _expected_sigma(calibration: Calibration) -> dict[str, float]:
    """Return the report's sigma by quantity; empty if the targets have no common area."""
    try:
        budget = budget_of(calibration)
    except ValueError:
        return {}
    return dict(zip(budget.quantities, budget.combined, strict=True))
