"""Reads the file of the loaded calibration and the report next to it, in a thread for each read."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

from altd.calibration.file import MAX_BYTES
from altd.calibration.report.write import HEAD_BYTES, checksum_in, page_path
from altd.errors import BadInputError
from altd.files.reading import read_file, read_head
from altd.measuring.calibration import CalibrationFile
from altd.runtime.threads import SingleCall
from altd.status.services import NoCalibrationFileError, NoReportError

MAX_REPORT_BYTES = 1 << 26
"""Maximum size of a report, which normally has 1 MB plus 5 kB per node."""

READ_TIMEOUT_S = 10.0
_NO_ANSWER = "the disk does not answer"


class ReadCalibrationFiles:
    """Files of one loaded calibration; ``loaded`` None: the calibration was not read from a file."""

    def __init__(self, path: Path, loaded: CalibrationFile | None) -> None:
        self.name = path.name
        self._path = path
        self._page = page_path(path)
        self._loaded = loaded
        self._reading = SingleCall("calibration files")

    async def calibration(self) -> bytes:
        """Return the file as it was loaded; raises NoCalibrationFileError."""
        try:
            content = await self._call(lambda: read_file(self._path, MAX_BYTES))
        except BadInputError as error:
            raise NoCalibrationFileError(error.message) from error
        except TimeoutError as error:
            raise NoCalibrationFileError(_NO_ANSWER) from error
        if self._loaded is None or sha256(content).hexdigest() != self._loaded.sha256:
            raise NoCalibrationFileError("the file is not the one that the unit has loaded")
        return content

    async def check_report(self) -> None:
        """Raise NoReportError if there is no report on the loaded calibration."""
        self._check(await self._of_page(lambda: read_head(self._page, HEAD_BYTES)))

    async def report(self) -> bytes:
        """Return the report; raises NoReportError, also for a report on another calibration."""
        page = await self._of_page(lambda: read_file(self._page, MAX_REPORT_BYTES))
        self._check(page)
        return page

    async def _of_page(self, read: Callable[[], bytes]) -> bytes:
        try:
            return await self._call(read)
        except BadInputError as error:
            raise NoReportError(f"{self._page.name} next to the calibration: {error.message}") from error
        except TimeoutError as error:
            raise NoReportError(_NO_ANSWER) from error

    def _check(self, page: bytes) -> None:
        named = checksum_in(page)
        if named is None:
            raise NoReportError(f"{self._page.name} next to the calibration does not name its calibration")
        if self._loaded is None or named != self._loaded.checksum:
            raise NoReportError(
                f"{self._page.name} next to the calibration is the report of another calibration"
            )

    async def _call(self, read: Callable[[], bytes]) -> bytes:
        return await self._reading.call(read, READ_TIMEOUT_S)
