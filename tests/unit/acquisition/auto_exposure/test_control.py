from __future__ import annotations

import numpy as np
import pytest
from support.clock import FakeClock

from altd.acquisition.auto_exposure.control import MARKED_FRAMES, ExposureKeeper, ExposureSetter
from altd.acquisition.auto_exposure.rule import Setting
from altd.config import ExposureSettings
from altd.ports import CameraLostError, CameraRefusedError, ExposureRange
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot
from altd.status.health import Component, Health

RANGE = ExposureRange(0.05, 30.0, 0.0, 24.0)
BRIGHT, GOOD = 230, 130
SPOT = Spot(32.0, 24.0, 0.01, 20.0, 100.0)


class Camera:
    """Takes a setting and uses it from the ``lag``-th exposure on; tells what it used, or not."""

    def __init__(self, lag: int = 0, tells: str = "", able: ExposureRange | None = RANGE) -> None:
        self.exposure_range = able
        self.asked: list[Setting] = []
        self.failure: Exception | None = None
        self._lag, self._tells = lag, tells
        self._used = Setting(1.0, 0.0)
        self._coming: list[tuple[int, Setting]] = []
        self._number = 0

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        if self.failure is not None:
            raise self.failure
        self.asked.append(Setting(exposure_ms, gain_db))
        self._coming.append((self._number + self._lag, self.asked[-1]))

    def frame(self, grey: int = GOOD) -> tuple[Frame, Setting]:
        """The next frame, and what it was exposed with in truth."""
        while self._coming and self._coming[0][0] <= self._number:
            self._used = self._coming.pop(0)[1]
        self._number += 1
        pixels = np.full((48, 64), grey, np.uint8)
        taken = Frame(
            "front",
            self._number,
            0,
            pixels,
            exposure_ms=self._used.exposure_ms if "exposure" in self._tells else None,
            gain_db=self._used.gain_db if "gain" in self._tells else None,
        )
        return taken, self._used


def setter_of(control: str = "auto", exposure_ms: float = 2.0, gain_db: float = 0.0) -> ExposureSetter:
    settings = {"control": control, "exposure_ms": exposure_ms, "gain_db": gain_db}
    return ExposureSetter(ExposureSettings.model_validate(settings), fps=20.0)


@pytest.fixture
def component() -> Component:
    return Health(FakeClock()).component("camera front")


def test_a_wish_is_set_once_and_again_when_the_camera_was_opened_again() -> None:
    camera, setter = Camera(), setter_of()
    for _ in range(2):
        setter.opened(camera)
        assert setter.set(camera) == ""
        assert setter.set(camera) is None
    setter.wish = Setting(3.0, 0.0)
    assert setter.set(camera) == ""
    assert camera.asked == [Setting(2.0, 0.0)] * 2 + [Setting(3.0, 0.0)]


@pytest.mark.parametrize("tells", ["", "exposure", "exposure gain"])
@pytest.mark.parametrize("lag", [0, 1, 2, 3])
@pytest.mark.parametrize("changed", [Setting(4.0, 0.0), Setting(4.0, 6.0), Setting(2.0, 6.0)])
def test_no_frame_passes_for_what_it_was_not_exposed_with(lag: int, tells: str, changed: Setting) -> None:
    camera, setter = Camera(lag, tells), setter_of("fixed")
    setter.opened(camera)
    marks = []
    for wish in (Setting(2.0, 0.0), changed):
        setter.wish = wish
        setter.set(camera)
        for _ in range(8):
            taken, used = camera.frame()
            taken = setter.marked(taken)
            marks.append(taken.changing)
            if not taken.changing:
                assert (taken.exposure_ms, taken.gain_db) == (used.exposure_ms, used.gain_db)
    assert marks[8]  # a window must see where the change lies
    assert sum(marks[8:]) == (
        max(lag, 1) if "gain" in tells or (tells and not changed.gain_db) else MARKED_FRAMES
    )


def test_an_exposure_that_never_comes_is_not_waited_for_longer_than_four_frames() -> None:
    camera, setter = Camera(lag=1000, tells="exposure gain"), setter_of()
    setter.opened(camera)
    setter.set(camera)
    assert [setter.marked(camera.frame()[0]).changing for _ in range(6)] == [True] * 4 + [False] * 2


