"""The view Unit in Chromium: the calibration with its file and report, self-checks so far, diagnostics."""

import asyncio
import filecmp
import json
import re
import shutil
import zipfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Browser
from support.led_unit import LedUnit
from support.page import SIZES, Seen, browser, picture, seen, watched_unit

from altd.measuring.calibration import Calibration
from altd.status.event_log import Event, EventKind, EventLog

pytestmark = [pytest.mark.real_time, pytest.mark.asyncio(loop_scope="module")]

REPORT = """<!DOCTYPE html>
<html><head><meta charset="utf-8">
<meta name="altd-calibration" content="{checksum}">
<title>quiet</title></head>
<body><p>residuals</p><img src="/api/v1/status">
<form action="/api/v1/logout" method="post"><button>x</button></form>
<script>document.title = "it ran"; fetch("/api/v1/status");</script>
<iframe src="/"></iframe></body></html>
"""
"""One that would act, could it."""

NO_PROSE = "<img src=x onerror=\"document.title='it ran'\"><script>document.title='it ran'</script>"


@pytest.fixture(scope="module")
def calibration_file(unit_3: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copy(unit_3 / "cal.json", tmp_path_factory.mktemp("unit") / "unit-3.json"))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def started() -> AsyncIterator[Browser]:
    async with browser() as started:
        yield started


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def running(calibration_of_unit_3: Calibration, calibration_file: Path) -> AsyncIterator[LedUnit]:
    """One unit for all tests."""
    async with watched_unit(calibration_of_unit_3, calibration_file.parent, calibration_file) as running:
        yield running


