"""The loaded calibration over HTTP: figures for all clients, files for clients that may see pictures.

The file and the report contain pictures, too.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard
from altd.publish.http.recordings import Download, Downloads, saved_as, sent_whole
from altd.status.answer import Answer
from altd.status.services import CalibrationFiles, CalibrationService, NoReportError

Range = tuple[float | None, float | None]


class CalibrationRecording(Answer):
    """Recordings and settings that a calibration was made from."""

    note: str
    sha256: str


class CalibrationFileFacts(Answer):
    """The file of the calibration; null checksums: it was not read from a file."""

    name: str
    sha256: str | None
    """SHA-256 of all bytes of the file, as from `sha256sum`; the report and the console show the same."""
    checksum: str | None
    """Checksum in the file, of its content alone, by which the report identifies its calibration."""


class CalibratedCamera(Answer):
    """The camera that was calibrated; null: not known."""

    serial: str | None
    model: str | None
    driver: str | None


class Residuals(Answer):
    """Distances between the mapped and the known positions of the nodes (Eq. 3.1)."""

    mean_mm: float | None
    std_mm: float | None
    max_mm: float | None


class CalibrationCrossCheck(Answer):
    """The second map, and its difference from the first one."""

    map: str
    left_out_px: float | None
    bound_px: float | None
    largest_px: float | None


class CalibrationFingerprint(Answer):
    """Fixed pattern that identifies the camera's view."""

    hot_px: int
    """Number of hot pixels, which are bright in any light."""
    texture: str | None
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
    map: str
    x_mm: Range
    """Lowest and highest x in the area in which spots are valid, mm."""
    y_mm: Range
    left_out_px: float | None
    """Rms of the leave-one-out residuals, px: distances of nodes from the map fitted without them."""
    residuals: Residuals
    repeatability_px: Range
    """Scatter of single exposures at one node, u and v, px."""
    leds: int
    """Number of frame LEDs with a known position."""
    cross_check: CalibrationCrossCheck
    flat: str | None
    """Source of the response to even light: `recording`, `laser` or `print`; null: treated as plain."""
    fingerprint: CalibrationFingerprint | None
    """Fingerprint of the camera; null: its view cannot be verified."""


class CalibrationReport(Answer):
    """Whether `/api/v1/calibration/report` has the report on exactly this calibration."""

    available: bool
    why: str
    """Reason why it is not available; empty: it is."""


class CalibrationSummary(Answer):
    """The loaded calibration."""

    unit: str
    created: str
    """Time at which the calibration was made, UTC."""
    simulated: bool
    """Whether any part of it was made from simulated frames; it is then not for a real unit."""
    recording: CalibrationRecording
    file: CalibrationFileFacts
    exposures: int
    """Exposures behind `expected_sigma`: the default of `[measuring] window`, not the setting of the unit."""
    expected_sigma: dict[str, float | None]
    """Sigma of a measurement of `exposures`, by quantity: predicted, rms over the area that the nodes of all
    targets span; for a plate, leave-one-out rms of the known poses. Report and console show the same."""
    targets: list[CalibratedTarget]
    report: CalibrationReport


class CalibrationFile(BaseModel):
    """A calibration file."""

    model_config = ConfigDict(extra="allow")
    format: str


REPORT_POLICY = (
    "sandbox; default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""Policy of a report, made on another computer: it runs and loads nothing and has no origin (CSP 3)."""

_NONE = "there is no calibration"


class LoadedCalibration:
    """Answers requests for the calibration of one unit."""

    def __init__(self, service: CalibrationService, guard: Guard, downloads: Downloads) -> None:
        self._service = service
        self._guard = guard
        self._downloads = downloads

    async def summary(self, _: Request) -> Response:
        """Return the figures of the calibration, and whether there is a report on it."""
        if self._service.files is None:
            return refusal(503, _NONE)
        why = ""
        try:
            await self._service.files.check_report()
        except NoReportError as error:
            why = str(error)
        return JSONResponse({**self._service.summary, "report": {"available": not why, "why": why}})

    async def file(self, request: Request) -> Response:
        """Return the file as it was loaded."""
        files = self._files(request)

        async def made() -> Response:
            return sent_whole(await files.calibration(), "application/json", saved_as(files.name))

        return Download(self._downloads, made)

    async def report(self, request: Request) -> Response:
        """Return the report on the calibration."""
        files = self._files(request)

        async def made() -> Response:
            policy = {"Content-Security-Policy": REPORT_POLICY}
            return sent_whole(await files.report(), "text/html", policy)

        return Download(self._downloads, made)

    def _files(self, request: Request) -> CalibrationFiles:
        """Return the reader of the files; raises Refused."""
        self._guard.check_may_look(request)
        if self._service.files is None:
            raise Refused(refusal(503, _NONE))
        return self._service.files
