"""A frame shown to a person: the picture, and the place of the spot in it."""

import asyncio
import math
from collections.abc import AsyncIterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.clock import FakeClock, stop
from support.evidence import calibration, nodes_mm, straight_px

from altd.acquisition.pictures import MAX_RATE_HZ, MAX_WIDTH_PX, Pictures, contour_of, view_of
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot, SpotShape
from altd.status.services import NoPictureError, Picture

SPOT = Spot(200.5, 100.25, 0.01, 44.0, 150.0)
SECOND_NS = 10**9


def disc(width: int = 752, height: int = 480, bits: int = 8) -> np.ndarray:
    """A bright disc at (200, 100) of a frame 752 wide, wherever that is in another size."""
    v, u = np.mgrid[0:height, 0:width] * (752 / width)
    full = (1 << bits) - 1
    return np.where((u - 200) ** 2 + (v - 100) ** 2 < 30**2, full, full // 64).astype(
        np.uint8 if bits == 8 else np.uint16
    )


class Shown:
    """Pictures of the unit's two targets, and a clock that is moved."""

    def __init__(self) -> None:
        self.clock = FakeClock(SECOND_NS)
        self.pictures = Pictures(
            [view_of(target.name, target) for target in calibration().targets], self.clock
        )
        self.sequence = 0

    def put(self, camera: str = "front", spot: Spot | NoSpot = SPOT, **about: object) -> Frame:
        self.sequence += 1
        values: dict[str, object] = {"pixels": disc(), **about}
        frame = Frame(camera, self.sequence, self.clock.now_ns, **values)  # type: ignore[arg-type]
        self.pictures.put(frame, spot)
        return frame

    async def newer(self, **seen: int) -> list[Picture]:
        async with asyncio.timeout(60):
            return list(await self.pictures.newer(seen))


@pytest.fixture
async def unit() -> AsyncIterator[Shown]:
    shown = Shown()
    task = asyncio.create_task(shown.pictures.run())
    await asyncio.sleep(0)
    yield shown
    await stop(task)


def decoded(picture: Picture) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == (picture.height, picture.width)
    return image


async def test_a_picture_shows_its_own_frame_and_what_was_found_in_it(unit: Shown) -> None:
    frame = unit.put()
    (picture,) = await unit.newer()
    assert (picture.target, picture.sequence, picture.t_ns) == ("front", frame.sequence, frame.t_ns)
    assert picture.spot is not None
    assert (picture.spot.u_px, picture.spot.v_px) == (200.5, 100.25)
    assert picture.spot.semi_major_px == picture.spot.semi_minor_px == 22.0
    assert picture.why == ""
    image = decoded(picture)
    assert image.shape == (480, 752)
    assert image[100, 200] > 250
    # 3 of 255 is shown as 255 √(3/255) = 28
    assert image[300, 600] == pytest.approx(28, abs=3)


@pytest.mark.parametrize(
    ("bits", "size"), [(8, (3000, 4096)), (12, (480, 752)), (12, (2048, 2448)), (16, (16, 16))]
)
async def test_any_frame_becomes_a_small_picture_of_eight_bits(
    unit: Shown, bits: int, size: tuple[int, int]
) -> None:
    rows, columns = size
    unit.put(pixels=disc(columns, rows, bits), bits=bits)
    (picture,) = await unit.newer()
    assert picture.width == min(columns, MAX_WIDTH_PX)
    assert picture.height == pytest.approx(rows * picture.width / columns, abs=0.5)
    if columns > 16:
        scale = picture.width / 752
        image = decoded(picture)
        assert image[round(100 * scale), round(200 * scale)] > 250
        assert image[round(100 * scale), round(250 * scale)] < 60


async def test_only_the_newest_frame_is_shown_and_each_once(unit: Shown) -> None:
    for _ in range(5):
        unit.put()
    (picture,) = await unit.newer()
    assert (picture.number, picture.sequence) == (5, 5)
    waiting = asyncio.create_task(unit.newer(front=5))
    await unit.clock.advance(1.0)
    assert not waiting.done()
    unit.put("rear")
    assert [(each.target, each.number) for each in await waiting] == [("rear", 1)]
    both = await unit.newer()
    assert {(each.target, each.number) for each in both} == {("front", 5), ("rear", 1)}


