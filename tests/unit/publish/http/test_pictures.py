"""Pictures over a WebSocket, by a foreign client: the library websockets."""

import asyncio
import contextlib

import pytest
from support.clock import FakeClock
from support.picture_maker import Maker, picture
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from altd.publish.http import pictures
from altd.status.health import Component

from .browsers import answered, closed, first, looking, shown
from .conftest import Served, Unit

SHOWN_AXES = {"middle": [375, 240], "x_axis": [-4, 0], "y_axis": [0, -4]}


async def test_a_browser_gets_the_newest_picture_of_each_target_with_what_is_in_it(
    served: Served, maker: Maker, clock: FakeClock
) -> None:
    light_ns = clock.now_ns - 1_234_000_000
    maker.put(
        picture("front", 7, t_ns=light_ns),
        picture("rear", 3, spot=None, why="rear_spot_missing", leds_on=True),
    )
    async with served() as unit, looking(unit) as browser:
        assert await first(browser) == {
            "views": [
                {
                    "target": "front",
                    "width": 752,
                    "height": 480,
                    "outline": [[1, 2], [3, 4]],
                    "leds": [[5, 6]],
                    **SHOWN_AXES,
                },
                {"target": "rear", "width": 752, "height": 480, "outline": [], "leds": [], **SHOWN_AXES},
            ]
        }
        (front, jpeg), (rear, rear_jpeg) = await shown(browser)
        assert (jpeg, rear_jpeg) == (maker.newest["front"].jpeg, maker.newest["rear"].jpeg)
        assert front == {
            "target": "front",
            "sequence": 107,
            "age_s": 1.234,
            "width": 752,
            "height": 480,
            "spot": {
                "u_px": 200.12,
                "v_px": 100.5,
                "semi_major_px": 22,
                "semi_minor_px": 21,
                "turn_deg": -30,
            },
            "why": "",
            "leds_on": False,
            "bytes": len(jpeg),
        }
        assert (rear["spot"], rear["why"], rear["leds_on"]) == (None, "rear_spot_missing", True)


async def test_each_picture_comes_once_and_only_when_it_is_asked_for(served: Served, maker: Maker) -> None:
    maker.put(picture("front", 1))
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(browser.recv(), 0.2)
        assert maker.asked == []
        assert [each["sequence"] for each, _ in await shown(browser)] == [101]
        maker.put(picture("front", 2), picture("rear", 1))
        maker.put(picture("front", 9))
        assert [each["sequence"] for each, _ in await shown(browser)] == [109, 101]
        assert maker.asked == [{}, {"front": 1}]


async def test_where_nothing_new_comes_it_is_told_that_the_unit_is_there(
    served: Served, maker: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "NOTHING_NEW_S", 0.1)
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        assert await shown(browser) == []
        maker.put(picture("rear", 1))
        assert len(await shown(browser)) == 1


async def test_a_message_says_for_how_long_the_unit_held_it(
    served: Served, maker: Maker, clock: FakeClock
) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        answer = asyncio.create_task(answered(browser))
        await unit.until(lambda: len(maker.asked) == 1)
        clock.now_ns += 250_000_000
        maker.put(picture("front", 1))
        assert (await answer)[0]["held_s"] == 0.25


async def test_a_browser_that_asks_for_nothing_any_more_is_closed(
    served: Served, maker: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "MAX_SILENCE_S", 0.2)
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        assert await closed(browser) == (1001, "no picture was requested")


async def test_more_browsers_than_may_look_are_told_so(
    served: Served, maker: Maker, component: Component
) -> None:
    maker.put(picture("front", 1))
    async with served() as unit, contextlib.AsyncExitStack() as browsers:
        for _ in range(pictures.MAX_VIEWERS):
            await first(await browsers.enter_async_context(looking(unit)))
        async with looking(unit) as late:
            assert (await closed(late))[0] == 1013
        assert component.counters["viewers_refused"] == 1
        await browsers.aclose()
        await unit.until(lambda: unit.publisher.answers.viewers.open == 0)
        async with looking(unit) as browser:
            await first(browser)
            assert len(await shown(browser)) == 1


async def test_a_frame_that_cannot_be_shown_closes_with_the_reason(served: Served, maker: Maker) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        maker.fails = "the frame of front cannot be encoded"
        await browser.send("next")
        assert await closed(browser) == (1013, maker.fails)


async def test_a_unit_without_pictures_says_so(served: Served) -> None:
    async with served() as unit, looking(unit) as browser:
        assert (await closed(browser))[1] == "this unit shows no pictures"


async def test_there_is_no_other_socket(unit: Unit, maker: Maker) -> None:
    for path in ("/", "/api/v1/measurement", "/api/v1/pictures/", "/nothing"):
        with pytest.raises(InvalidStatus):
            async with connect(f"ws://127.0.0.1:{unit.port}{path}"):
                pass
