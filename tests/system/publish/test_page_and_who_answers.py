"""The page in Chromium with another unit at its address, a slow one, one with a history, and with a login."""

import asyncio
import contextlib
import re
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.async_api import Page, Route
from support.history import ABOUT, batch, beam, event, store, write_seconds
from support.measurements import measured
from support.page import browser
from support.picture_maker import Maker

from altd.config import HttpSettings
from altd.credentials.file import Credentials, save_credentials
from altd.credentials.hashes import PasswordHash
from altd.history.history import History
from altd.history.records import About
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.publisher import HttpPublisher
from altd.runtime.clock import SystemClock
from altd.status.board import Board
from altd.status.event_log import EventKind
from altd.status.health import Health
from altd.status.proof import Identity
from altd.status.services import KeptRecording, NotKeptError
from altd.status.unit import PublishedUnit, UnitFacts

pytestmark = pytest.mark.real_time

PASSWORD = "open sesame"
RECORDING = "20261120T012345Z-spot_missing-front"


class Keeper:
    """Has one recording."""

    recordings = (
        KeptRecording(
            name=RECORDING,
            why="spot_missing front",
            start=None,
            seconds=12.0,
            exposures=240,
            bytes=1 << 20,
            marked=False,
        ),
    )

    async def keep(self, why: str) -> KeptRecording:
        raise NotKeptError("not here")

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        raise NotKeptError("not here")

    async def files(self, name: str) -> list[str]:
        raise NotKeptError("not here")

    async def content(self, name: str, file: str) -> bytes | None:
        raise NotKeptError("not here")


def remembered(folder: Path, serial: str, x_mm: float) -> History:
    """The history of a unit that measured one x for the last minutes."""
    folder.mkdir()
    writing = store(folder, About(ABOUT.columns, {"serial": serial}))
    write_seconds(writing, int(time.time()) - 300, [x_mm] * 200)
    writing.end(None)
    return History(folder / "history.db", serial=serial)


@contextlib.asynccontextmanager
async def unit(
    serial: str, port: int = 0, history: History | None = None, credentials: Path | None = None
) -> AsyncIterator[int]:
    """A unit that measures; gives its port."""
    clock = SystemClock()
    board, health = Board(clock, 1.0, QUANTITIES, Identity.drawn(serial)), Health(clock)
    health.component("camera front").observe({"exposure_ms": 4.0, "gain_db": 0.0})
    health.component("camera front").count("lost", 2)
    health.component("measuring").count("dropped_front", 1)
    health.component("temperature camera front").observe({"celsius": 31.2})
    published = PublishedUnit(board, health, UnitFacts(serial=serial, version="0"))
    published.pictures.open(Maker())
    published.recordings.open(Keeper())
    settings = HttpSettings(host="127.0.0.1", port=port, credentials=credentials)
    publisher = HttpPublisher(settings, published, health.component("http"), history)
    ready, ends = asyncio.Event(), asyncio.Event()

    async def measure() -> None:
        number = 0
        while not ends.is_set():
            number += 1
            now_ns = clock.monotonic_ns()
            board.publish(measured(beam(1.0), sequence=number, t_ns=now_ns, time=datetime.now(UTC)))
            await asyncio.sleep(0.1)

    serving, measuring = asyncio.create_task(publisher.run(ready.set)), asyncio.create_task(measure())
    try:
        await ready.wait()
        yield publisher.port
    finally:
        ends.set()
        serving.cancel()
        await asyncio.gather(serving, measuring, return_exceptions=True)
        if history is not None:
            await history.end()


@contextlib.asynccontextmanager
async def page() -> AsyncIterator[Page]:
    async with browser() as started:
        yield await started.new_page(accept_downloads=True)


async def trend_in(shown: Page) -> set[str]:
    """The means of x that the plot is made of, as its CSV has them."""
    async with shown.expect_download() as coming:
        await shown.get_by_role("link", name="Download as CSV").click()
    head, *rows = (await (await coming.value).path()).read_text().splitlines()
    place = head.split(",").index("x_mm_mean")
    return {row.split(",")[place] for row in rows}


async def test_a_past_of_another_unit_is_not_shown_for_this_one(tmp_path: Path) -> None:
    async with page() as shown:
        async with unit("A-1", history=remembered(tmp_path / "a", "A-1", 10.0)) as port:
            await shown.goto(f"http://127.0.0.1:{port}/#trends")
            await shown.get_by_text("A-1").wait_for()
            await shown.get_by_role("button", name="1 day").click()
            assert await trend_in(shown) == {"10"}
        async with unit("B-2", port, remembered(tmp_path / "b", "B-2", -50.0)):
            await shown.get_by_text("B-2").wait_for()
            await asyncio.sleep(1.0)
            assert await trend_in(shown) == {"-50"}


