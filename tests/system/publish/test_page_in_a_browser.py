"""The page in Chromium, of a whole daemon on simulated cameras: what a person sees is what the unit says."""

import asyncio
import math
import re
import subprocess
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import axe_playwright_python
import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Browser
from support.cli import altd_here
from support.led_unit import LedUnit
from support.page import POSE, SIZES, UNKNOWN, browser, picture, seen, watched_unit

from altd.measuring.calibration import Calibration
from altd.ports import CameraLostError
from altd.records import Frame, Measurement
from hw_sim.beam import BeamPose
from hw_sim.unit import FRONT, REAR

pytestmark = [pytest.mark.real_time, pytest.mark.asyncio(loop_scope="module")]

GREEN = """[...document.querySelectorAll("figure.target canvas")].map(canvas => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let green = 0;
    for (let i = 0; i < data.length; i += 4) green += data[i + 1] > 200 && data[i] < 120 && data[i + 2] < 160;
    return green;
})"""
AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js")
SHOWN_WITHIN_S = 1.0
TRIES = 3
BLANK_WITHIN_S = 2.0
WITH_PAST = pytest.mark.parametrize("running", [True], indirect=True, ids=["with past"])


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def started() -> AsyncIterator[Browser]:
    async with browser() as started:
        yield started


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def running(
    request: pytest.FixtureRequest,
    calibration_of_unit_3: Calibration,
    tmp_path_factory: pytest.TempPathFactory,
) -> AsyncIterator[LedUnit]:
    """One unit for all tests, or for those with a past one that keeps its history and its frames."""
    folder = tmp_path_factory.mktemp("past") if getattr(request, "param", False) else None
    async with watched_unit(calibration_of_unit_3, folder) as running:
        yield running


def shown_as(value: float | None, decimals: int) -> str:
    """As the page does with what JSON has, a decimal more."""
    return (
        UNKNOWN
        if value is None
        else f"{round(value, decimals + 1):.{decimals}f}".replace("-", "\N{MINUS SIGN}")
    )


Spoil = Callable[[Frame], Frame]


def only(camera: str, spoil: Spoil) -> Spoil:
    return lambda frame: spoil(frame) if frame.camera == camera else frame


def dark(frame: Frame) -> Frame:
    return replace(frame, pixels=np.minimum(frame.pixels, 12))


def twice(frame: Frame) -> Frame:
    """A reflection: the spot once more, elsewhere."""
    return replace(frame, pixels=np.maximum(frame.pixels, np.roll(frame.pixels, (-110, 140), (0, 1))))


def burnt(frame: Frame) -> Frame:
    return replace(frame, pixels=np.clip(frame.pixels.astype(int) * 12, 0, 255).astype(np.uint8))


def turned(frame: Frame) -> Frame:
    return replace(frame, pixels=np.ascontiguousarray(frame.pixels[::-1, ::-1]))


class Frozen:
    """The camera delivers its last picture again and again."""

    def __init__(self) -> None:
        self._kept: Frame | None = None

    def __call__(self, frame: Frame) -> Frame:
        self._kept = self._kept or frame
        return replace(frame, pixels=self._kept.pixels)


def lost(frame: Frame) -> Frame:
    raise CameraLostError("the cable was pulled")


FAULTS: dict[str, tuple[str, Callable[[LedUnit], None]]] = {
    "front covered": ("spot_missing", lambda unit: setattr(unit.seen, "alter", only(FRONT, dark))),
    "rear covered": ("spot_missing", lambda unit: setattr(unit.seen, "alter", only(REAR, dark))),
    "laser off": ("spot_missing", lambda unit: setattr(unit.seen, "alter", dark)),
    "a reflection": ("ambiguous", lambda unit: setattr(unit.seen, "alter", only(FRONT, twice))),
    "overexposed": ("saturated", lambda unit: setattr(unit.seen, "alter", only(REAR, burnt))),
    "a frozen camera": ("frame_repeated", lambda unit: setattr(unit.seen, "alter", only(REAR, Frozen()))),
    "a camera turned round": ("wrong_camera", lambda unit: setattr(unit.seen, "alter", only(FRONT, turned))),
    "a cable pulled": ("camera_silent", lambda unit: setattr(unit.seen, "alter", only(REAR, lost))),
    "beside the area": ("out_of_range", lambda unit: unit.unit.place(BeamPose(90.0, 0.0, 0.0, 0.0))),
    "lamps that fail": ("lamps_failed", lambda unit: setattr(unit.leds, "refuses", "no such chip")),
}


