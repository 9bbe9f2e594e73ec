"""What the page takes in memory over time, while somebody goes through its views."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, fields

from playwright.async_api import Browser, CDPSession, Page, Route

from benchmarks.chromium import processes, until_pictures
from benchmarks.page.slope import Slope, slope_of

INTERVAL_S = 30.0
SETTLE_S = 600.0
"""So long the page fills its own memory of ten minutes; what grows later grows for ever."""

_SIZE = 1280, 900
_LOOK_S = 1.5
_SPAN = "1 hour"

_KEPT = "memory.add(now.measurement);"
_DEFECT = f"{_KEPT} (globalThis.kept ??= []).push(now); addEventListener('resize', () => now);"


@dataclass(frozen=True, slots=True)
class Sample:
    """The page with its pictures, after a forced garbage collection."""

    t_s: float
    heap_mb: float
    nodes: int
    listeners: int
    renderer_mb: float
    """Proportional set size of the process that draws the page."""
    browser_mb: float
    """The same of all of the browser's processes."""


QUANTITIES = tuple(field.name for field in fields(Sample))[1:]


async def samples(browser: Browser, http_port: int, seconds: float, is_spoilt: bool) -> AsyncIterator[Sample]:
    """A sample each half minute, or oftener in a short run; between two all views are looked at.

    ``is_spoilt``: the page keeps every measurement and a listener for it for ever, on purpose.
    """
    page = await browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]})
    if is_spoilt:
        await page.route("**/main.js", _spoil)
    of_page = await page.context.new_cdp_session(page)
    of_browser = await browser.new_browser_cdp_session()
    await of_page.send("Performance.enable")
    await page.goto(f"http://127.0.0.1:{http_port}/")
    began_s = time.monotonic()
    interval_s = min(INTERVAL_S, seconds / 12)
    due_s = began_s
    while due_s < began_s + seconds:
        due_s += interval_s
        await _look_around(page)
        await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
        await until_pictures(page)
        yield await _sample(of_page, of_browser, time.monotonic() - began_s)
    await page.close()


def slopes(taken: list[Sample], seconds: float) -> dict[str, Slope]:
    """How each quantity went once the page's own memory was full."""
    settled = [sample for sample in taken if sample.t_s > min(SETTLE_S, seconds / 6)]
    t_s = [sample.t_s for sample in settled]
    return {name: slope_of(t_s, [getattr(sample, name) for sample in settled]) for name in QUANTITIES}


async def _look_around(page: Page) -> None:
    """Through all views, and back to the first one, which has the pictures."""
    for title in ("Drive", "Trends", _SPAN, "Events", "Unit", "Overview"):
        wanted = page.get_by_role("button" if title == _SPAN else "link", name=title, exact=True)
        await wanted.dispatch_event("click")  # the mouse would miss what moves while the numbers change
        await asyncio.sleep(_LOOK_S)


async def _sample(of_page: CDPSession, of_browser: CDPSession, t_s: float) -> Sample:
    await of_page.send("HeapProfiler.collectGarbage")
    told = await of_page.send("Performance.getMetrics")
    metrics = {each["name"]: each["value"] for each in told["metrics"]}
    alive = await processes(of_browser)
    # a browser keeps an empty renderer in readiness: the page's is the one that has worked
    drawing = max((each for each in alive if each.kind == "renderer"), key=lambda each: each.cpu_s)
    return Sample(
        t_s,
        metrics["JSHeapUsedSize"] * 1e-6,
        round(metrics["Nodes"]),
        round(metrics["JSEventListeners"]),
        drawing.pss_mb(),
        sum(each.pss_mb() for each in alive),
    )


async def _spoil(route: Route) -> None:
    answer = await route.fetch()
    program = await answer.text()
    if _KEPT not in program:
        raise RuntimeError(f"main.js has no {_KEPT!r} any more: the defect cannot be put in")
    await route.fulfill(response=answer, body=program.replace(_KEPT, _DEFECT))
