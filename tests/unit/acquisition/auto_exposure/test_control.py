from dataclasses import replace

import numpy as np
import pytest
from support.frames import Blob, light

from altd.acquisition.auto_exposure.control import (
    MAX_MARKED_FRAMES,
    Applied,
    ExposureControl,
    ExposureFigures,
    Refused,
)
from altd.acquisition.auto_exposure.rule import Setting
from altd.config import ExposureSettings
from altd.ports import CameraLostError, CameraRefusedError, ExposureRange
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot
from altd.vision.localise import locate

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


def control_of(
    control: str = "auto", exposure_ms: float = 2.0, gain_db: float = 0.0, window: int = 20
) -> ExposureControl:
    settings = {"control": control, "exposure_ms": exposure_ms, "gain_db": gain_db}
    return ExposureControl(ExposureSettings.model_validate(settings), 20.0, window)


def opened(control: ExposureControl, camera: Camera) -> Applied | Refused | None:
    """The camera is opened, and set when something is due."""
    control.opened(camera)  # type: ignore[arg-type]
    return applied(control, camera)


def applied(control: ExposureControl, camera: Camera) -> Applied | Refused | None:
    return control.apply(camera) if control.is_due else None  # type: ignore[arg-type]


def test_a_setpoint_is_applied_once_and_again_when_the_camera_was_opened_again() -> None:
    camera, control = Camera(), control_of()
    for _ in range(2):
        assert opened(control, camera) == Applied(Setting(2.0, 0.0))
        assert not control.is_due
    control.setpoint = Setting(3.0, 0.0)
    assert applied(control, camera) == Applied(Setting(3.0, 0.0))
    assert camera.asked == [Setting(2.0, 0.0)] * 2 + [Setting(3.0, 0.0)]


@pytest.mark.parametrize("tells", ["", "exposure", "exposure gain"])
@pytest.mark.parametrize("lag", [0, 1, 2, 3])
@pytest.mark.parametrize("changed", [Setting(4.0, 0.0), Setting(4.0, 6.0), Setting(2.0, 6.0)])
def test_no_frame_passes_for_what_it_was_not_exposed_with(lag: int, tells: str, changed: Setting) -> None:
    camera, control = Camera(lag, tells), control_of("fixed")
    control.opened(camera)  # type: ignore[arg-type]
    marks = []
    for setpoint in (Setting(2.0, 0.0), changed):
        control.setpoint = setpoint
        applied(control, camera)
        for _ in range(8):
            taken, used = camera.frame()
            taken = control.mark(taken)
            marks.append(taken.changing)
            if not taken.changing:
                assert (taken.exposure_ms, taken.gain_db) == (used.exposure_ms, used.gain_db)
    assert marks[8]  # a window must see where the change lies
    assert sum(marks[8:]) == (
        max(lag, 1) if "gain" in tells or (tells and not changed.gain_db) else MAX_MARKED_FRAMES
    )


def test_an_exposure_that_never_comes_is_not_waited_for_longer_than_four_frames() -> None:
    camera, control = Camera(lag=1000, tells="exposure gain"), control_of()
    opened(control, camera)
    assert [control.mark(camera.frame()[0]).changing for _ in range(6)] == [True] * 4 + [False] * 2


def test_auto_stays_within_what_the_camera_can_and_fixed_asks_for_what_is_written() -> None:
    able = ExposureRange(0.05, 1.5, 0.0, 6.0)
    for name, asked in (("auto", Setting(1.5, 6.0)), ("fixed", Setting(10.0, 0.0))):
        camera, control = Camera(able=able), control_of(name, 10.0)
        assert opened(control, camera) == Applied(asked)
        assert camera.asked == [asked]


def test_a_camera_with_nothing_to_set_is_left_alone_and_says_so() -> None:
    camera, control = Camera(able=None), control_of()
    assert opened(control, camera) is None
    control.sample(control.mark(camera.frame()[0]), SPOT)
    assert camera.asked == []
    assert control.figures == ExposureFigures(
        "auto, but this camera has no adjustable setting", 0.51, None, None, 0
    )


