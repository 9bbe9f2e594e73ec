"""The page in Chromium, of a whole daemon on simulated cameras, and what a person sees there."""

import asyncio
import contextlib
import os
import time
import urllib.error
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from playwright.async_api import Browser, Locator, Page, Request, async_playwright

from altd.app.keeping import history_about
from altd.config import HttpSettings, KeptFrames, Machine
from altd.measuring.calibration import Calibration
from hw_sim.beam import BeamPose
from support.cut_cable import Cable
from support.foreign import need_program
from support.led_unit import LedUnit, config, led_unit

PROBE = Path(__file__).with_name("page_probe.js").read_text()
SIZES = {"phone": (390, 844), "desk": (1280, 900), "wall": (3840, 2160)}
POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
UNKNOWN = "\N{EN DASH}"


@dataclass
class Seen:
    """A page, and what its browser says of it."""

    page: Page
    running: LedUnit
    cable: Cable
    complaints: list[str] = field(default_factory=list)
    asked: set[str] = field(default_factory=set)

    def listen(self) -> None:
        self.page.on("console", lambda message: self._said(message.type, message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._requested)
        self.page.on("websocket", lambda socket: self.asked.add(socket.url))

    def _said(self, kind: str, text: str) -> None:
        if kind in ("error", "warning"):
            self.complaints.append(text)

    def _requested(self, request: Request) -> None:
        self.asked.add(request.url)

    async def open(self, view: str = "") -> None:
        await self.page.goto(f"http://127.0.0.1:{self.cable.port}/#{view}")

    async def now(self) -> dict[str, Any]:
        """The page's texts; no script is evaluated in it, which its policy forbids."""
        shown: dict[str, Any] = await self.page.evaluate(PROBE)
        return shown

    async def until(self, holds: Callable[[dict[str, Any]], object], timeout_s: float = 20.0) -> float:
        """Seconds until the page shows it."""
        began = time.monotonic()
        await self.once(holds, timeout_s)
        return time.monotonic() - began

    async def once(
        self, holds: Callable[[dict[str, Any]], object], timeout_s: float = 20.0
    ) -> dict[str, Any]:
        """The page's text as soon as it is so; asked once more, it may show something else."""
        async with asyncio.timeout(timeout_s):
            while not holds(now := await self.now()):  # noqa: ASYNC110  a browser reports nothing unasked
                await asyncio.sleep(0.02)
        return now

    async def until_measured(self) -> None:
        await self.until(lambda now: now["values"].get("x_mm", UNKNOWN) != UNKNOWN)

    async def until_pictures(self) -> None:
        await self.until(lambda now: len(now["pictures"]) == 2)


async def picture(shown: Seen, name: str, last: Locator | None = None) -> None:
    """For docs, of the whole page or down to its ``last`` part: ``make pictures`` names the folder."""
    folder = os.environ.get("ALTD_PICTURES")
    if not folder:
        return
    await shown.page.evaluate("scrollTo(0, 0)")
    box = None if last is None else await last.bounding_box()
    options: dict[str, Any] = {}
    if box is not None:
        options["clip"] = {"x": 0, "y": 0, "width": SIZES["desk"][0], "height": box["y"] + box["height"] + 16}
    await shown.page.screenshot(path=f"{folder}/{name}.png", full_page=True, **options)


@contextlib.asynccontextmanager
async def browser() -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        path = need_program("chromium")
        started = await playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield started
        finally:
            await started.close()


@contextlib.asynccontextmanager
async def watched_unit(
    calibration: Calibration,
    folder: Path | None = None,
    calibration_file: Path | None = None,
    machine: Machine | None = None,
) -> AsyncIterator[LedUnit]:
    """``folder``: the unit keeps its history and its frames there; its calibration is read from the file."""
    kept = KeptFrames(memory_mb=0)
    if folder is not None:
        kept = KeptFrames(before_s=2, after_s=1, folder=folder / "kept")
    settings = config(measuring={"window": 4}).model_copy(
        update={"http": HttpSettings(host="127.0.0.1", port=0), "kept_frames": kept, "machine": machine}
    )

    if calibration_file is not None:
        unit = settings.unit.model_copy(update={"calibration": calibration_file})
        settings = settings.model_copy(update={"unit": unit})

    def keep(running: LedUnit) -> None:
        if folder is not None:
            about = history_about(settings, calibration, running.daemon.board.quantities)
            running.daemon.past.keep_in(folder / "history.db", 400 * 10**6, about)

    async with led_unit(calibration, settings, keep) as running:
        running.unit.place(POSE)
        await running.measured(valid=True)
        await _threads_started(running)
        yield running


async def _threads_started(running: LedUnit) -> None:
    """Parts that the unit starts at the first request are the unit's, not those of the test that asks."""
    with contextlib.suppress(urllib.error.HTTPError):  # there may be no such file
        url = f"http://127.0.0.1:{port_of(running)}/api/v1/calibration/file"
        await asyncio.to_thread(lambda: urlopen(url).close())


@contextlib.asynccontextmanager
async def seen(
    started: Browser,
    running: LedUnit,
    size: tuple[int, int] = SIZES["desk"],
    *,
    goes_on: bool = True,
    **options: Any,
) -> AsyncIterator[Seen]:
    """The page of a unit, in a window with nothing of any other.

    Where the unit ``goes_on``, for the next test, it serves the page no more at the end.
    """
    before = asyncio.all_tasks()
    async with Cable(port_of(running)) as cable:
        page = await started.new_page(viewport={"width": size[0], "height": size[1]}, **options)
        shown = Seen(page, running, cable)
        shown.listen()
        await shown.open()
        await shown.until_measured()
        yield shown
        await page.close()
    async with asyncio.timeout(60):
        while goes_on and asyncio.all_tasks() - before:  # noqa: ASYNC110  the unit notices that the page has left
            await asyncio.sleep(0.01)


def port_of(running: LedUnit) -> int:
    message = next(each for each in running.daemon.health if each.name.startswith("http ")).message
    return int(message.removeprefix("port ").split()[0])
