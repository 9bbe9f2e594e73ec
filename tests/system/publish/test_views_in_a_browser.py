"""The views Overview and Drive in Chromium, as a technician and a driver two metres away read them."""

import asyncio
import contextlib
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Browser, Locator, Route, ViewportSize
from support.led_unit import LedUnit
from support.page import POSE, SIZES, Seen, browser, seen, watched_unit

from altd.config import Machine
from altd.measuring.calibration import Calibration
from altd.ports import CameraLostError
from altd.records import Frame
from altd.status.models import status_of
from hw_sim.beam import BeamPose

pytestmark = [pytest.mark.real_time, pytest.mark.asyncio(loop_scope="module")]

NUMBERS = ("x_mm", "y_mm", "yaw_mm_per_m", "pitch_mm_per_m")
SCREENS: list[ViewportSize] = [
    {"width": 1024, "height": 600},
    {"width": 1280, "height": 720},
    {"width": 1920, "height": 1080},
]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def started() -> AsyncIterator[Browser]:
    async with browser() as started:
        yield started


@contextlib.asynccontextmanager
async def watched(
    started: Browser, calibration: Calibration, size: tuple[int, int] = SIZES["desk"]
) -> AsyncIterator[tuple[LedUnit, Seen]]:
    """A unit of its own with its page: a beam that moves starts self-checks, which outlive a page."""
    async with watched_unit(calibration) as running, seen(started, running, size, goes_on=False) as shown:
        yield running, shown


def dark(frame: Frame) -> Frame:
    return replace(frame, pixels=np.minimum(frame.pixels, 12))


def dead(frame: Frame) -> Frame:
    raise CameraLostError("the cable was pulled")


