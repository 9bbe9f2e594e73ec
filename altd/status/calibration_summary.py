"""Figures of the loaded calibration: taken from it by these models, sent by HTTP, read by the terminal.

They are small for any file: texts are cut, and arrays appear as their size or limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated

from altd.errors import one_line
from altd.files.record_tables import At
from altd.records import utc_text
from altd.status.answer import Answer

MAX_TEXT_CHARACTERS = 300
_DIGITS = 4

Range = tuple[float | None, float | None]


def shown(text: str) -> str:
    """Return a text of the file, cut, with escapes for unprintable characters."""
    return one_line(text if len(text) <= MAX_TEXT_CHARACTERS else f"{text[:MAX_TEXT_CHARACTERS]}…")


def rounded(number: float, digits: int = _DIGITS) -> float | None:
    """Round to ``digits`` significant digits; None if not finite, which JSON cannot represent."""
    value = float(number)
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _both_rounded(pair: tuple[float, float]) -> Range:
    return rounded(pair[0]), rounded(pair[1])


def _span(places: Iterable[float]) -> Range:
    return float(min(places)), float(max(places))


class CalibrationRecording(Answer):
    """Recordings and settings that a calibration was made from."""

    note: Annotated[str, At("recording_note", shown)]
    sha256: Annotated[str, At("recording_sha256", shown)]


class CalibrationFileFacts(Answer):
    """The file of the calibration; null checksums: it was not read from a file."""

    name: str
    sha256: Annotated[str | None, At("file.sha256")]
    """SHA-256 of all bytes of the file, as from `sha256sum`; the report and the console show the same."""
    checksum: Annotated[str | None, At("file.checksum")]
    """Checksum in the file, of its content alone, by which the report identifies its calibration."""


class CalibratedCamera(Answer):
    """The camera that was calibrated; null: not known."""

    serial: Annotated[str | None, At("serial", shown)]
    model: Annotated[str | None, At("model", shown)]
    driver: Annotated[str | None, At("driver", shown)]


class Residuals(Answer):
    """Distances between the mapped and the known positions of the nodes (Eq. 3.1)."""

    mean_mm: Annotated[float | None, At("residual_mean_mm", rounded)]
    std_mm: Annotated[float | None, At("residual_std_mm", rounded)]
    max_mm: Annotated[float | None, At("residual_max_mm", rounded)]


class CalibrationCrossCheck(Answer):
    """The second map, and its difference from the first one."""

    map: Annotated[str, At("map.name")]
    left_out_px: Annotated[float | None, At("leave_one_out_px", rounded)]
    bound_px: Annotated[float | None, At("limit_px", rounded)]
    largest_px: Annotated[float | None, At("max_difference_px", rounded)]


class CalibrationFingerprint(Answer):
    """Fixed pattern that identifies the camera's view."""

    hot_px: Annotated[int, At("hot.permanent", len)]
    """Number of hot pixels, which are bright in any light."""
    texture: Annotated[str | None, At("source")]
    """Source of the target's surface texture: `flat` or `scan`; null: not known."""


class CalibratedTarget(Answer):
    """Calibration of one target."""

    name: str
    z_mm: float
    simulated: bool
    """Whether it was made from simulated frames and is not for a real unit."""
    camera: CalibratedCamera
    width: int
    """Width of the camera's frame, px."""
    height: int
    map: Annotated[str, At("map.name")]
    x_mm: Annotated[Range, At("valid_mm.T.0", _span)]
    """Lowest and highest x in the area in which spots are valid, mm."""
    y_mm: Annotated[Range, At("valid_mm.T.1", _span)]
    left_out_px: Annotated[float | None, At("leave_one_out_px", rounded)]
    """Rms of the leave-one-out residuals, px: distances of nodes from the map fitted without them."""
    residuals: Annotated[Residuals, At("")]
    repeatability_px: Annotated[Range, At("repeatability_px", _both_rounded)]
    """Scatter of single exposures at one node, u and v, px."""
    leds: Annotated[int, At("leds_px", len)]
    """Number of frame LEDs with a known position."""
    cross_check: CalibrationCrossCheck
    flat: Annotated[str | None, At("flat.source")]
    """Source of the response to even light: `recording`, `laser`, `service`, `print`; null: none."""
    fingerprint: CalibrationFingerprint | None
    """Fingerprint of the camera; null: its view cannot be verified."""


class CalibrationReport(Answer):
    """Whether `/api/v1/calibration/report` has the report on exactly this calibration."""

    available: bool
    why: str
    """Reason why it is not available; empty: it is."""


class CalibrationIdentity(Answer):
    """Identity of the loaded calibration; null: no calibration is loaded, or it was not read from a file."""

    created: str | None
    checksum: str | None
    simulated: bool | None
    """Whether it was made from simulated frames."""


class CalibrationFigures(Answer):
    """The loaded calibration, without its report."""

    unit: Annotated[str, At("unit_serial", shown)]
    created: Annotated[str, At("created", utc_text)]
    """Time at which the calibration was made, UTC."""
    simulated: bool
    """Whether any part of it was made from simulated frames; it is then not for a real unit."""
    recording: Annotated[CalibrationRecording, At("")]
    file: CalibrationFileFacts
    exposures: int
    """Exposures behind `expected_sigma`: the default of `[measuring] window`, not the setting of the unit."""
    expected_sigma: dict[str, float | None]
    """Sigma of a measurement of `exposures`, by quantity: predicted, rms over the area that the nodes of all
    targets span; for a plate, leave-one-out rms of the known poses. Report and console show the same."""
    targets: list[CalibratedTarget]

    @property
    def identity(self) -> CalibrationIdentity:
        """Identity of the calibration."""
        return CalibrationIdentity(
            created=self.created, checksum=self.file.checksum, simulated=self.simulated
        )


class CalibrationSummary(CalibrationFigures):
    """The loaded calibration."""

    report: CalibrationReport
