"""Where an interface reads what the loaded calibration says, its file, and the report on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol


class NoCalibrationFileError(Exception):
    """The file cannot be given, or is not the one that belongs to this unit; the sentence says why."""


class NoReportError(Exception):
    """There is no report on the loaded calibration; the sentence says why."""


class CalibrationFiles(Protocol):
    """Who reads the files."""

    @property
    def name(self) -> str:
        """The calibration file's name."""

    async def calibration(self) -> bytes:
        """The file as it was loaded; raises NoCalibrationFileError."""

    async def check_report(self) -> None:
        """Raise NoReportError where there is no report on the loaded calibration."""

    async def report(self) -> bytes:
        """The report, a page of HTML; raises NoReportError."""


class CalibrationDesk:
    """``summary``, of plain JSON types, is empty and ``files`` None until the calibration is there."""

    def __init__(self) -> None:
        self.summary: Mapping[str, Any] = {}
        self.files: CalibrationFiles | None = None

    def open(self, summary: Mapping[str, Any], files: CalibrationFiles) -> None:
        """From now on there is a calibration."""
        self.summary, self.files = summary, files