async def until(holds: Callable[[], Awaitable[bool]], timeout_s: float = 20.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not await holds():  # noqa: ASYNC110  a browser sends no notification
            await asyncio.sleep(0.05)


async def placed(running: LedUnit, shown: Seen, pose: BeamPose) -> None:
    """Put the beam there, and wait until the page shows it."""
    running.unit.place(pose)

    async def is_shown() -> bool:
        text = (await shown.now())["values"]["x_mm"].replace("\N{MINUS SIGN}", "-")
        return text != "\N{EN DASH}" and abs(float(text) - pose.x_mm) < 0.2

    await until(is_shown)


OUTSIDE = """selectors => selectors.flatMap(selector => {
    const found = [...document.querySelectorAll(selector)];
    const bad = found.filter(element => {
        const box = element.getBoundingClientRect();
        const card = element.closest("section").getBoundingClientRect();
        return box.left < card.left - 1 || box.right > Math.min(card.right, innerWidth) + 1
            || box.top < card.top - 1 || box.bottom > Math.min(card.bottom, innerHeight) + 1 || !box.width;
    });
    return found.length ? bad.map(element => `${selector}: ${element.textContent}`) : [`no ${selector}`];
})"""
"""The parts that are not on the first screen as a whole, within its section."""


async def on_first_screen(shown: Seen, *selectors: str) -> None:
    outside: list[str] = []

    async def is_inside() -> bool:
        outside[:] = await shown.page.evaluate(OUTSIDE, selectors)
        return not outside

    try:
        await until(is_inside, 5.0)
    except TimeoutError:
        pytest.fail(str(outside))


async def test_numbers_and_the_cause_of_a_fault_are_on_the_first_screen(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    async with watched(started, calibration_of_unit_3) as (running, shown):
        await shown.open("drive")
        numbers = [f"#{key}" for key in NUMBERS]
        for size in SCREENS:
            await shown.page.set_viewport_size(size)
            await on_first_screen(shown, *numbers, "td.sigma", ".eye svg", ".eye label")
        running.seen.alter = dark
        await shown.page.locator(".causes li").first.get_by_text("no laser spot").wait_for()
        for size in SCREENS:
            await shown.page.set_viewport_size(size)
            await on_first_screen(shown, ".causes li strong", ".causes li .remedy", *numbers)
            assert await shown.page.evaluate("document.documentElement.scrollHeight - innerHeight") <= 0
        await shown.page.set_viewport_size({"width": 390, "height": 844})
        for link in ("#cause a", ".causes li a"):  # to its explanation, which the unit itself has
            await shown.open()
            await shown.page.locator(link).filter(has_text="no laser spot").first.click()
            entry = shown.page.locator("li:target")
            await entry.get_by_text("nothing is brighter than the background").wait_for()
            assert (await entry.bounding_box() or {"y": -1})["y"] > 0
            assert (await shown.now())["overflow"] <= 0


async def test_a_moving_beam_is_shown_with_both_uncertainties(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    both = re.compile(r"±\s\d+\.\d{3} \(mean\), ±\s\d+\.\d+ now, moving")

    async def is_at_rest() -> bool:
        return str(await cell.inner_text()).endswith(" now")

    async with watched(started, calibration_of_unit_3) as (running, shown):
        cell = shown.page.locator("#sigma_x_mm")
        for step in range(200):
            running.unit.place(replace(POSE, x_mm=POSE.x_mm - 0.1 * step))
            if both.fullmatch(await cell.inner_text()):
                break
            await asyncio.sleep(0.05)
        else:
            pytest.fail(await cell.inner_text())
        running.unit.place(POSE)
        await until(is_at_rest)


async def rings_of(eyes: Locator) -> list[str]:
    return await eyes.locator("text.scale").all_text_contents()


HIDDEN = """(() => {
    const eye = document.querySelector(".eye");
    const mark = eye.querySelector("circle.point")?.getBoundingClientRect();
    return !mark ? null : [...eye.querySelectorAll("text")].filter(text => {
        const box = text.getBoundingClientRect();
        return mark.left < box.right && box.left < mark.right
            && mark.top < box.bottom && box.top < mark.bottom;
    }).map(text => text.textContent);
})()"""
"""The labels below the marker; null: there is none."""


async def test_the_scale_of_the_drive_view_stays_while_the_beam_moves(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    async def shows_nothing_hidden() -> bool:
        hidden = await shown.page.evaluate(HIDDEN)
        assert not hidden
        return hidden is not None  # for a moment there is no valid value

    async with watched(started, calibration_of_unit_3, (1024, 600)) as (running, shown):
        await shown.open("drive")
        eyes = shown.page.locator(".eyes")
        ends = await eyes.locator("text.end").all_text_contents()
        assert ends == ["right", "left", "up", "down"] * 2
        rings = ["10", "30", "50", "20", "60", "100"]
        for x_mm in (0.5, 12.0, 45.0, 70.0, -3.0):
            await placed(running, shown, replace(POSE, x_mm=x_mm))
            assert await rings_of(eyes) == rings
            assert await eyes.get_by_text("outside the scale").count() == (x_mm > 50)
            await until(shows_nothing_hidden)
        await eyes.get_by_label("scale").first.select_option(label="100")
        await eyes.get_by_label("tolerance").first.select_option(label="15")
        await shown.page.reload()
        await shown.until_measured()
        assert (await rings_of(eyes))[:3] == ["20", "60", "100"], "the choice is kept"
        (radius,) = [
            float(await ring.get_attribute("r") or 0) for ring in await eyes.locator(".tolerance").all()
        ]
        outer = float(await eyes.locator("circle.ring").nth(2).get_attribute("r") or 0)
        assert radius / outer == pytest.approx(0.15)
        await placed(running, shown, POSE)
        assert shown.complaints == []


async def middle_of_spot(figure: Locator) -> tuple[float, float] | None:
    """The place of the green contour on the screen, as shares of the picture from its left and top."""
    png = np.frombuffer(await figure.locator("canvas").screenshot(), np.uint8)
    image = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert image is not None
    blue, green, red = cv2.split(image)
    v, u = np.nonzero((green > 200) & (red < 120) & (blue < 160))
    return (float(u.mean() / green.shape[1]), float(v.mean() / green.shape[0])) if u.size else None


async def test_the_driver_chooses_one_point_of_the_machine(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    """Points at the front and the rear target are as far from the beam as its spots are from the middle."""
    points = [
        {"name": name, "x_mm": 0.0, "y_mm": 0.0, "z_mm": z_mm, "sigma_mm": 0.5}
        for name, z_mm in (("tail", 0.0), ("head", 280.0))
    ]
    machine = Machine.model_validate(
        {"roll_deg": 0.0, "roll_sigma_deg": 0.0, "mount_sigma_deg": 0.0, "points": points}
    )
    async with (
        watched_unit(calibration_of_unit_3, machine=machine) as running,
        seen(started, running, SIZES["phone"], goes_on=False) as shown,
    ):
        await shown.open("drive")
        now = await shown.once(lambda now: "tail_right_mm" in now["values"])
        assert "head_right_mm" not in now["values"]
        assert float(now["values"]["tail_up_mm"].replace("\N{MINUS SIGN}", "-")) == pytest.approx(
            7.0, abs=0.2
        )
        await shown.page.get_by_label("point of the machine").select_option("head")
        now = await shown.once(lambda now: "head_right_mm" in now["values"])
        assert "tail_right_mm" not in now["values"]
        wanted_mm = -(POSE.x_mm + 280.0 * POSE.slope_x)
        shown_mm = float(now["values"]["head_right_mm"].replace("\N{MINUS SIGN}", "-"))
        assert shown_mm == pytest.approx(wanted_mm, abs=0.2)
        assert now["overflow"] == 0
        await shown.page.reload()
        await shown.once(lambda now: "head_right_mm" in now["values"])


async def test_pictures_are_seen_along_the_beam(started: Browser, calibration_of_unit_3: Calibration) -> None:
    """A beam to the right and below is drawn to the right and below, on both targets."""
    async with watched(started, calibration_of_unit_3) as (running, shown):
        await placed(running, shown, BeamPose(30.0, -20.0, 0.0, 0.0))
        await shown.until_pictures()
        for target in ("front", "rear"):
            figure = shown.page.locator(f"figure[data-target={target}]")
            middle = None
            async with asyncio.timeout(20):
                while middle is None or middle[1] < 0.55:  # of the last place of the beam
                    middle = await middle_of_spot(figure)
            assert middle[0] > 0.55, target
            assert "seen along the beam" in await figure.inner_text()
        await placed(running, shown, POSE)


async def says(running: LedUnit, shown: Seen, others: list[str]) -> None:
    """Give the page a status with the causes of simulated frames, and others of these signals."""

    async def answer(route: Route) -> None:
        signals = [("simulated", "check_function"), ("rehearsal", "check_function"), ("over", "failure")]
        causes = [
            {"code": code, "signal": signal, "of": None, "active": code != "over", "times": 1}
            | {"for_s": round(time.monotonic(), 1), "remedy": "do", "detail": "", "brief": f"brief of {code}"}
            for code, signal in [*signals, *((each, each) for each in others)]
        ]
        signal = "failure" if "failure" in others else "check_function"
        state = {"signal": signal, "for_s": 9.0, "causes": causes}
        await route.fulfill(json={**status_of(running.daemon.unit.view()).as_object(), "state": state})

    await shown.page.route("**/api/v1/status", answer)


async def test_simulated_frames_are_named_once_and_hide_no_fault(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    others: list[str] = []

    async with watched(started, calibration_of_unit_3) as (running, shown):
        await says(running, shown, others)
        listed = shown.page.locator(".causes li")

        async def listed_are(*codes: str) -> None:
            await until(
                lambda: listed.evaluate_all(
                    "(all, codes) => all.map(each => each.dataset.code).join() === codes.join()", codes
                )
            )

        for found, badge in (
            ([], ""),
            (["maintenance_required"], "maintenance required"),
            (["out_of_specification", "failure"], "failure"),
        ):
            others[:] = found
            await shown.open()
            await listed_are(*others, "simulated", "over")
            badges = await shown.page.locator("header .badge").all_inner_texts()
            assert [text.split(" ", 1)[1] for text in badges] == ([badge] if badge else [])
            await shown.open("drive")
            await listed_are(others[0] if others else "simulated")


PLACES = """[...document.querySelectorAll("header, nav, #cause, .numbers, .eyes, .pictures")].flatMap(
    part => { const { top, height } = part.getBoundingClientRect();
    return part.matches("header") ? [top, height] : [top]; })"""
BEYOND = """selectors => selectors.filter(selector => {
    const box = document.querySelector(selector).getBoundingClientRect();
    return box.bottom > innerHeight || box.right > innerWidth || !box.height;
})"""
SAID = """() => {
    const said = globalThis.said = [];
    const parts = document.querySelectorAll("[aria-live], [role=status], [role=alert]");
    const watcher = new MutationObserver(changes => said.push(changes[0].target.textContent));
    parts.forEach(part => watcher.observe(part, { subtree: true, childList: true, characterData: true }));
}"""
SMALL = """[...document.querySelectorAll("a, button, select, input, summary")].filter(
    each => each.checkVisibility() && each.getBoundingClientRect().height < 44).map(each => each.outerHTML)"""
STATES: dict[str, tuple[list[str], Callable[[LedUnit, Seen], None]]] = {
    "brief of simulated": ([], lambda running, shown: None),
    "brief of out_of_specification": (
        ["out_of_specification"] * 2,
        lambda running, shown: setattr(running.seen, "alter", dark),
    ),
    "brief of failure": (["failure"] * 5, lambda running, shown: setattr(running.seen, "alter", dead)),
    "Last known state": ([], lambda running, shown: shown.cable.cut()),
}


async def test_the_worst_cause_comes_first_and_nothing_moves_with_it(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    others: list[str] = []
    places: dict[tuple[int, str], list[float]] = {}
    async with watched(started, calibration_of_unit_3) as (running, shown):
        await says(running, shown, others)
        await shown.until_pictures()
        for text, (others[:], change) in STATES.items():
            change(running, shown)
            if text.startswith("Last"):
                await shown.page.unroute_all()
            await shown.page.locator("#cause").get_by_text(text).wait_for()
            for width, height in ((390, 844), (1024, 600), (1366, 768), (1920, 1080)):
                await shown.page.set_viewport_size({"width": width, "height": height})
                for view in ("", "drive"):
                    await shown.page.evaluate("view => { location.hash = view; scrollTo(0, 0); }", view)
                    await shown.page.locator(f"main.{view or 'overview'} .eyes").wait_for()
                    found = await shown.page.evaluate(PLACES)
                    assert found == pytest.approx(places.setdefault((width, view), found), abs=8), (
                        text,
                        width,
                        view,
                    )
                    if others:
                        parts = "#verdict", "#cause", ".causes li strong", ".causes li .remedy"
                        assert not await shown.page.evaluate(BEYOND, parts), (text, width, view)


async def test_everything_can_be_touched_and_only_the_worst_cause_is_spoken(
    started: Browser, calibration_of_unit_3: Calibration
) -> None:
    others = ["failure"]
    async with watched(started, calibration_of_unit_3, SIZES["phone"]) as (running, shown):
        await says(running, shown, others)
        await shown.page.locator("#cause").get_by_text("brief of failure").wait_for()
        await shown.page.evaluate(SAID)
        for view in ("drive", "trends", "events", "unit", ""):
            await shown.page.evaluate("view => { location.hash = view; }", view)
            await asyncio.sleep(1.0)
            assert await shown.page.evaluate(SMALL) == [], view
        assert await shown.page.evaluate("said") == []
        others[:] = []
        await shown.page.locator("#cause").get_by_text("brief of simulated").wait_for()
        assert len(await shown.page.evaluate("said")) <= 2