def test_auto_stays_within_what_the_camera_can_and_fixed_asks_for_what_is_written() -> None:
    able = ExposureRange(0.05, 1.5, 0.0, 6.0)
    for control, asked in (("auto", Setting(1.5, 6.0)), ("fixed", Setting(10.0, 0.0))):
        camera, setter = Camera(able=able), setter_of(control, 10.0)
        setter.opened(camera)
        setter.set(camera)
        assert camera.asked == [asked]


def test_a_camera_with_nothing_to_set_is_left_alone_and_says_so(component: Component) -> None:
    camera = Camera(able=None)
    keeper = ExposureKeeper(ExposureSettings(), 20.0, 20, component)
    assert keeper.setter is not None
    keeper.setter.opened(camera)
    assert keeper.setter.set(camera) is None
    keeper.see(keeper.setter.marked(camera.frame()[0]), SPOT)
    assert camera.asked == []
    assert component.figures == {
        "exposure_control": "auto, but this camera has nothing to set",
        "level": 0.51,
    }


def test_a_refusal_is_told_and_ends_the_wishing_until_the_camera_is_opened_again(
    component: Component,
) -> None:
    camera = Camera()
    keeper = ExposureKeeper(ExposureSettings(), 20.0, 4, component)
    setter = keeper.setter
    assert setter is not None
    setter.opened(camera)
    setter.set(camera)
    camera.failure = CameraRefusedError("the register is locked")
    setter.wish = Setting(5.0, 0.0)
    assert setter.set(camera) == "the register is locked"
    for _ in range(50):
        keeper.see(setter.marked(camera.frame(BRIGHT)[0]), SPOT)
    assert (setter.wish, component.figures["exposure_control"]) == (
        Setting(5.0, 0.0),
        "auto, but the camera refuses",
    )
    assert component.figures["exposure_ms"] == 2.0
    camera.failure = None
    setter.opened(camera)
    assert setter.set(camera) == ""
    assert not setter.refused


def test_a_camera_that_goes_away_while_it_is_set_is_lost() -> None:
    camera, setter = Camera(), setter_of()
    setter.opened(camera)
    camera.failure = CameraLostError("unplugged")
    with pytest.raises(CameraLostError):
        setter.set(camera)


def test_a_spot_too_bright_is_exposed_less_and_health_shows_with_what(component: Component) -> None:
    camera = Camera()
    keeper = ExposureKeeper(ExposureSettings(), 20.0, 4, component)
    setter = keeper.setter
    assert setter is not None
    setter.opened(camera)
    for _ in range(MARKED_FRAMES + 3):
        setter.set(camera)
        keeper.see(setter.marked(camera.frame(BRIGHT)[0]), SPOT)
    assert component.figures == {
        "exposure_control": "auto",
        "level": 0.9,
        "exposure_ms": 2.0,
        "gain_db": 0.0,
    }
    assert component.counters == {"exposure_changes": 1}
    assert setter.wish.exposure_ms == pytest.approx(2.0 * (0.35 * 0.8) ** 0.5 / (230 / 255))
    assert setter.set(camera) == ""


@pytest.mark.parametrize("mark", ["changing", "leds_on"])
def test_what_is_not_the_beam_s_exposure_is_not_looked_at(component: Component, mark: str) -> None:
    keeper = ExposureKeeper(ExposureSettings(), 20.0, 4, component)
    assert keeper.setter is not None
    keeper.setter.opened(Camera())
    pixels = np.full((48, 64), 255, np.uint8)
    taken = Frame("front", 1, 0, pixels, exposure_ms=2.0, gain_db=0.0, **{mark: True})
    for _ in range(20):
        keeper.see(taken, NoSpot(Reason.SATURATED))
    assert component.figures == {}
    assert keeper.setter.wish == Setting(2.0, 0.0)


@pytest.mark.parametrize(("control", "sets"), [("fixed", True), ("camera", False)])
def test_without_control_the_level_is_shown_and_nothing_is_wished(
    component: Component, control: str, sets: bool
) -> None:
    keeper = ExposureKeeper(ExposureSettings.model_validate({"control": control}), 20.0, 4, component)
    assert (keeper.setter is not None) is sets
    if keeper.setter is not None:
        keeper.setter.opened(Camera())
    for _ in range(50):
        keeper.see(Camera(tells="exposure gain").frame(BRIGHT)[0], SPOT)
    assert (component.figures["exposure_control"], component.figures["level"]) == (control, 0.9)
    assert component.figures["exposure_ms"] == 1.0
    assert component.counters == {}
