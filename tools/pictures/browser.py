"""Screenshots with the Chromium of this machine."""

import shutil
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

_PIXELS_PER_CSS_PIXEL = 1.5


def screenshot(address: str, picture: Path, width: int, height: int, after_s: float) -> None:
    """Write a PNG of the page ``after_s`` seconds after opening it; ``width`` and ``height`` in CSS px.

    Raises ``playwright.sync_api.Error`` if the browser fails.
    """
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(
            viewport={"width": width, "height": height}, device_scale_factor=_PIXELS_PER_CSS_PIXEL
        )
        page.goto(address)
        time.sleep(after_s)
        page.screenshot(path=picture)
        browser.close()