async def test_frames_that_had_to_make_room_are_not_offered(tmp_path: Path) -> None:
    remembered(tmp_path / "a", "A-1", 10.0)
    now_s, noted = time.time(), []
    for number, name in enumerate((RECORDING, "20251120T012345Z-spot_missing-front"), 1):
        noted.append(
            replace(event(number, now_s, EventKind.RECORDING, text=name), detail={"recording": name})
        )
    writing = store(tmp_path / "a", About(ABOUT.columns, {"serial": "A-1"}))
    writing.write(batch(now_s, [], noted))
    writing.end(None)
    history = History(tmp_path / "a" / "history.db")
    async with page() as shown, unit("A-1", history=history) as port:
        await shown.goto(f"http://127.0.0.1:{port}/#events")
        there, gone = (shown.locator(".events tr").filter(has_text=each.text) for each in noted)
        await there.get_by_role("link", name="Download frames").wait_for()
        await gone.get_by_text("the frames were deleted").wait_for()
        assert await gone.get_by_role("link").count() == 0


async def test_a_unit_that_answers_slowly_is_not_asked_by_ever_more(tmp_path: Path) -> None:
    asked, go_on = list[str](), asyncio.Event()

    async def hold(route: Route) -> None:
        asked.append(route.request.url)
        await go_on.wait()
        await route.continue_()

    async with page() as shown, unit("A-1", history=remembered(tmp_path / "a", "A-1", 10.0)) as port:
        await shown.goto(f"http://127.0.0.1:{port}/")
        await shown.get_by_text("A-1").wait_for()
        await shown.route("**/api/v1/events**", hold)
        await shown.get_by_role("link", name="Events").click()
        await asyncio.sleep(6.0)  # it asks each 5 s
        assert len(asked) == 1
        go_on.set()
        await shown.get_by_text("new history file created").wait_for()


async def test_who_may_not_see_pictures_is_told_to_log_in(tmp_path: Path) -> None:
    credentials = tmp_path / "credentials"
    save_credentials(credentials, Credentials({"ana": PasswordHash.of(PASSWORD)}, {}))
    credentials.chmod(0o600)

    async def told_to_log_in(shown: Page) -> None:
        await shown.get_by_role("link", name="Overview").click()
        await shown.get_by_text("To see the pictures, log in first.").wait_for()
        await shown.get_by_role("link", name="Events").click()
        await shown.get_by_text("To download them, log in first.").wait_for()
        act = shown.get_by_role("button", name="Record the last seconds")
        assert await act.is_disabled()
        assert await act.locator("xpath=following-sibling::*[1]").get_by_text("log in first").count() == 1
        assert await shown.get_by_role("button", name="Protect").is_disabled()
        assert await shown.get_by_role("link", name=f"{RECORDING}.tar").count() == 0

    async with page() as shown, unit("A-1", credentials=credentials) as port:
        await shown.goto(f"http://127.0.0.1:{port}/")
        await told_to_log_in(shown)
        await shown.get_by_role("link", name="log in").first.click()
        await shown.get_by_label("name").fill("ana")
        await shown.get_by_label("password").fill(PASSWORD)
        await shown.get_by_role("button", name="log in").click()
        await shown.get_by_role("button", name="log out").wait_for()
        await shown.get_by_role("link", name="Overview").click()
        await shown.locator("figure.target").nth(1).wait_for()
        await shown.get_by_role("link", name="Events").click()
        await shown.get_by_role("link", name=f"{RECORDING}.tar").wait_for()

        await shown.context.clear_cookies()  # as when the session is over
        await shown.get_by_role("button", name="Record the last seconds").click()
        await told_to_log_in(shown)


async def test_parts_have_readings_and_an_action_that_is_not_possible_its_reason() -> None:
    async with page() as shown, unit("A-1") as port:
        await shown.goto(f"http://127.0.0.1:{port}/#unit")
        check = shown.get_by_role("button", name="Check now")
        reason = check.locator("xpath=following-sibling::*[1]").get_by_text("this unit has no frame LEDs")
        await reason.wait_for()
        assert await check.is_disabled()
        camera = shown.locator(".parts tr").filter(
            has=shown.get_by_role("rowheader", name="camera front", exact=True)
        )
        assert "31.2 °C, exposure 4.00 ms, 3 lost frames" in await camera.inner_text()


TICKS = """{
    const drawn = globalThis.drawn = new Map();
    const { clearRect, fillText } = CanvasRenderingContext2D.prototype;
    CanvasRenderingContext2D.prototype.clearRect = function (...at) {
        drawn.set(this.canvas, []);
        clearRect.apply(this, at);
    };
    CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {
        drawn.get(this.canvas)?.push(text);
        fillText.call(this, text, ...at);
    };
}"""
"""Keeps the texts that are on each canvas: the labels of the axes."""


