"""The loaded calibration over HTTP: its figures for everybody, its files for those who may see pictures.

File and report hold pictures, too.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard
from altd.publish.http.recordings import Download, Downloads, saved_as, sent_whole
from altd.status.models import Answer
from altd.status.services import CalibrationFiles, CalibrationService, NoReportError

Range = tuple[float | None, float | None]


class CalibrationRecording(Answer):
    """The recordings and settings that a calibration was made from."""

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
    """The distance of each node's mapped place from its known one (Eq. 3.1)."""

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
    """The marks that identify the camera's view."""

    hot_px: int
    """The number of pixels that shine in any light."""
    texture: str | None
    """Source of the target's look: `flat` or `scan`; null: not known."""


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
    """Source of the target's response: `recording`, `laser` or `print`; null: taken as plain."""
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
    """Exposures behind `expected_sigma`: the default of `[measuring] window`, not the unit's setting."""
    expected_sigma: dict[str, float | None]
    """Of a measurement of so many exposures, by quantity, predicted from the calibration: 1 sigma, rms over
    the area that the nodes of all targets span. The report and the console show the same."""
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
"""A report comes from another computer: it runs nothing, loads nothing, and belongs to no site (CSP 3)."""

_NONE = "there is no calibration"


class LoadedCalibration:
    """The calibration of one unit, as HTTP gives it."""

    def __init__(self, service: CalibrationService, guard: Guard, downloads: Downloads) -> None:
        self._service = service
        self._guard = guard
        self._downloads = downloads

    async def summary(self, _: Request) -> Response:
        """The content of the calibration, and whether there is a report on it."""
        if self._service.files is None:
            return refusal(503, _NONE)
        why = ""
        try:
            await self._service.files.check_report()
        except NoReportError as error:
            why = str(error)
        return JSONResponse({**self._service.summary, "report": {"available": not why, "why": why}})

    async def file(self, request: Request) -> Response:
        """The file as it was loaded."""
        files = self._files(request)

        async def made() -> Response:
            return sent_whole(await files.calibration(), "application/json", saved_as(files.name))

        return Download(self._downloads, made)

    async def report(self, request: Request) -> Response:
        """The report on it."""
        files = self._files(request)

        async def made() -> Response:
            policy = {"Content-Security-Policy": REPORT_POLICY}
            return sent_whole(await files.report(), "text/html", policy)

        return Download(self._downloads, made)

    def _files(self, request: Request) -> CalibrationFiles:
        """The reader of the files; raises Refused."""
        self._guard.check_may_look(request)
        if self._service.files is None:
            raise Refused(refusal(503, _NONE))
        return self._service.files
