"""The driver where there is no camera; with the kernel's test drivers: ``tests/system/devices/v4l2``."""

from __future__ import annotations

from pathlib import Path

import pytest

from altd.config import V4l2CameraSettings
from altd.devices.v4l2.camera import V4l2Camera
from altd.ports import CameraLostError, CameraNotFoundError, CameraRefusedError


def camera(device: Path) -> V4l2Camera:
    return V4l2Camera("front", V4l2CameraSettings(driver="v4l2", device=device))


def test_a_camera_that_is_not_there_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(CameraNotFoundError, match="none: there is no such camera now"):
        camera(tmp_path / "none").open()


@pytest.mark.parametrize("device", ["/dev/null", "/dev", "a file"])
def test_what_is_no_camera_is_refused(device: str, tmp_path: Path) -> None:
    path = tmp_path / device  # "/dev/null" and "/dev" stay themselves
    if device == "a file":
        path.touch()
    with pytest.raises(CameraRefusedError, match=f"^{path}: is not a Video4Linux device"):
        camera(path).open()


def test_a_camera_that_is_not_open_gives_no_frame_and_is_closed_without_harm() -> None:
    closed = camera(Path("/dev/null"))
    closed.close()
    with pytest.raises(CameraLostError, match="not open"):
        closed.next_frame(0.1)
    assert closed.exposure_range is None
