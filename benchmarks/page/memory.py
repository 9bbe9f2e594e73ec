"""Memory of the page over time, while its views are visited in turn, and its growth.

Chromium is driven only by its own protocol (Chrome DevTools Protocol, domains 1.3). Playwright lets the
process that draws a page keep the page's network responses (``Network.enable``), which looks like growing
memory of the page itself.
"""

import asyncio
import contextlib
import json
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.client import ClientConnection, connect

from benchmarks.chromium import PICTURES, processes, program

_BLOCKS = 10
_SIGMAS = 3.0
_NOTEWORTHY_SHARE = 0.01


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope per hour, with its standard error; ``median`` and ``highest`` of the values themselves."""

    per_h: float
    sigma_per_h: float
    median: float
    highest: float

    @property
    def grows(self) -> bool:
        """Whether the growth is significant, and more than 1 % of the median per hour."""
        return self.per_h > max(_SIGMAS * self.sigma_per_h, _NOTEWORTHY_SHARE * self.median)


def slope_of(t_s: Sequence[float], values: Sequence[float]) -> Slope:
    """Least-squares line through the means of up to ten spans; at least six values are required.

    Successive values are not independent: a heap fills and is emptied. Therefore the scatter of means about
    the line gives the standard error (GUM, H.3.3), not that of single values.
    """
    if len(values) < 6:
        raise ValueError(f"{len(values)} values show no slope")
    blocks = min(_BLOCKS, len(values) // 2)
    t_h = np.array([part.mean() for part in np.array_split(np.asarray(t_s) / 3600, blocks)])
    means = np.array([part.mean() for part in np.array_split(np.asarray(values, float), blocks)])
    about_h = t_h - t_h.mean()
    per_h = float(about_h @ means / (about_h @ about_h))
    residuals = means - means.mean() - per_h * about_h
    variance = float(residuals @ residuals) / (blocks - 2)
    sigma = float(np.sqrt(variance / (about_h @ about_h)))
    return Slope(per_h, sigma, float(np.median(values)), float(np.max(values)))


_PATIENCE_S = 60.0
_MAX_MESSAGE_BYTES = 16 * 2**20


class DevTools:
    """One client of the protocol; it has one request at a time and receives no events."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self._page: str | None = None
        """Session with the page, once there is one."""

    async def open(self, url: str, before: str = "") -> None:
        """Open the page for all later requests; ``before`` is a program that runs first in it."""
        target = await self.send("Target.createTarget", url="about:blank")
        attached = await self.send("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._page = attached["sessionId"]
        await self.send_to_page("Page.enable")
        await self.send_to_page("Performance.enable")
        if before:
            await self.send_to_page("Page.addScriptToEvaluateOnNewDocument", source=before)
        await self.send_to_page("Page.navigate", url=url)

    async def evaluate(self, expression: str) -> Any:
        """Value of an expression in the page; raises RuntimeError if it fails there."""
        told = await self.send_to_page("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in told:
            raise RuntimeError(f"{expression}: {told['exceptionDetails']}")
        return told["result"].get("value")

    async def until(self, condition: str) -> None:
        """Wait until a condition holds in the page; raises TimeoutError."""
        async with asyncio.timeout(_PATIENCE_S):
            while not await self.evaluate(condition):  # noqa: ASYNC110  there is no event
                await asyncio.sleep(0.1)

    async def send(self, method: str, **params: object) -> Any:
        """Send a request to the browser and return its response; raises RuntimeError with its error."""
        return await self._ask({"method": method, "params": params})

    async def send_to_page(self, method: str, **params: object) -> Any:
        """Send a request to the page and return its response; raises RuntimeError with its error."""
        return await self._ask({"method": method, "params": params, "sessionId": self._page})

    async def _ask(self, question: dict[str, Any]) -> Any:
        self._number += 1
        await self._socket.send(json.dumps({"id": self._number, **question}))
        async with asyncio.timeout(_PATIENCE_S):
            async for message in self._socket:
                said = json.loads(message)
                if said.get("id") == self._number:
                    if "error" in said:
                        raise RuntimeError(f"{question['method']}: {said['error']['message']}")
                    return said["result"]
        raise RuntimeError(f"{question['method']}: the browser has gone")


@contextlib.asynccontextmanager
async def devtools(width: int, height: int) -> AsyncIterator[DevTools]:
    """Run a browser within the block; raises SystemExit if there is none."""
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        words = ["--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0"]
        words += [f"--user-data-dir={profile}", f"--window-size={width},{height}"]
        nothing = asyncio.subprocess.DEVNULL
        process = await asyncio.create_subprocess_exec(program(), *words, stdout=nothing, stderr=nothing)
        try:
            async with connect(await _address(Path(profile)), max_size=_MAX_MESSAGE_BYTES) as socket:
                yield DevTools(socket)
        finally:  # while it ends, the unit must continue to serve it
            process.terminate()
            await process.wait()


async def _address(profile: Path) -> str:
    """Address with the port that the browser listens on, from its file; raises TimeoutError."""
    async with asyncio.timeout(_PATIENCE_S):
        while True:
            with contextlib.suppress(FileNotFoundError, ValueError):
                port, path = (profile / "DevToolsActivePort").read_text().splitlines()
                return f"ws://127.0.0.1:{port}{path}"
            await asyncio.sleep(0.05)


INTERVAL_S = 30.0
SETTLE_S = 600.0
"""Time in which the page fills its own memory of ten minutes; later growth has no limit."""

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
    """State of the page with its pictures, after a forced garbage collection."""

    t_s: float
    heap_mb: float
    nodes: int
    listeners: int
    renderer_mb: float
    """Proportional set size of the process that draws the page."""
    browser_mb: float
    """Proportional set size of all of the browser's processes."""


QUANTITIES = tuple(field.name for field in fields(Sample))[1:]


async def samples(http_port: int, seconds: float, is_spoilt: bool) -> AsyncIterator[Sample]:
    """Yield a sample each half minute, or more often in a short run; all views are visited in between.

    ``is_spoilt``: the page intentionally keeps every measurement and a listener for it indefinitely.
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
    """Slope of each quantity once the page's own memory was full."""
    settled = [sample for sample in taken if sample.t_s > min(SETTLE_S, seconds / 6)]
    t_s = [sample.t_s for sample in settled]
    return {name: slope_of(t_s, [getattr(sample, name) for sample in settled]) for name in QUANTITIES}


async def _look_around(browser: DevTools) -> None:
    """Visit all views, and return to the first one, which has the pictures."""
    for title in ("Drive", "Trends", _SPAN, "Events", "Unit", "Overview"):
        await browser.evaluate(_CLICK % json.dumps(title))
        await asyncio.sleep(_LOOK_S)


async def _sample(browser: DevTools, t_s: float) -> Sample:
    await browser.send_to_page("HeapProfiler.collectGarbage")
    told = await browser.send_to_page("Performance.getMetrics")
    metrics = {each["name"]: each["value"] for each in told["metrics"]}
    alive = await processes(browser)
    # a browser keeps an empty renderer ready: the page's renderer is the one with CPU time
    drawing = max((each for each in alive if each.kind == "renderer"), key=lambda each: each.cpu_s)
    return Sample(
        t_s,
        metrics["JSHeapUsedSize"] * 1e-6,
        round(metrics["Nodes"]),
        round(metrics["JSEventListeners"]),
        drawing.pss_mb(),
        sum(each.pss_mb() for each in alive),
    )
