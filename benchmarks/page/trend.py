"""How long it takes from the click on "1 year" until its plots are drawn."""

from __future__ import annotations

import asyncio
import os
import time
from dataclasses import dataclass
from pathlib import Path

from playwright.async_api import Browser, Page

from altd.app.keeping import FILE_NAME
from benchmarks.history import make_history
from benchmarks.material import Material, make_config
from benchmarks.served_unit import served_unit

_SPAN, _LIVE = "1 year", "10 minutes"
_PAUSE_S = 1.0
_SETTLE_S = 5.0

_CLICK = """async name => {
    const frame = () => new Promise(resolve => requestAnimationFrame(resolve));
    const plots = () => [...document.querySelectorAll('.plot [aria-label$="in that time"] .uplot canvas')];
    const wanted = document.querySelectorAll(".plot").length;
    const button = [...document.querySelectorAll(".spans button")].find(each => each.textContent === name);
    const began = performance.now();
    button.click();
    while (plots().length < wanted || !document.querySelector(".lane .worst")) await frame();
    await frame();
    const drawn = performance.now();
    const answers = performance.getEntriesByType("resource").filter(each => each.name.includes("/trend?"));
    const asked = answers.at(-1);
    const pixels = canvas => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    return {total: drawn - began, answer: asked.responseEnd - asked.startTime, bytes: asked.decodedBodySize,
        plots: plots().filter(canvas => pixels(canvas).some(Boolean)).length, wanted};
}"""


@dataclass(frozen=True, slots=True)
class ShownTrend:
    """One click: until all was drawn, and how much of that the unit took to answer."""

    total_ms: float
    answer_ms: float
    answer_bytes: int


async def click_often(browser: Browser, material: Material, folder: Path, times: int) -> list[ShownTrend]:
    """A year on a unit that has just started; before the first click the computer forgets its file."""
    file = folder / FILE_NAME
    make_history(file, int(time.time()) // 3600 * 3600, unit=make_config().unit.serial)
    async with served_unit(material, folder) as unit:
        page = await browser.new_page(viewport={"width": 1280, "height": 900})
        await page.goto(f"http://127.0.0.1:{unit.http_port}/#trends")
        await page.locator(".plot .uplot").first.wait_for()
        await asyncio.sleep(_SETTLE_S)
        _forget(file)
        shown = []
        for _ in range(times + 1):
            shown.append(await _click(page))
            await page.get_by_role("button", name=_LIVE, exact=True).click()
            await asyncio.sleep(_PAUSE_S)
        await page.close()
    return shown


async def _click(page: Page) -> ShownTrend:
    """Raises RuntimeError when a plot stays empty."""
    seen = await page.evaluate(_CLICK, _SPAN)
    if seen["plots"] != seen["wanted"]:
        raise RuntimeError(f"{seen['plots']} of {seen['wanted']} plots are drawn")
    return ShownTrend(seen["total"], seen["answer"], seen["bytes"])


def _forget(file: Path) -> None:
    """Let the kernel drop what it keeps of a file (posix_fadvise(2))."""
    with file.open("rb") as opened:
        os.posix_fadvise(opened.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
