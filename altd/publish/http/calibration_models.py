"""What the loaded calibration says of itself, as pydantic models (``altd/app/calibration_summary.py``)."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from altd.publish.http.models import Answer

Range = tuple[float | None, float | None]


class CalibrationRecording(Answer):
    """What a calibration was made from."""

    note: str
    sha256: str


class CalibrationFileFacts(Answer):
    """Which file it is; null: it was not read from one."""

    name: str
    sha256: str | None
    """Of all bytes of the file, as `sha256sum` gives it; the report and the console show the same."""
    checksum: str | None
    """The checksum in the file, of its content alone, by which the report names its calibration."""


class CalibratedCamera(Answer):
    """The camera that was calibrated; null: not known."""

    serial: str | None
    model: str | None
    driver: str | None


class Residuals(Answer):
    """How far from its known place the map puts each node (Eq. 3.1)."""

    mean_mm: float | None
    std_mm: float | None
    max_mm: float | None


class CalibrationCrossCheck(Answer):
    """The second map, and how far the two lie apart."""

    map: str
    left_out_px: float | None
    bound_px: float | None
    largest_px: float | None


class CalibrationFingerprint(Answer):
    """What identifies the camera's view."""

    hot_px: int
    """How many pixels shine in any light."""
    texture: str | None
    """Where the look of the target is known from: `flat` or `scan`; null: it is not."""


class CalibratedTarget(Answer):
    """One target."""

    name: str
    z_mm: float
    simulated: bool
    """Made from simulated frames: not for a real unit."""
    camera: CalibratedCamera
    width: int
    """Of the camera's picture, px."""
    height: int
    map: str
    x_mm: Range
    """From the lowest to the highest place in the area in which spots are valid."""
    y_mm: Range
    left_out_px: float | None
    """The rms by which a node misses the map that is fitted without it."""
    residuals: Residuals
    repeatability_px: Range
    """Scatter of single exposures at one node, u and v."""
    leds: int
    """Frame LEDs whose places are known."""
    cross_check: CalibrationCrossCheck
    flat: str | None
    """How the target's response to even light is known: `recording` or `print`; null: taken as plain."""
    fingerprint: CalibrationFingerprint | None
    """null: the camera's view cannot be verified."""


class CalibrationReport(Answer):
    """Whether `/api/v1/calibration/report` has the report on this very calibration."""

    available: bool
    why: str
    """Why not; empty: it has."""


class CalibrationSummary(Answer):
    """The loaded calibration."""

    unit: str
    created: str
    """UTC."""
    simulated: bool
    """Any part of it was made from simulated frames: not for a real unit."""
    recording: CalibrationRecording
    file: CalibrationFileFacts
    exposures: int
    """That `expected_sigma` is of: the default of `[measuring] window`, whatever the unit's own is."""
    expected_sigma: dict[str, float | None]
    """Of a measurement of so many exposures, by quantity, predicted from the calibration: 1 sigma, rms over
    the area that the nodes of all targets span. The report and the console show the same."""
    targets: list[CalibratedTarget]
    report: CalibrationReport


class CalibrationFile(BaseModel):
    """A calibration file."""

    model_config = ConfigDict(extra="allow")
    format: str