@pytest.fixture
def written(calibration_file: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(calibration_file.read_text())
    return content


def write_report(calibration_file: Path, checksum: str) -> None:
    calibration_file.with_suffix(".html").write_text(REPORT.format(checksum=checksum))


async def save(shown: Seen, name: str, path: Path) -> None:
    """As a person does who follows a link."""
    async with shown.page.expect_download() as coming:
        await shown.page.get_by_role("link", name=name, exact=True).click()
    await (await coming.value).save_as(path)


async def checks_noted(log: EventLog, number: int) -> list[Event]:
    """The events of self-checks, once that of check ``number`` is among them."""
    async with asyncio.timeout(20):
        while True:
            noted = [event for event in log.after(0) if event.kind is EventKind.SELF_CHECK]
            if noted and noted[-1].detail.get("number") == number:
                return noted
            await asyncio.sleep(0.05)


async def test_self_checks_so_far_are_listed_and_drawn_and_diagnostics_are_given(
    started: Browser, calibration_of_unit_3: Calibration, calibration_file: Path, tmp_path: Path
) -> None:
    """On a unit of its own, and before the others' one runs."""
    async with (
        watched_unit(calibration_of_unit_3, tmp_path, calibration_file) as running,
        seen(started, running, goes_on=False, accept_downloads=True) as shown,
    ):
        events = running.daemon.health.events
        section = shown.page.get_by_role("region", name="Earlier self-checks", exact=True)
        reports = [await running.check() for _ in range(2)]
        noted = await checks_noted(events, reports[-1].number)
        await shown.open("unit")
        await section.locator(".events tbody tr").nth(len(noted) - 1).wait_for(timeout=60_000)
        checked = shown.page.locator("#cross-check tbody tr")
        await checked.nth(1).wait_for(timeout=60_000)
        for target, row in zip(("front", "rear"), await checked.all_inner_texts(), strict=True):
            assert re.fullmatch(rf"{target}\s\d+\.\d\d, \d+\.\d\d\s−?\d+\.\d{{3}}, −?\d+\.\d{{3}}", row)
        await picture(shown, "page-unit", section)
        events.note(
            EventKind.SELF_CHECK, NO_PROSE, None, 4, {"verdict": NO_PROSE, "shift_px": {"front": "x"}}
        )
        events.note(EventKind.SELF_CHECK, "odd", None, 4, {"verdict": None, "shift_px": [1, 2], "cause": {}})
        await section.locator(".events tbody tr").nth(len(noted) + 1).wait_for(timeout=60_000)
        rows = [await row.inner_text() for row in await section.locator(".events tbody tr").all()]
        assert "odd" in rows[0]
        assert NO_PROSE in rows[1]
        for row, event in zip(rows[2:], reversed(noted), strict=True):
            assert event.text in row
        for row, report in zip(rows[2:4], reversed(reports), strict=True):
            assert report.check.sentence in row
            assert str(report.check.verdict) in row
        assert await section.locator(".uplot").count() == 2
        assert await section.locator("img, script").count() == 0
        assert await shown.page.title() != "it ran"
        assert (await shown.now())["overflow"] <= 0

        await save(shown, "Download diagnostics", tmp_path / "got.zip")
        with zipfile.ZipFile(tmp_path / "got.zip") as archive:
            assert {"README.txt", "status.json", "settings.json", "versions.txt", "trend.csv"} <= set(
                archive.namelist()
            )
            told = [json.loads(line) for line in archive.read("events.jsonl").decode().splitlines()]
        assert [each["text"] for each in told if each["text"] == NO_PROSE] == [NO_PROSE]
        assert shown.complaints == []


async def test_the_calibration_is_told_and_its_file_and_report_are_given(
    started: Browser, running: LedUnit, calibration_file: Path, written: dict[str, Any], tmp_path: Path
) -> None:
    write_report(calibration_file, written["checksum"])
    async with seen(started, running, accept_downloads=True) as shown:
        await shown.open("unit")
        section = shown.page.get_by_role("region", name="Calibration", exact=True)
        await section.get_by_text("Made from SIMULATED frames").wait_for()
        rows = {
            await row.get_by_role("rowheader").inner_text(): await row.get_by_role("cell").all_inner_texts()
            for row in await section.locator("tbody tr").all()
        }
        for number, target in enumerate(written["targets"]):
            residuals = [float(f"{target['residuals'][key]:.4g}") for key in ("mean_mm", "std_mm", "max_mm")]
            assert rows["residual mean, std, max, mm"][number] == ", ".join(
                f"{each:.4f}" for each in residuals
            )
            assert rows["frame LEDs"][number] == str(len(target["leds_px"]))
        await save(shown, "Download the file", tmp_path / "got.json")
        assert filecmp.cmp(tmp_path / "got.json", calibration_file, shallow=False)

        async with shown.page.expect_popup() as coming:
            await section.get_by_role("link", name="Report").click()
        popup = await coming.value
        await popup.get_by_text("residuals").wait_for()  # a tab that only begins cannot be loaded again
        answered: list[str] = []
        popup.on("response", lambda response: answered.append(response.url.partition("/api/v1")[2]))
        await popup.reload()
        await popup.get_by_text("residuals").wait_for()
        assert await popup.title() == "quiet", "a script of the report ran"
        assert answered == ["/calibration/report"]
        await popup.get_by_role("button").click()
        assert popup.url.endswith("/api/v1/calibration/report"), "its form was sent"
        await popup.close()

        write_report(calibration_file, f"sha256:{'0' * 64}")
        await shown.page.reload()
        await section.get_by_text("is the report of another calibration").wait_for()
        assert await section.get_by_role("link", name="Report").count() == 0


@pytest.mark.parametrize("size", [SIZES["phone"], (320, 568)])
async def test_on_a_phone_nothing_is_wider_than_the_screen(
    started: Browser, running: LedUnit, size: tuple[int, int]
) -> None:
    async with seen(started, running, size) as shown:
        for view in ("", "drive", "trends", "events", "unit"):
            await shown.open(view)
            await shown.page.locator("main section").first.wait_for()
            assert (await shown.now())["overflow"] <= 0, view


@pytest.mark.parametrize(
    ("size", "ratio", "wished"),
    [
        ((1280, 800), 1.5, ("7", "5", "25")),
        ((1180, 820), 2.0, ("8", "6", "20.3")),
        ((1366, 768), 1.0, ("6", "4", "28")),
    ],
)
async def test_a_screen_shows_the_plate_that_its_option_states(
    started: Browser, running: LedUnit, size: tuple[int, int], ratio: float, wished: tuple[str, str, str]
) -> None:
    """The discs of the screenshot, counted and placed by OpenCV; a pixel is 0.2 mm wide by the ruler."""
    async with seen(started, running, size, device_scale_factor=ratio) as shown:
        page = shown.page
        await page.goto(f"http://127.0.0.1:{shown.cable.port}/screen")
        await page.context.set_offline(True)  # as if the daemon were stopped
        assert await page.locator("#option").text_content() == "length: a number from 20 to 3000"
        assert await page.locator("#show").is_disabled()
        bar = await _lit(shown)
        (bar_px,) = (int(width) for width, height in bar.stats[1:, 2:4] if width > 10 * height)
        await page.locator("#length").fill(f"{bar_px * 0.2:.4f}")
        for name, text in zip(("columns", "rows", "pitch"), wished, strict=True):
            await page.locator(f"#{name}").fill(text)
        option = re.fullmatch(
            r"--plate (\d+),(\d+),([\d.]+),([\d.]+)", await page.locator("#option").inner_text()
        )
        assert option is not None
        row = await page.locator("#row").inner_text()
        await page.locator("#show").click()
        discs = await _lit(shown)
        assert [option[1], option[2]] == list(wished[:2])
        columns, rows, pitch_mm, sigma_mm = int(option[1]), int(option[2]), float(option[3]), float(option[4])
        assert len(discs.stats) - 1 == columns * rows
        order = np.lexsort((discs.centroids[1:, 0], np.rint(discs.centroids[1:, 1])))
        grid = discs.centroids[1:][order].reshape(rows, columns, 2)
        steps_px = np.diff(grid, axis=1)[..., 0], np.diff(grid, axis=0)[..., 1]
        assert np.ptp(steps_px[0]) < 1e-9
        assert np.ptp(steps_px[1]) < 1e-9
        assert steps_px[0][0, 0] == pytest.approx(steps_px[1][0, 0], abs=1e-9)
        pitch_px = float(steps_px[0][0, 0])
        assert pitch_px == round(pitch_px)
        assert pitch_mm == pytest.approx(pitch_px * 0.2, abs=1e-4)
        assert pitch_mm == pytest.approx(float(wished[2]), abs=0.1)
        assert float(row.removesuffix(" mm")) == pytest.approx((columns - 1) * pitch_px * 0.2, abs=0.06)
        assert sigma_mm / pitch_mm == pytest.approx(0.5 / 3**0.5 / (bar_px * 0.2), rel=0.01)
        middle = (grid[0, 0] + grid[-1, -1]) / 2 + 0.5
        assert middle == pytest.approx(np.multiply(size, ratio) / 2, abs=1.0)
        async with asyncio.timeout(10):
            while len((await _lit(shown)).stats) > 1:  # noqa: ASYNC110  a picture says nothing unasked
                await asyncio.sleep(0.1)
        for key in ("ArrowRight", "ArrowUp", "ArrowUp"):
            await page.keyboard.press(key)
        async with asyncio.timeout(10):
            while len((moved := await _lit(shown)).stats) == 1:  # noqa: ASYNC110  the same
                await asyncio.sleep(0.1)
        steps_px = (moved.centroids - discs.centroids)[1:].mean(axis=0) * (1, -1)
        assert np.abs(np.subtract(steps_px, np.multiply((1, 2), pitch_px / 4))).max() <= 0.5 + 1e-6
        await page.keyboard.press("x")
        assert await page.locator("#setup").is_visible()
        said = (await page.locator("#option").inner_text()).removeprefix(f"{option[0]} --shift=")
        assert [float(text) for text in said.split(",")] == pytest.approx(steps_px * 0.2, abs=1e-4)
        assert shown.complaints == []


ELSEWHERE = "another screen or zoom: measure the bar again"


@pytest.mark.parametrize(
    ("size", "screen", "ratio", "pinched", "says"),
    [
        ((1000, 700), (1366, 768), 1.0, 1.0, None),  # the window alone
        ((300, 700), (1366, 768), 1.0, 1.0, "does not fit: 3 columns, 6 rows at most, or a smaller pitch"),
        ((768, 1366), (768, 1366), 1.0, 1.0, None),  # the screen was turned
        ((1366, 768), (1366, 768), 1.25, 1.0, ELSEWHERE),
        ((1093, 614), (1366, 768), 1.25, 1.0, ELSEWHERE),
        ((1366, 768), (1920, 1080), 1.0, 1.0, ELSEWHERE),
        ((1366, 768), (1366, 768), 1.0, 1.5, "the page is zoomed with two fingers: zoom out"),
    ],
)
async def test_a_plate_that_is_shown_keeps_its_pitch_or_the_page_says_why_not(
    started: Browser,
    running: LedUnit,
    size: tuple[int, int],
    screen: tuple[int, int],
    ratio: float,
    pinched: float,
    says: str | None,
) -> None:
    """The window, the screen, its pixels and the zoom change while the discs are shown."""
    width, height = 1366, 768
    async with seen(started, running, (width, height), screen={"width": width, "height": height}) as shown:
        page, option = shown.page, shown.page.locator("#option")
        await page.goto(f"http://127.0.0.1:{shown.cable.port}/screen")
        for name, text in {"length": "273,5", "columns": "4", "rows": "4", "pitch": "25"}.items():
            await page.locator(f"#{name}").fill(text)
        stated = await option.text_content()
        await page.locator("#show").click()
        step_px = await _step_px(shown)
        devtools = await page.context.new_cdp_session(page)
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": ratio, "mobile": False}
        metrics |= {"screenWidth": screen[0], "screenHeight": screen[1]}
        await devtools.send("Emulation.setDeviceMetricsOverride", metrics)
        await devtools.send("Emulation.setPageScaleFactor", {"pageScaleFactor": pinched})
        if says is None:
            while not await page.evaluate("plate.width === innerWidth"):  # noqa: ASYNC110  in a page without eval
                await asyncio.sleep(0.05)
            assert await _step_px(shown) == step_px
            await page.keyboard.press("x")
        await page.locator("#setup").wait_for()
        assert await option.text_content() == (says or stated)
        assert shown.complaints == []


async def _step_px(shown: Seen) -> float:
    """Distance of neighbours in the first row of sixteen discs."""
    while len((found := await _lit(shown)).centroids) != 17:  # noqa: ASYNC110  they are lit again unasked
        await asyncio.sleep(0.1)
    columns = np.unique(np.rint(2 * found.centroids[1:, 0]) / 2)
    assert np.ptp(np.diff(columns)) == 0
    return float(columns[1] - columns[0])


async def test_a_plate_is_described_by_what_was_entered_and_by_no_accident(
    started: Browser, running: LedUnit
) -> None:
    """A decimal comma; numbers that are none; a touch that ends the picture and moves; a larger window."""
    async with seen(started, running, (1366, 768)) as shown:
        page, option = shown.page, shown.page.locator("#option")
        await page.goto(f"http://127.0.0.1:{shown.cable.port}/screen")
        for name, label, text in [
            *(("pitch", "pitch", text) for text in ("", "-5", "1e9", "abc", "1.234,5", "5 mm", "0", "NaN")),
            ("columns", "columns", "3"),
            ("error", "read to ±", "0"),
            ("disc", "discs", "1e9"),
        ]:
            await page.locator("#length").fill("273,5")
            usual = await page.locator(f"#{name}").input_value()
            await page.locator(f"#{name}").fill(text)
            assert str(await option.text_content()).startswith(f"{label}: a number from ")
            assert await page.locator("#show").is_disabled()
            await page.locator(f"#{name}").fill(usual)
        await page.locator("#pitch").fill("12,5")
        stated = str(await option.text_content())
        assert float(stated.split(",")[2]) == pytest.approx(12.5, abs=0.1)
        await page.locator("#show").click()
        await page.mouse.move(500, 40)
        await page.mouse.down()
        await page.mouse.move(420, 41)
        await page.mouse.up()
        await page.mouse.click(20, 600)
        await page.set_viewport_size({"width": 1500, "height": 800})
        await page.locator("#length").fill("273,5")
        assert await option.text_content() == stated


@dataclass(frozen=True)
class _Lights:
    stats: np.ndarray
    """Left, top, width, height and area (n + 1, 5) of the white parts; the first is the ground."""
    centroids: np.ndarray


async def _lit(shown: Seen) -> _Lights:
    """White parts of the picture."""
    raw = np.frombuffer(await shown.page.locator("#plate").screenshot(scale="device"), np.uint8)
    grey = cv2.imdecode(raw, cv2.IMREAD_GRAYSCALE)
    _, _, stats, centroids = cv2.connectedComponentsWithStats((grey > 127).astype(np.uint8))
    return _Lights(stats, centroids)