async def test_many_who_look_cost_as_much_as_one(unit: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    encoded = []
    imencode = cv2.imencode
    monkeypatch.setattr(cv2, "imencode", lambda *args: encoded.append(args[0]) or imencode(*args))
    unit.put()
    answers = await asyncio.gather(*(unit.newer() for _ in range(50)))
    assert len(encoded) == 1
    assert all(answer[0] is answers[0][0] for answer in answers)


async def test_there_are_no_more_pictures_a_second_than_people_see(unit: Shown) -> None:
    unit.put()
    (first,) = await unit.newer()
    unit.put()
    waiting = asyncio.create_task(unit.newer(front=first.number))
    await unit.clock.advance(0.9 / MAX_RATE_HZ)
    assert not waiting.done()
    last = unit.put()
    await unit.clock.advance(0.2 / MAX_RATE_HZ)
    (second,) = await waiting
    assert second.sequence == last.sequence


async def test_a_frame_without_a_spot_says_why_and_one_under_leds_that_they_are_lit(unit: Shown) -> None:
    unit.put(spot=NoSpot(Reason.AMBIGUOUS, "two spots"), leds_on=True)
    (picture,) = await unit.newer()
    assert (picture.spot, picture.why, picture.leds_on) == (None, "front_ambiguous", True)


async def test_what_cannot_be_encoded_is_said_and_the_next_frame_is_shown(
    unit: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(cv2, "imencode", lambda *_: (False, None))
        unit.put()
        with pytest.raises(NoPictureError, match="the frame of front cannot be encoded"):
            await unit.newer()
    unit.put()
    await unit.clock.advance(1.0)
    assert (await unit.newer())[0].sequence == 2


async def test_the_outline_is_where_the_map_has_its_hull(unit: Shown) -> None:
    front, rear = unit.pictures.views
    assert (front.target, front.width, front.height) == ("front", 752, 480)
    assert front.leds == ((90.25, 60.5), (660.75, 40.0), (84.0, 445.0), (677.0, 441.0))
    # 4 px/mm, v down, the front picture mirrored
    assert (front.middle, front.x_axis, front.y_axis) == ((375.0, 240.0), (-4.0, 0.0), (0.0, -4.0))
    assert (rear.middle, rear.x_axis, rear.y_axis) == ((375.0, 240.0), (4.0, 0.0), (0.0, -4.0))
    places_mm = nodes_mm()
    for view in (front, rear):
        corners_px = straight_px(view.target, places_mm)
        outline = np.array(view.outline)
        assert np.abs(outline.max(axis=0) - corners_px.max(axis=0)).max() < 0.1
        assert np.abs(outline.min(axis=0) - corners_px.min(axis=0)).max() < 0.1


@pytest.mark.parametrize("turn_deg", [-80.0, -45.0, 0.0, 30.0, 89.0])
@pytest.mark.parametrize("order", [1.0, 2.5])
def test_the_contour_is_where_the_light_has_fallen_to_1_e_squared(turn_deg: float, order: float) -> None:
    turn = np.array([[1, -1], [1, 1]]) * np.array(
        [[math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))]] * 2
    )
    turn[1] = turn[1, ::-1]
    halves_px = np.array([30.0, 20.0])
    quadratic = turn @ np.diag(2 * 2 ** (1 / order) / halves_px**2) @ turn.T
    shape = SpotShape(quadratic[0, 0], quadratic[0, 1], quadratic[1, 1], order)
    contour = contour_of(replace(SPOT, shape=shape))
    assert (contour.semi_major_px, contour.semi_minor_px) == pytest.approx(tuple(halves_px))
    along = np.array([math.cos(math.radians(contour.turn_deg)), math.sin(math.radians(contour.turn_deg))])
    for place in (contour.semi_major_px * along, contour.semi_minor_px * np.array([-along[1], along[0]])):
        q = place @ quadratic @ place / 2
        assert math.exp(-(q**order)) == pytest.approx(math.exp(-2))
