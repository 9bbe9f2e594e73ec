"""The loaded calibration over HTTP: what it says, for everybody, and its files, for who may see pictures.

File and report hold pictures, too.
"""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from altd.publish.http.downloads import Downloads, saved_as, sent_whole
from altd.publish.http.errors import refusal
from altd.publish.http.guard import Guard, Refused
from altd.status.calibration_desk import (
    CalibrationDesk,
    CalibrationFiles,
    NoCalibrationFileError,
    NoReportError,
)

REPORT_POLICY = (
    "sandbox; default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""A report comes from another computer: it runs nothing, loads nothing, and belongs to no site (CSP 3)."""

_NONE = "there is no calibration"


class LoadedCalibration:
    """The calibration of one unit, as HTTP gives it."""

    def __init__(self, desk: CalibrationDesk, guard: Guard, downloads: Downloads) -> None:
        self._desk = desk
        self._guard = guard
        self._downloads = downloads

    async def summary(self) -> Response:
        """What it says, and whether there is a report on it."""
        if self._desk.files is None:
            return refusal(503, _NONE)
        why = ""
        try:
            await self._desk.files.check_report()
        except NoReportError as error:
            why = str(error)
        return JSONResponse({**self._desk.summary, "report": {"available": not why, "why": why}})

    def file(self, request: Request) -> Response:
        """The file as it was loaded."""
        files = self._files(request)
        if isinstance(files, Response):
            return files

        async def made() -> Response:
            try:
                content = await files.calibration()
            except NoCalibrationFileError as error:
                return refusal(409, str(error))
            return sent_whole(content, "application/json", saved_as(files.name))

        return self._downloads.of(made)

    def report(self, request: Request) -> Response:
        """The report on it."""
        files = self._files(request)
        if isinstance(files, Response):
            return files

        async def made() -> Response:
            try:
                page = await files.report()
            except NoReportError as error:
                return refusal(404, str(error))
            return sent_whole(page, "text/html", {"Content-Security-Policy": REPORT_POLICY})

        return self._downloads.of(made)

    def _files(self, request: Request) -> CalibrationFiles | Response:
        """Who reads the files, or what is answered instead."""
        try:
            self._guard.check_may_look(request)
        except Refused as refused:
            return refused.answer
        return refusal(503, _NONE) if self._desk.files is None else self._desk.files
