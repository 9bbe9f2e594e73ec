"""The files of a calibration, which a test changes."""

import asyncio

from altd.status.services import NoCalibrationFileError, NoReportError

PAGE = b'<!DOCTYPE html><meta charset="utf-8"><script>alert(document.cookie)</script>'
FILE = b'{"format": "altd-calibration/1"}\n'


class Files:
    """A calibration's files as a test wants them."""

    name = "unit 7\r\nX: y.json"

    def __init__(self) -> None:
        self.refuses = ""
        self.no_report = ""
        self.goes_on = asyncio.Event()
        self.goes_on.set()
        self.asked = 0

    async def calibration(self) -> bytes:
        self.asked += 1
        await self.goes_on.wait()
        if self.refuses:
            raise NoCalibrationFileError(self.refuses)
        return FILE

    async def check_report(self) -> None:
        if self.no_report:
            raise NoReportError(self.no_report)

    async def report(self) -> bytes:
        await self.check_report()
        return PAGE