def says_what_is_wrong(code: str, remedy: str) -> Callable[[dict[str, Any]], bool]:
    """That the page shows a cause with its remedy, and no value where the cause leaves none."""

    def says(now: dict[str, Any]) -> bool:
        is_without_value = (now["verdict"], now["values"]["x_mm"]) == ("not valid", UNKNOWN)
        return now["causes"].get(code) == remedy and (is_without_value or code == "lamps_failed")

    return says


def now_wrong(running: LedUnit) -> dict[str, str]:
    """The faults that the unit itself shows, with their remedies."""
    return {str(shown.cause.kind): shown.cause.remedy for shown in running.daemon.state.read().causes}


async def said(running: LedUnit, code: str, is_said: bool) -> None:
    """Wait until the unit says that this is wrong, or that it is not."""
    async with asyncio.timeout(30):
        while (code in now_wrong(running)) is not is_said:  # noqa: ASYNC110  found out when it is asked for
            await asyncio.sleep(0.01)


async def test_each_of_ten_faults_shows_cause_and_remedy_within_a_second(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    """On a unit of its own, before the others' one runs; again for what a busy machine has delayed."""
    late_s: dict[str, float] = {}
    async with (
        watched_unit(calibration_of_unit_3) as running,
        seen(started, running, goes_on=False) as shown,
    ):
        await said(running, "starting", False)
        await said(running, "self_checking", False)
        for name, (code, spoil) in [fault for fault in FAULTS.items() for _ in range(TRIES)]:
            if late_s.get(name, math.inf) <= SHOWN_WITHIN_S:
                continue
            spoil(running)
            if code == "lamps_failed":
                running.daemon.unit.self_check.ask()
            await said(running, code, True)
            late_s[name] = await shown.until(says_what_is_wrong(code, now_wrong(running)[code]))
            if name == "front covered":
                await shown.until_pictures()
                await picture(shown, "page-fault")
            running.seen.alter = lambda frame: frame
            running.leds.refuses = ""
            running.unit.place(POSE)
            await running.measured(valid=True)
            await shown.until_measured()
            await said(running, code, False)
        assert max(late_s.values()) <= SHOWN_WITHIN_S, late_s
        assert shown.complaints == []


@pytest.mark.parametrize("size", ["phone", "wall"])
async def test_the_page_shows_what_the_api_says_and_moving_pictures(
    started: Browser, running: LedUnit, size: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with seen(started, running, SIZES[size]) as shown:
        await shown.until_pictures()
        published = all_published(running, monkeypatch)
        pictures: set[str] = set()
        for _ in range(8):
            now = await shown.once(lambda now: now["sequence"] in published)
            pictures |= set(now["pictures"])
            measurement = published[now["sequence"]]
            for key, decimals in {"x_mm": 3, "y_mm": 3, "yaw_deg": 4, "pitch_deg": 4}.items():
                assert now["values"][key] == shown_as(measurement.number(key), decimals)
            await asyncio.sleep(0.15)
        assert len(pictures) >= 4
        assert min(await shown.page.evaluate(GREEN)) > 60, "the contour is drawn into the picture"
        assert now["overflow"] <= 0, "the page can be scrolled sideways"
        assert shown.complaints == []
        hosts = {url.split("/")[2] for url in shown.asked if not url.startswith(("data:", "blob:"))}
        assert hosts == {f"127.0.0.1:{shown.cable.port}"}


def all_published(running: LedUnit, monkeypatch: pytest.MonkeyPatch) -> dict[str, Measurement]:
    """Whatever the unit publishes from now on, by its number."""
    board, published = running.daemon.board, dict[str, Measurement]()
    publish = board.publish

    def keep(*finished: Any) -> Measurement:
        shown = publish(*finished)
        published[str(shown.sequence)] = shown
        return shown

    monkeypatch.setattr(board, "publish", keep)
    return published


async def test_a_unit_that_is_lost_is_blank_within_two_seconds_and_comes_back(
    started: Browser, running: LedUnit
) -> None:
    def is_blank(now: dict[str, Any]) -> bool:
        values = set(now["values"].values())
        return values == {UNKNOWN} and now["kind"] == "unknown" and not (now["causes"] or now["pictures"])

    async with seen(started, running) as shown:
        for _ in range(3):
            shown.cable.cut()
            assert await shown.until(is_blank) <= BLANK_WITHIN_S
            shown.cable.mend()
            await shown.until_measured()
            await shown.until_pictures()


LATE = """{
    const made = createImageBitmap;
    window.createImageBitmap = async blob => {
        const image = await made(blob);
        setTimeout(() => image.close());
        return image;
    };
}"""
"""Each picture is closed before it is drawn, as by the next one where a browser is busy."""


async def test_a_picture_that_is_overtaken_stops_nothing(started: Browser, running: LedUnit) -> None:
    async with seen(started, running) as shown:
        await shown.page.add_init_script(LATE)
        await shown.page.reload()
        await shown.until_measured()
        for _ in range(3):
            before = (await shown.now())["sequence"]
            await shown.until(lambda now, before=before: now["sequence"] != before)  # type: ignore[misc]
            await asyncio.sleep(0.5)
        assert shown.complaints == []


async def test_a_page_that_fails_shows_nothing_old_and_is_loaded_again(
    started: Browser, running: LedUnit
) -> None:
    eye = "export function Eyes() { if (globalThis.broken) throw new Error('a defect'); return null; }"
    async with seen(started, running) as shown:
        await shown.page.route(
            "**/page/eye.js", lambda route: route.fulfill(body=eye, content_type="text/javascript")
        )
        await shown.page.reload()
        await shown.until_measured()
        async with shown.page.expect_event("load"):
            await shown.page.evaluate("globalThis.broken = true")
            await shown.page.get_by_text("this page has failed and shows no values").wait_for(timeout=2000)
            assert "mm" not in await shown.page.inner_text("body")
        await shown.until_measured()


async def test_pictures_are_drawn_by_a_browser_that_draws_less_often_than_they_come(
    started: Browser, running: LedUnit
) -> None:
    async with seen(started, running) as shown:
        await shown.until_pictures()
        await shown.page.evaluate(
            """() => { const later = window.setTimeout;
                window.requestAnimationFrame = work => later(() => work(performance.now()), 700);
                window.setTimeout = (work, ms) => later(work, 700 + (ms ?? 0)); }"""
        )
        before = int((await shown.now())["sequence"])
        await shown.until(lambda now: int(now["sequence"] or 0) > before + 60)
        assert min(await shown.page.evaluate(GREEN)) > 60
        assert shown.complaints == []


async def test_nothing_is_sent_to_a_page_that_nobody_sees(started: Browser, running: LedUnit) -> None:
    async with seen(started, running) as shown:
        component = next(each for each in running.daemon.health if each.name.startswith("http "))
        await shown.until_pictures()
        await shown.page.evaluate(
            """() => { Object.defineProperty(document, 'hidden', {configurable: true, get: () => true});
                document.dispatchEvent(new Event('visibilitychange')); }"""
        )
        await asyncio.sleep(0.5)
        pictures = component.counters["pictures"]
        await asyncio.sleep(1.0)
        assert component.counters["pictures"] == pictures
        await shown.page.evaluate(
            "() => { delete document.hidden; document.dispatchEvent(new Event('visibilitychange')); }"
        )
        await shown.until_pictures()
        assert component.counters["pictures"] > pictures


@WITH_PAST
@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_who_cannot_see_it_can_use_it(started: Browser, running: LedUnit, scheme: str) -> None:
    async with seen(started, running, color_scheme=scheme) as shown:
        for view in ("", "drive", "trends", "events", "unit"):
            await shown.open(view)
            await asyncio.sleep(1.0)
            await shown.page.evaluate(AXE.read_text())
            found = await shown.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
            violations = [
                (each["id"], node["html"], node["failureSummary"])
                for each in found["violations"]
                for node in each["nodes"]
            ]
            assert violations == []
        # each view can be reached by keys alone
        await shown.open()
        order = []
        for _ in range(7):
            await shown.page.keyboard.press("Tab")
            order.append((await shown.now())["focused"])
        assert ": " in order[0], "the worst cause, which is a link to its explanation"
        assert order[1:6] == ["Overview", "Drive", "Trends", "Events", "Unit"]
        assert order[6].startswith("State")
        for _ in range(3):
            await shown.page.keyboard.press("Shift+Tab")
        assert (await shown.now())["focused"] == "Trends"
        await shown.page.keyboard.press("Enter")
        await shown.until(lambda now: now["plots"] == 4)


@WITH_PAST
async def test_was_it_all_right_then(started: Browser, running: LedUnit) -> None:
    """A fault is found by its time, here and there, by its kind and by its words."""
    facts = running.daemon.unit.facts
    running.daemon.unit.facts = facts.model_copy(update={"time_zone": "Asia/Kolkata"})
    running.seen.alter = dark
    await said(running, "spot_missing", True)
    await asyncio.sleep(4.0)
    running.seen.alter = lambda frame: frame
    async with seen(started, running) as shown:
        await shown.open("events")
        rows = shown.page.locator("table.events tbody tr")
        await rows.filter(has_text="switch the laser on").locator("td:first-child small").first.wait_for()
        cell = rows.filter(has_text="no laser spot").last.locator("td").first
        began, there = map(datetime.fromisoformat, (await cell.inner_text()).split("\n"))
        assert there - began == timedelta(hours=5, minutes=30)
        await shown.page.get_by_label("Search").fill("SWITCH the laser")
        await shown.page.get_by_label("Kind").select_option("began")
        for words in ("began", "switch the laser on"):
            await rows.filter(has_not_text=words).first.wait_for(state="detached")
        assert await rows.count() > 0
        await shown.page.get_by_label("Search").fill("")
        await shown.page.get_by_label("Kind").select_option("")
        field = shown.page.get_by_label("Time, UTC")
        await field.fill((began - timedelta(hours=1)).isoformat("T", "minutes"))
        await shown.page.get_by_text("nothing was measured then").wait_for()
        assert await rows.count() == 0
        await shown.page.get_by_role("link", name="Trends").click()
        await field.fill(began.isoformat("T", "minutes"))
        told = shown.page.get_by_text(
            re.compile(r" UTC: (no|\d+ % of the) measurements valid \(\w.*\), state \w")
        )
        await told.wait_for()
        await shown.until(lambda now: now["plots"] == 4)
        title = shown.page.get_by_role("heading", name=f"10 minutes around {began:%Y-%m-%d %H:%M} UTC")
        assert await title.count() == 1
    running.daemon.unit.facts = facts


@WITH_PAST
async def test_a_fault_at_night_is_replayed_in_the_morning(
    started: Browser, running: LedUnit, unit_3: Path, tmp_path: Path
) -> None:
    """As a technician does it: from the event on the page to the measurements of its frames on a laptop."""
    async with seen(started, running, accept_downloads=True) as shown:
        await asyncio.sleep(2.5)
        running.seen.alter = only(FRONT, dark)
        await said(running, "spot_missing", True)
        await asyncio.sleep(4.0)
        running.seen.alter = lambda frame: frame
        await shown.open("events")
        # on a slow machine there are others
        row = shown.page.locator(".events tbody tr").filter(has_text="spot_missing front")
        link = row.get_by_role("link", name="Download frames")
        await link.wait_for(timeout=20_000)
        rows = await shown.page.locator(".events tbody tr").all_inner_texts()
        assert any("no laser spot" in row and "switch the laser on" in row for row in rows)
        async with shown.page.expect_download() as coming:
            await link.click()
        got = await coming.value
        assert got.suggested_filename.endswith("-spot_missing-front.tar")
        await got.save_as(tmp_path / "got.tar")
        assert shown.complaints == []

        await shown.open("trends")
        await shown.page.get_by_role("button", name="1 hour").click()
        await shown.until(lambda now: now["plots"] == 4)
        async with shown.page.expect_download() as coming:
            await shown.page.get_by_role("link", name="Download as CSV").click()
        table = Path(await (await coming.value).path()).read_text().splitlines()  # noqa: ASYNC240
        assert table[0].startswith("time,n,n_valid,worst,x_mm_mean,x_mm_sigma,x_mm_low,x_mm_high,")
        assert len(table) > 1

        await shown.open("events")
        await shown.page.get_by_role("button", name="Record the last seconds").click()
        await shown.page.get_by_text("asked by http 127.0.0.1", exact=False).first.wait_for(timeout=20_000)
        await picture(shown, "page-events")
        assert shown.complaints == []
    subprocess.run(["tar", "-xf", tmp_path / "got.tar", "-C", tmp_path], check=True)  # noqa: ASYNC221
    folder = tmp_path / got.suggested_filename.removesuffix(".tar")
    replayed = altd_here("replay", folder, "--calibration", unit_3 / "cal.json", "--window", 4)
    assert replayed.status == 0, replayed.err
    assert any(line["valid"] for line in replayed.objects)
    assert "front_spot_missing" in replayed.objects[-1]["status"]
