"""The Chromium of this machine, driven by Playwright, and the resources of its processes."""

import contextlib
import shutil
from collections.abc import AsyncIterator, Awaitable
from dataclasses import dataclass
from typing import Any, Protocol

from playwright.async_api import Browser, Page, async_playwright

from benchmarks.process_memory import proportional_mb

PICTURES = 'figure.target[data-sequence]:not([data-sequence=""])'
"""Selector of the targets whose picture the unit's page shows."""

_PATIENCE_MS = 60_000


@dataclass(frozen=True, slots=True)
class BrowserProcess:
    """One of a browser's processes; ``kind`` as in Chromium: browser, renderer, GPU, utility."""

    kind: str
    pid: int
    cpu_s: float
    """CPU time since its start."""

    def pss_mb(self) -> float:
        """Proportional memory of the process, with its share of shared memory; 0 if it has ended."""
        try:
            return proportional_mb(self.pid)
        except OSError:
            return 0.0


class Asked(Protocol):
    """A session of the Chrome DevTools Protocol."""

    def send(self, method: str, /) -> Awaitable[dict[str, Any]]:
        """Call a method without parameters and return its response."""
        ...


def program() -> str:
    """Path of the program; raises SystemExit if there is none."""
    path = shutil.which("chromium")
    if path is None:
        raise SystemExit("benchmarks: there is no program chromium")
    return path


@contextlib.asynccontextmanager
async def chromium() -> AsyncIterator[Browser]:
    """Run Chromium headless within the block; raises SystemExit if there is none."""
    async with async_playwright() as playwright:
        started = await playwright.chromium.launch(executable_path=program(), args=["--no-sandbox"])
        try:
            yield started
        finally:
            await started.close()


async def processes(browser: Asked) -> list[BrowserProcess]:
    """All processes, from a session of the whole browser (such as ``Browser.new_browser_cdp_session``)."""
    said = await browser.send("SystemInfo.getProcessInfo")
    return [BrowserProcess(each["type"], each["id"], each["cpuTime"]) for each in said["processInfo"]]


async def until_pictures(page: Page) -> None:
    """Wait until the unit's page shows a picture of each of two targets."""
    await page.locator(PICTURES).nth(1).wait_for(timeout=_PATIENCE_MS)
