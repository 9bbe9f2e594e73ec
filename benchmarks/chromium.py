"""The Chromium of this machine, driven by Playwright, and what its processes take."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import AsyncIterator, Awaitable
from dataclasses import dataclass
from typing import Any, Protocol

from playwright.async_api import Browser, Page, async_playwright

from benchmarks.process_memory import proportional_mb

PICTURES = 'figure.target[data-sequence]:not([data-sequence=""])'
"""Each of the targets that the unit's page shows a picture of."""

_PATIENCE_MS = 60_000


@dataclass(frozen=True, slots=True)
class BrowserProcess:
    """One of a browser's processes; ``kind`` as Chromium names it: browser, renderer, GPU, utility."""

    kind: str
    pid: int
    cpu_s: float
    """Since it was started."""

    def pss_mb(self) -> float:
        """Its memory, what it shares with others by its share; 0 when it has ended."""
        try:
            return proportional_mb(self.pid)
        except OSError:
            return 0.0


class Asked(Protocol):
    """A connection that answers Chromium's own protocol."""

    def send(self, method: str, /) -> Awaitable[dict[str, Any]]:
        """The answer of a method without parameters."""
        ...


def program() -> str:
    """The path of the program; raises SystemExit where there is none."""
    path = shutil.which("chromium")
    if path is None:
        raise SystemExit("benchmarks: there is no program chromium")
    return path


@contextlib.asynccontextmanager
async def chromium() -> AsyncIterator[Browser]:
    """Headless, for as long as the block lasts; raises SystemExit where there is none."""
    async with async_playwright() as playwright:
        started = await playwright.chromium.launch(executable_path=program(), args=["--no-sandbox"])
        try:
            yield started
        finally:
            await started.close()


async def processes(browser: Asked) -> list[BrowserProcess]:
    """All of them, by a session of the whole browser (such as ``Browser.new_browser_cdp_session``)."""
    said = await browser.send("SystemInfo.getProcessInfo")
    return [BrowserProcess(each["type"], each["id"], each["cpuTime"]) for each in said["processInfo"]]


async def until_pictures(page: Page) -> None:
    """Wait until the unit's page shows a picture of each of two targets."""
    await page.locator(PICTURES).nth(1).wait_for(timeout=_PATIENCE_MS)