def test_a_refusal_is_told_and_no_setpoint_follows_it_until_the_camera_is_opened_again() -> None:
    camera, control = Camera(), control_of(window=4)
    opened(control, camera)
    camera.failure = CameraRefusedError("the register is locked")
    control.setpoint = Setting(5.0, 0.0)
    assert applied(control, camera) == Refused("the register is locked")
    for _ in range(50):
        control.sample(control.mark(camera.frame(BRIGHT)[0]), SPOT)
    assert not control.is_due
    assert control.setpoint == Setting(5.0, 0.0)
    assert control.figures == ExposureFigures("auto, but the camera refuses", 0.9, 2.0, 0.0, 0)
    camera.failure = None
    assert opened(control, camera) == Applied(Setting(5.0, 0.0))
    control.sample(camera.frame(GOOD)[0], SPOT)
    assert control.figures.exposure_control == "auto"


def test_a_camera_that_goes_away_while_it_is_set_is_lost() -> None:
    camera, control = Camera(), control_of()
    control.opened(camera)  # type: ignore[arg-type]
    camera.failure = CameraLostError("unplugged")
    with pytest.raises(CameraLostError):
        applied(control, camera)


def test_a_spot_too_bright_is_exposed_less_and_the_figures_show_with_what() -> None:
    camera, control = Camera(), control_of(window=4)
    opened(control, camera)
    for _ in range(MAX_MARKED_FRAMES + 3):
        control.sample(control.mark(camera.frame(BRIGHT)[0]), SPOT)
    assert control.figures == ExposureFigures("auto", 0.9, 2.0, 0.0, 1)
    assert control.setpoint.exposure_ms == pytest.approx(2.0 * (0.35 * 0.8) ** 0.5 / (230 / 255))
    assert applied(control, camera) == Applied(control.setpoint)


@pytest.mark.parametrize("mark", ["changing", "leds_on"])
def test_what_is_not_the_beam_s_exposure_is_not_sampled(mark: str) -> None:
    control = control_of(window=4)
    opened(control, Camera())
    pixels = np.full((48, 64), 255, np.uint8)
    taken = Frame("front", 1, 0, pixels, exposure_ms=2.0, gain_db=0.0, **{mark: True})
    for _ in range(20):
        control.sample(taken, NoSpot(Reason.SATURATED))
    assert control.figures is None
    assert control.setpoint == Setting(2.0, 0.0)


@pytest.mark.parametrize(("name", "asked"), [("fixed", [Setting(2.0, 0.0)]), ("camera", [])])
def test_without_control_the_level_is_shown_and_the_setpoint_stays(name: str, asked: list[Setting]) -> None:
    camera, control = Camera(tells="exposure gain"), control_of(name, window=4)
    opened(control, camera)
    assert camera.asked == asked
    for _ in range(50):
        control.sample(Camera(tells="exposure gain").frame(BRIGHT)[0], SPOT)
    assert control.figures == ExposureFigures(name, 0.9, 1.0, 0.0, 0)
    assert control.setpoint == Setting(2.0, 0.0)
    assert not control.is_due


def test_a_camera_that_delivers_twelve_bits_in_sixteen_is_exposed_for_its_own_ceiling() -> None:
    camera, control, levels = Camera(tells="exposure gain"), control_of(exposure_ms=20.0), []
    rng, opened_once = np.random.default_rng(1), opened(control, camera)
    assert opened_once is not None
    for _ in range(200):
        taken, used = camera.frame()
        counts = 400 * used.exposure_ms * light(Blob(150, 120, peak=1), width=300, height=240)
        counts += 100 + rng.normal(0, 8, counts.shape)
        pixels = np.rint(np.minimum(counts, 4095)).astype(np.uint16)
        taken = control.mark(replace(taken, pixels=pixels, bits=16))
        control.sample(taken, locate(taken))
        applied(control, camera)
        levels.append(counts.max() / 4095)
    assert min(levels[-60:]) > 0.4
    assert max(levels[-60:]) < 0.9
    assert len(camera.asked) < 12, "it does not settle"
