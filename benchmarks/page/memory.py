"""What the page takes in memory over time, while somebody goes through its views."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, fields

from benchmarks.chromium import PICTURES, processes
from benchmarks.devtools import DevTools, devtools
from benchmarks.page.slope import Slope, slope_of

INTERVAL_S = 30.0
SETTLE_S = 600.0
"""So long the page fills its own memory of ten minutes; what grows later grows for ever."""

_SIZE = 1280, 900
_LOOK_S = 1.5
_SPAN = "1 hour"
_SHOWS_PICTURES = f"document.querySelectorAll({json.dumps(PICTURES)}).length >= 2"
_CLICK = (
    """[...document.querySelectorAll("a, button")].find(each => each.textContent.trim() === %s).click()"""
)

_DEFECT = """globalThis.EventSource = class extends EventSource {
    constructor(...given) {
        super(...given);
        this.addEventListener("message", message => {
            (globalThis.kept ??= []).push(message.data);
            addEventListener("resize", () => message);
        });
    }
};"""


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


async def samples(http_port: int, seconds: float, is_spoilt: bool) -> AsyncIterator[Sample]:
    """A sample each half minute, or oftener in a short run; between two all views are looked at.

    ``is_spoilt``: the page keeps every measurement and a listener for it for ever, on purpose.
    """
    async with devtools(*_SIZE) as browser:
        await browser.open(f"http://127.0.0.1:{http_port}/", before=_DEFECT if is_spoilt else "")
        await browser.until(_SHOWS_PICTURES)
        began_s = time.monotonic()
        interval_s = min(INTERVAL_S, seconds / 12)
        due_s = began_s
        while due_s < began_s + seconds:
            due_s += interval_s
            await _look_around(browser)
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            await browser.until(_SHOWS_PICTURES)
            yield await _sample(browser, time.monotonic() - began_s)


def slopes(taken: list[Sample], seconds: float) -> dict[str, Slope]:
    """How each quantity went once the page's own memory was full."""
    settled = [sample for sample in taken if sample.t_s > min(SETTLE_S, seconds / 6)]
    t_s = [sample.t_s for sample in settled]
    return {name: slope_of(t_s, [getattr(sample, name) for sample in settled]) for name in QUANTITIES}


async def _look_around(browser: DevTools) -> None:
    """Through all views, and back to the first one, which has the pictures."""
    for title in ("Drive", "Trends", _SPAN, "Events", "Unit", "Overview"):
        await browser.evaluate(_CLICK % json.dumps(title))
        await asyncio.sleep(_LOOK_S)


async def _sample(browser: DevTools, t_s: float) -> Sample:
    await browser.send_to_page("HeapProfiler.collectGarbage")
    told = await browser.send_to_page("Performance.getMetrics")
    metrics = {each["name"]: each["value"] for each in told["metrics"]}
    alive = await processes(browser)
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
