"""``python -m benchmarks.load_browsers HTTP BROWSERS SECONDS``: the page in Chromium, so many times at once.

Prints a line when all of them show pictures; after so many seconds, as JSON, which pictures were shown when
(the frame's number, Unix time in ms), and what all of Chromium took: cores, MB.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from dataclasses import asdict, dataclass

from benchmarks.chromium import chromium, processes, until_pictures

_SIZE = 1280, 900

_NOTE = """(() => {
    const shown = globalThis.shownPictures = [];
    globalThis.WebSocket = class extends WebSocket {
        constructor(...given) {
            super(...given);
            this.addEventListener("message", message => { this.came = message.data; });
        }
        send(text) {
            super.send(text);
            if (!(this.came instanceof ArrayBuffer)) return;
            const length = new DataView(this.came).getUint32(0);
            const { pictures } = JSON.parse(new TextDecoder().decode(new Uint8Array(this.came, 4, length)));
            // the page asks for the next one before it paints this one, which is seen in the frame after
            requestAnimationFrame(() => requestAnimationFrame(() => {
                const now = performance.timeOrigin + performance.now();
                for (const { sequence } of pictures) shown.push([sequence, now]);
            }));
        }
    };
})()"""


@dataclass(frozen=True, slots=True)
class Shown:
    """What all pages showed, and what their browser took meanwhile."""

    pictures: list[tuple[int, float]]
    cores: float
    memory_mb: float


async def _show(port: int, browsers: int, seconds: float) -> Shown:
    async with chromium() as browser:
        session = await browser.new_browser_cdp_session()
        pages = []
        for _ in range(browsers):
            page = await browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]})
            await page.add_init_script(_NOTE)
            await page.goto(f"http://127.0.0.1:{port}/")
            pages.append(page)
        for page in pages:
            await until_pictures(page)
            await page.evaluate("() => { shownPictures.length = 0; }")
        print("all show pictures", flush=True)
        begun_s, cpu_s = time.monotonic(), sum(each.cpu_s for each in await processes(session))
        await asyncio.sleep(seconds)
        alive = await processes(session)
        cores = (sum(each.cpu_s for each in alive) - cpu_s) / (time.monotonic() - begun_s)
        memory_mb = sum(each.pss_mb() for each in alive)
        pictures = [each for page in pages for each in await page.evaluate("() => shownPictures")]
    return Shown(pictures, cores, memory_mb)


def main() -> int:
    """Show, and print what was shown.

    Browsers run on computers of their own. Here they take what nobody else wants of the processors, so that
    they do not slow down what they look at; as root Chromium would even run before all others.
    """
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    port, browsers = map(int, sys.argv[1:3])
    print(json.dumps(asdict(asyncio.run(_show(port, browsers, float(sys.argv[3]))))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
