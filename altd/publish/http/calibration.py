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
from altd.status.services import CalibrationFiles, NoReportError
from altd.status.unit import PublishedUnit


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

    def __init__(self, unit: PublishedUnit, guard: Guard, downloads: Downloads) -> None:
        self._unit = unit
        self._guard = guard
        self._downloads = downloads

    async def summary(self, _: Request) -> Response:
        """Return the figures of the calibration, and whether there is a report on it."""
        if self._unit.calibration_files is None or self._unit.calibration is None:
            return refusal(503, _NONE)
        why = ""
        try:
            await self._unit.calibration_files.check_report()
        except NoReportError as error:
            why = str(error)
        return JSONResponse(
            {**self._unit.calibration.as_object(), "report": {"available": not why, "why": why}}
        )

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
        if self._unit.calibration_files is None:
            raise Refused(refusal(503, _NONE))
        return self._unit.calibration_files
