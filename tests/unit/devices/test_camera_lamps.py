from typing import Any, cast

import pytest

from altd.devices.camera_lamps import CameraLamps, CameraSwitches
from altd.ports import CameraLostError, CameraNotFoundError, LampsError, SwitchingCamera


class Camera:
    """The part of a camera that these lamps use; its output keeps its level when the camera is closed."""

    def __init__(self) -> None:
        self.is_open = False
        self.is_there = True
        self.outputs = {"Line1": True}  # left lit by an earlier program

    def open(self) -> None:
        if not self.is_there:
            raise CameraNotFoundError("no such camera")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def switch_output(self, line: str, on: bool) -> None:
        if not self.is_open:
            raise CameraLostError("the camera is not open")
        self.outputs[line] = on


@pytest.fixture
def cameras() -> dict[str, Camera]:
    return {"front": Camera(), "rear": Camera()}


def lamps(cameras: dict[str, Camera], **more: Any) -> CameraLamps:
    return CameraLamps(cast("dict[str, SwitchingCamera]", cameras), "Line1", **more)


def levels(cameras: dict[str, Camera]) -> list[bool]:
    return [camera.outputs["Line1"] for camera in cameras.values()]


def test_the_outputs_of_all_cameras_switch_together_dark_at_both_ends(cameras: dict[str, Camera]) -> None:
    for camera in cameras.values():
        camera.open()
    leds = lamps(cameras)
    leds.open()
    assert levels(cameras) == [False, False]
    leds.switch(True)
    assert levels(cameras) == [True, True]
    leds.close()
    assert levels(cameras) == [False, False]
    assert all(camera.is_open for camera in cameras.values())  # they are not ours to close


def test_a_camera_that_is_not_there_is_named_and_the_other_is_switched(cameras: dict[str, Camera]) -> None:
    cameras["rear"].open()
    leds = lamps(cameras)
    with pytest.raises(LampsError, match=r"^Line1 of camera front: the camera is not open$"):
        leds.open()
    assert levels(cameras) == [True, False]
    leds.close()


def test_alone_the_cameras_are_opened_and_closed_too(cameras: dict[str, Camera]) -> None:
    leds = lamps(cameras, alone=True)
    leds.open()
    leds.switch(True)
    assert levels(cameras) == [True, True]
    leds.close()
    assert levels(cameras) == [False, False]
    assert not any(camera.is_open for camera in cameras.values())


def test_alone_a_camera_that_is_not_there_is_named(cameras: dict[str, Camera]) -> None:
    cameras["front"].is_there = False
    leds = lamps(cameras, alone=True)
    with pytest.raises(LampsError, match="camera front: no such camera"):
        leds.open()
    leds.close()
    assert not cameras["rear"].is_open


def test_one_targets_glass_is_without_voltage_at_both_ends_all_are(cameras: dict[str, Camera]) -> None:
    for camera in cameras.values():
        camera.open()
    switching = cast("dict[str, SwitchingCamera]", cameras)
    glasses = CameraSwitches(switching, {"t1": "front", "t2": "rear"}, "Line1")
    glasses.open()
    assert levels(cameras) == [False, False]
    glasses.show("t1")
    assert levels(cameras) == [False, True]
    glasses.show("t2")
    assert levels(cameras) == [True, False]
    cameras["front"].close()
    with pytest.raises(LampsError, match="Line1 of camera front: the camera is not open"):
        glasses.show("t1")
    assert levels(cameras)[1] is True  # the other is switched all the same
    cameras["front"].open()
    glasses.close()
    assert levels(cameras) == [False, False]
