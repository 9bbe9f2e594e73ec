"""The whole daemon's page in Chromium: ``python -m benchmarks.page`` (``make bench-page``)."""

import asyncio
import os
import tempfile
import time
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from playwright.async_api import Browser, Page

from altd.app.keeping import FILE_NAME
from benchmarks.chromium import chromium
from benchmarks.daemon import served_unit
from benchmarks.harness import Columns, Parser, end
from benchmarks.history import make_history
from benchmarks.material import Material, make_config, make_material
from benchmarks.page.memory import QUANTITIES, Sample, samples, slopes

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
    """One click: time until everything was drawn, and the unit's part of it."""

    total_ms: float
    answer_ms: float
    answer_bytes: int


async def click_often(browser: Browser, material: Material, folder: Path, times: int) -> list[ShownTrend]:
    """Show a year on a unit that has just started; the computer drops its file before the first click."""
    file = folder / FILE_NAME
    make_history(file, int(time.time()) // 3600 * 3600, unit=make_config().unit.serial)
    async with served_unit(material, folder) as unit:
        page = await browser.new_page(viewport={"width": 1280, "height": 900})
        await page.goto(f"http://127.0.0.1:{unit.interfaces.http_port}/#trends")
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
    """Click and wait for the plots; raises RuntimeError if a plot stays empty."""
    seen = await page.evaluate(_CLICK, _SPAN)
    if seen["plots"] != seen["wanted"]:
        raise RuntimeError(f"{seen['plots']} of {seen['wanted']} plots are drawn")
    return ShownTrend(seen["total"], seen["answer"], seen["bytes"])


def _forget(file: Path) -> None:
    """Let the kernel drop its cache of a file (posix_fadvise(2))."""
    with file.open("rb") as opened:
        os.posix_fadvise(opened.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


_PAIRS = 200
_CLICKS = 20
_EVERY = 6
"""One of this number of samples is printed."""
_COURSE = Columns(*(f"{name}:>13.6g" for name in ("t_s", *QUANTITIES)))
_SLOPES = Columns(":>13", "median:>10.2f", "highest:>10.2f", "an hour:>+10.2f", "sigma:>9.2f", ":")


async def show_a_year(material: Material) -> None:
    """Print the time to show a year's trend."""
    with tempfile.TemporaryDirectory(prefix="altd-page-") as folder:
        async with chromium() as browser:
            cold, *shown = await click_often(browser, material, Path(folder), _CLICKS)
    total_ms, answer_ms = ([getattr(each, name) for each in shown] for name in ("total_ms", "answer_ms"))
    print(
        f'from the click on "1 year" to its drawn plots: {_spread(total_ms)} of {len(shown)}; '
        f"the unit's answer, {cold.answer_bytes / 1000:.0f} kB: {_spread(answer_ms)}\n"
        f"the first, its file not in memory: {cold.total_ms:.0f} ms, the answer {cold.answer_ms:.0f} ms",
        flush=True,
    )


async def keep_open(material: Material, seconds: float, is_spoilt: bool) -> bool:
    """Print the course of the page's memory; return whether any quantity grew."""
    print(_COURSE.head, flush=True)
    taken: list[Sample] = []
    with tempfile.TemporaryDirectory(prefix="altd-page-") as folder:
        async with served_unit(material, Path(folder)) as unit:
            async for sample in samples(unit.interfaces.http_port, seconds, is_spoilt):
                if len(taken) % _EVERY == 0:
                    print(_COURSE.row(*astuple(sample)), flush=True)
                taken.append(sample)
    found = slopes(taken, seconds)
    print(_SLOPES.head)
    for name, slope in found.items():
        word = "  grows" if slope.grows else "  flat"
        print(_SLOPES.row(name, slope.median, slope.highest, slope.per_h, slope.sigma_per_h, word))
    return any(slope.grows for slope in found.values())


def _spread(values: list[float]) -> str:
    p50, p95, highest = np.percentile(values, (50, 95, 100))
    return f"median {p50:.0f}, 95 % within {p95:.0f}, at most {highest:.0f} ms"


def main(arguments: list[str] | None = None) -> int:
    """Measure; return 1 if the page's memory grew."""
    parser = Parser("benchmarks.page", __doc__)
    parser.number("--seconds", 3600.0, "for which the page is kept open")
    parser.add_argument(
        "--spoilt", action="store_true", help="with a page that frees no memory: it must be detected"
    )
    options = parser.parse_args(arguments)
    material = make_material(_PAIRS, 1)
    if not options.spoilt:
        asyncio.run(show_a_year(material))
    return int(asyncio.run(keep_open(material, options.seconds, options.spoilt)))


if __name__ == "__main__":
    end(main, "benchmarks.page")
