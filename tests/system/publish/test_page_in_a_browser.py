"""The page in Chromium, of a whole daemon on simulated cameras: what a person sees is what the unit says."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import axe_playwright_python
import numpy as np
import pytest
from playwright.async_api import Browser, Page, Request, async_playwright
from support.cli import altd
from support.cut_cable import Cable
from support.foreign import need_program
from support.led_unit import LedUnit, config, led_unit

from altd.app.history import history_about
from altd.config import HttpSettings, KeptFrames
from altd.measuring.calibration import Calibration
from altd.ports import CameraLostError
from altd.records import Frame, Measurement
from hw_sim.beam import BeamPose
from hw_sim.unit import FRONT, REAR

pytestmark = pytest.mark.real_time

PROBE = Path(__file__).with_name("page_probe.js").read_text()
GREEN = """[...document.querySelectorAll("figure.target canvas")].map(canvas => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let green = 0;
    for (let i = 0; i < data.length; i += 4) green += data[i + 1] > 200 && data[i] < 120 && data[i + 2] < 160;
    return green;
})"""
AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js")
SIZES = {"phone": (390, 844), "desk": (1280, 900), "wall": (3840, 2160)}
POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
SHOWN_WITHIN_S = 1.0
BLANK_WITHIN_S = 2.0
SLOWER = 12
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
        """What the page shows; no script is evaluated in it, which its policy forbids."""
        shown: dict[str, Any] = await self.page.evaluate(PROBE)
        return shown

    async def until(self, holds: Callable[[dict[str, Any]], object], timeout_s: float = 20.0) -> float:
        """Seconds until the page shows it."""
        began = time.monotonic()
        async with asyncio.timeout(timeout_s):
            while not holds(await self.now()):  # noqa: ASYNC110  a browser tells nothing by itself
                await asyncio.sleep(0.02)
        return time.monotonic() - began

    async def until_measured(self) -> None:
        await self.until(lambda now: now["values"].get("x_mm", UNKNOWN) != UNKNOWN)

    async def until_pictures(self) -> None:
        await self.until(lambda now: len(now["pictures"]) == 2)


async def picture(shown: Seen, name: str) -> None:
    """For docs: ``make docs`` names the folder."""
    if folder := os.environ.get("ALTD_PICTURES"):
        await shown.page.screenshot(path=f"{folder}/{name}.png", full_page=True)


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
async def seen(
    calibration: Calibration,
    size: tuple[int, int] = SIZES["desk"],
    folder: Path | None = None,
    **options: Any,
) -> AsyncIterator[Seen]:
    """``folder``: the unit keeps its history and its frames there."""
    kept = KeptFrames(memory_mb=0)
    if folder is not None:
        kept = KeptFrames(before_s=2, after_s=1, folder=folder / "kept")
    settings = config(measuring={"window": 4}).model_copy(
        update={"http": HttpSettings(host="127.0.0.1", port=0), "kept_frames": kept}
    )

    def keep(running: LedUnit) -> None:
        if folder is not None:
            about = history_about(settings, calibration, running.daemon.board.quantities)
            running.daemon.past.keep_in(folder / "history.db", 400 * 10**6, about)

    async with browser() as started, led_unit(calibration, settings, keep) as running:
        running.unit.place(POSE)
        await running.measured(valid=True)
        async with Cable(port_of(running)) as cable:
            page = await started.new_page(viewport={"width": size[0], "height": size[1]}, **options)
            shown = Seen(page, running, cable)
            shown.listen()
            await shown.open()
            await shown.until_measured()
            yield shown
            await page.close()


def port_of(running: LedUnit) -> int:
    message = next(each for each in running.daemon.health if each.name.startswith("http ")).message
    return int(message.removeprefix("port ").split()[0])


def shown_as(value: float | None, decimals: int) -> str:
    """As the page does with what JSON has, a decimal more."""
    return (
        UNKNOWN
        if value is None
        else f"{round(value, decimals + 1):.{decimals}f}".replace("-", "\N{MINUS SIGN}")
    )


@pytest.mark.parametrize("size", SIZES)
async def test_the_page_shows_what_the_api_says_and_moving_pictures(
    calibration_of_unit_3: Calibration, size: str
) -> None:
    async with seen(calibration_of_unit_3, SIZES[size]) as shown:
        await shown.until_pictures()
        published = all_published(shown.running)
        await asyncio.sleep(0.5)
        pictures: set[str] = set()
        for _ in range(8):
            now = await shown.now()
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


def all_published(running: LedUnit) -> dict[str, Measurement]:
    """Whatever the unit publishes from now on, by its number."""
    board, published = running.daemon.board, dict[str, Measurement]()
    publish = board.publish

    def keep(measurement: Measurement) -> None:
        published[str(measurement.sequence)] = measurement
        publish(measurement)

    board.publish = keep  # type: ignore[method-assign]
    return published


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
    """The camera delivers its last picture for ever."""

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


async def test_each_of_ten_faults_shows_cause_and_remedy_within_a_second(
    calibration_of_unit_3: Calibration,
) -> None:
    late_s: dict[str, float] = {}
    async with seen(calibration_of_unit_3) as shown:
        running = shown.running
        for name, (code, spoil) in FAULTS.items():
            spoil(running)
            if code == "lamps_failed":
                running.daemon.health.self_check.ask()
            await said(running, code, True)
            late_s[name] = await shown.until(lambda now, code=code: code in now["causes"])  # type: ignore[misc]
            now = await shown.now()
            assert now["causes"][code] == now_wrong(running)[code]
            if name == "front covered":
                await shown.until_pictures()
                await picture(shown, "page-fault")
            if code != "lamps_failed":
                assert (now["verdict"], now["values"]["x_mm"]) == ("not valid", UNKNOWN)
            running.seen.alter = lambda frame: frame
            running.leds.refuses = ""
            running.unit.place(POSE)
            await running.measured(valid=True)
            await shown.until_measured()
            await said(running, code, False)
        assert max(late_s.values()) <= SHOWN_WITHIN_S, late_s
        assert shown.complaints == []


def now_wrong(running: LedUnit) -> dict[str, str]:
    """What the unit itself shows, with its remedies."""
    return {str(shown.cause.kind): shown.cause.kind.remedy for shown in running.daemon.state.read().causes}


async def said(running: LedUnit, code: str, is_said: bool) -> None:
    """Wait until the unit says that this is wrong, or that it is not."""
    async with asyncio.timeout(30):
        while (code in now_wrong(running)) is not is_said:  # noqa: ASYNC110  found out when it is asked for
            await asyncio.sleep(0.01)


async def test_a_unit_that_is_lost_is_blank_within_two_seconds_and_comes_back(
    calibration_of_unit_3: Calibration,
) -> None:
    def is_blank(now: dict[str, Any]) -> bool:
        values = set(now["values"].values())
        return values == {UNKNOWN} and now["kind"] == "unknown" and not (now["causes"] or now["pictures"])

    async with seen(calibration_of_unit_3) as shown:
        for _ in range(3):
            shown.cable.cut()
            assert await shown.until(is_blank) <= BLANK_WITHIN_S
            shown.cable.mend()
            await shown.until_measured()
            await shown.until_pictures()


@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_who_cannot_see_it_can_use_it(
    calibration_of_unit_3: Calibration, tmp_path: Path, scheme: str
) -> None:
    async with seen(calibration_of_unit_3, folder=tmp_path, color_scheme=scheme) as shown:
        for view in ("", "drive", "trends", "events", "unit"):
            await shown.open(view)
            await asyncio.sleep(1.0)
            await shown.page.evaluate(AXE.read_text())
            found = await shown.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
            grave = [
                (each["id"], node["html"], node["failureSummary"])
                for each in found["violations"]
                if each["impact"] in ("serious", "critical")
                for node in each["nodes"]
            ]
            assert grave == []
        # each view can be reached by keys alone
        await shown.open()
        for _ in range(3):
            await shown.page.keyboard.press("Tab")
        assert (await shown.now())["focused"] == "Trends"
        await shown.page.keyboard.press("Enter")
        await shown.until(lambda now: now["plots"] == 4)


async def test_a_slow_computer_shows_new_numbers_all_the_time(calibration_of_unit_3: Calibration) -> None:
    """A picture that was replaced before it was painted once stopped the page, with the numbers of then."""
    async with seen(calibration_of_unit_3) as shown:
        await shown.until_pictures()
        chromium = await shown.page.context.new_cdp_session(shown.page)
        await chromium.send("Emulation.setCPUThrottlingRate", {"rate": SLOWER})
        for view in ("drive", "trends", "", "drive", ""):
            await shown.page.evaluate("view => { location.hash = view; }", view)
            await asyncio.sleep(3.0)
        before = int((await shown.now())["sequence"])
        await shown.until(lambda now: now["sequence"] and int(now["sequence"]) > before)
        assert shown.complaints == []


async def test_a_page_that_fails_shows_nothing_and_begins_anew(calibration_of_unit_3: Calibration) -> None:
    async with seen(calibration_of_unit_3) as shown:
        await shown.page.evaluate("() => { setTimeout(() => { throw new Error('a defect'); }); }")
        assert await shown.until(lambda now: not now["values"]) <= BLANK_WITHIN_S
        await shown.until_measured()
        await shown.until_pictures()
        assert shown.complaints == ["a defect"]


async def test_nothing_is_sent_to_a_page_that_nobody_sees(calibration_of_unit_3: Calibration) -> None:
    async with seen(calibration_of_unit_3) as shown:
        component = next(each for each in shown.running.daemon.health if each.name.startswith("http "))
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


async def test_a_fault_at_night_is_replayed_in_the_morning(
    calibration_of_unit_3: Calibration, unit_3: Path, tmp_path: Path
) -> None:
    """As a technician does it: from the event on the page to the measurements of its frames on a laptop."""
    async with seen(calibration_of_unit_3, folder=tmp_path, accept_downloads=True) as shown:
        await asyncio.sleep(2.5)
        shown.running.seen.alter = only(FRONT, dark)
        await said(shown.running, "spot_missing", True)
        await asyncio.sleep(4.0)
        shown.running.seen.alter = lambda frame: frame
        await shown.open("events")
        link = shown.page.get_by_role("link", name="its frames")
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
            await shown.page.get_by_role("link", name="as CSV").click()
        table = Path(await (await coming.value).path()).read_text().splitlines()  # noqa: ASYNC240
        assert table[0].startswith("time,n,n_valid,worst,x_mm_mean,x_mm_sigma,x_mm_low,x_mm_high,")
        assert len(table) > 1

        await shown.open("events")
        await shown.page.get_by_role("button", name="keep the last seconds").click()
        await shown.page.get_by_text("asked by http 127.0.0.1", exact=False).first.wait_for(timeout=20_000)
        await picture(shown, "page-events")
        assert shown.complaints == []
    subprocess.run(["tar", "-xf", tmp_path / "got.tar", "-C", tmp_path], check=True)  # noqa: ASYNC221
    folder = tmp_path / got.suggested_filename.removesuffix(".tar")
    replayed = altd("replay", folder, "--calibration", unit_3 / "cal.json", "--window", 4)
    assert replayed.status == 0, replayed.err
    assert any(line["valid"] for line in replayed.objects)
    assert "front_spot_missing" in replayed.objects[-1]["status"]