async def ticks_of(shown: Page) -> list[tuple[list[str], list[float]]]:
    """The labels in time and of values, of each plot."""
    drawn: list[list[str]] = await shown.evaluate(
        "[...drawn].filter(([plot]) => plot.isConnected).map(([, texts]) => texts)"
    )
    return [
        (
            [text for text in texts if ":" in text],
            [float(text.replace("\N{MINUS SIGN}", "-")) for text in texts if ":" not in text],
        )
        for texts in drawn
    ]


@pytest.mark.parametrize("size", [(390, 844), (1280, 900)], ids=["phone", "desk"])
async def test_trends_are_filled_from_the_history_at_once_and_have_three_ticks(
    tmp_path: Path, size: tuple[int, int]
) -> None:
    """The unit measured x = 10 mm in the last minutes, and 1 mm since the page was opened."""
    async with page() as shown, unit("A-1", history=remembered(tmp_path / "a", "A-1", 10.0)) as port:
        await shown.set_viewport_size({"width": size[0], "height": size[1]})
        await shown.add_init_script(TICKS)
        await shown.goto(f"http://127.0.0.1:{port}/#trends")
        await shown.locator(".uplot").nth(3).wait_for()
        plots = []
        async with asyncio.timeout(2.0):
            while not plots or max(plots[0][1], default=0) < 5:
                await asyncio.sleep(0.1)
                plots = await ticks_of(shown)
        assert len(plots) == 4
        for times, values in plots:
            assert len(set(times)) == len(times) >= 3
            assert len(set(values)) == len(values) >= 3


async def test_a_plot_has_its_values_under_the_pointer_and_in_a_table(tmp_path: Path) -> None:
    async with page() as shown, unit("A-1", history=remembered(tmp_path / "a", "A-1", 10.0)) as port:
        await shown.goto(f"http://127.0.0.1:{port}/#trends")
        for span, name in (("10 minutes", "value"), ("1 hour", "mean")):
            await shown.get_by_role("button", name=span).click()
            plot = shown.locator("figure.plot").first
            await plot.locator(".u-legend").get_by_text(name).wait_for()
            area, lane = plot.locator(".u-over"), shown.locator(".lane")
            await area.hover()
            await plot.locator(".u-legend").get_by_text("10.000").first.wait_for()
            await plot.get_by_text("Table of x, mm").click()
            await plot.get_by_role("cell", name="10.000").first.wait_for()
            places = [await part.bounding_box() for part in (area, lane)]
            edges = [(box["x"], box["x"] + box["width"]) for box in places if box is not None]
            assert edges[0] == pytest.approx(edges[1], abs=2)
            assert re.search(r"(valid|good) \d", await shown.locator(".key").inner_text())


async def test_the_range_of_the_trends_is_kept(tmp_path: Path) -> None:
    async with page() as shown, unit("A-1", history=remembered(tmp_path / "a", "A-1", 10.0)) as port:
        await shown.goto(f"http://127.0.0.1:{port}/#trends")
        await shown.get_by_role("button", name="1 day").click()
        await shown.reload()
        await shown.get_by_role("button", name="1 day", pressed=True).wait_for()
        await shown.evaluate("localStorage.setItem('span of the trends', '\"2 hours\"')")
        await shown.reload()
        await shown.get_by_role("button", name="10 minutes", pressed=True).wait_for()


async def test_an_event_that_ended_is_not_coloured(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    now_s, writing = time.time(), store(tmp_path / "a", About(ABOUT.columns, {"serial": "A-1"}))
    kinds = (EventKind.CAUSE_CAME, EventKind.CAUSE_WENT)
    writing.write(batch(now_s, [], [event(n, now_s, kind, 4, f"n{n}") for n, kind in enumerate(kinds, 1)]))
    writing.end(None)
    async with page() as shown, unit("A-1", history=History(tmp_path / "a" / "history.db")) as port:
        await shown.goto(f"http://127.0.0.1:{port}/#events")
        began, ended = (
            shown.locator(".events tr").filter(has_text=each).locator("td").nth(1) for each in ("n1", "n2")
        )
        await began.wait_for()
        assert [await each.inner_text() for each in (began, ended)] == ["began", "ended"]
        colours = [await each.evaluate("cell => getComputedStyle(cell).color") for each in (began, ended)]
        plain = await shown.locator(".events td").first.evaluate("cell => getComputedStyle(cell).color")
        assert colours[1] == plain != colours[0]
