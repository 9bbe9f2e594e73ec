"""The built documentation in Chromium, from disk: the words of the screens lead to their place."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.async_api import Page
from support.page import SIZES, browser
from support.places import ROOT

from altd.reasons import Reason
from altd.status.cause import Kind
from altd.status.conditions import Condition

KINDS: tuple[Kind, ...] = (*Reason, *Condition)
_FIRST = """() => {
  const titles = ".md-search-result__item:first-child article > :is(h1, h2)";
  const [page, section] = document.querySelectorAll(titles);
  return `${page?.innerText}: ${section?.innerText}`;
}"""
"""Titles of the page that the search shows first, and of its first section."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        check=True,
    )
    return folder


def _title(kind: Kind) -> str:
    return f"Reasons and states: {kind.brief} ({kind})"


async def _first_found(page: Page, typed: str, wanted: set[str]) -> str:
    """First result of the search, or a wanted title as soon as it is shown."""
    await page.fill("input.md-search__input", typed)
    await page.press("input.md-search__input", "End")
    found = ""
    for _ in range(100):
        found = await page.evaluate(_FIRST)
        if found in wanted:
            break
        await asyncio.sleep(0.05)
    return found


def test_what_a_screen_says_is_found_first_by_the_search(site: Path) -> None:
    async def searched() -> dict[str, str]:
        wrong = {}
        async with browser() as chromium:
            page = await chromium.new_page()
            await page.goto(f"{site.as_uri()}/index.html")
            await page.click("input.md-search__input")
            for kind in KINDS:
                same = {_title(other) for other in KINDS if other.brief == kind.brief}
                for typed, wanted in ((kind.brief, same), (str(kind), {_title(kind)})):
                    if (found := await _first_found(page, typed, wanted)) not in wanted:
                        wrong[typed] = found
        return wrong

    assert asyncio.run(searched()) == {}


def test_a_phone_shows_the_whole_page_of_reasons(site: Path) -> None:
    async def beyond_px() -> list[str]:
        async with browser() as chromium:
            width, height = SIZES["phone"]
            page = await chromium.new_page(viewport={"width": width, "height": height})
            await page.goto(f"{site.as_uri()}/reasons.html#{Reason.SPOT_MISSING}")
            picture = os.environ.get("ALTD_PICTURES")
            if picture:
                await page.screenshot(path=f"{picture}/reasons-phone.png")
            found: list[str] = await page.evaluate(
                """() => [...document.querySelectorAll("article h4, article p, article table")]
                .filter(part => part.getBoundingClientRect().right > innerWidth)
                .map(part => part.innerText)"""
            )
            return found

    assert asyncio.run(beyond_px()) == []
