from pathlib import Path
from typing import Any

import pytest
from support.foreign import need_program
from support.guest import run_in_guest

BY_PATH = "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Any:
    need_program("v4l2-ctl", "v4l-utils")
    drivers = ("vivid.n_devs=1", "v4l2loopback.devices=1")
    run = run_in_guest(tmp_path_factory.mktemp("inventory"), "find_cameras.py", kernel_arguments=drivers)
    return run.results


def test_a_camera_is_found_by_its_stable_path_with_the_formats_that_altd_reads(results: Any) -> None:
    camera = next(camera for camera in results["found"] if camera["driver"] == "vivid")
    assert camera["path"] == BY_PATH
    assert camera["card"] == "vivid"
    assert list(camera["formats"]) == ["GREY", "Y10", "Y12", "Y16", "YUYV", "UYVY", "NV12"]
    assert camera["formats"]["GREY"][:2] == ["320 × 180", "640 × 360"]


def test_controls_have_the_names_and_ranges_that_v4l2_ctl_shows(results: Any) -> None:
    camera = next(camera for camera in results["found"] if camera["driver"] == "vivid")
    shown = results["v4l2_ctl"]
    assert shown["brightness"] == [0, 255]
    for name, range_ in shown.items():
        assert camera["controls"][name] == range_


def test_outputs_are_no_cameras_and_a_camera_without_a_stable_path_has_its_number(results: Any) -> None:
    others = [camera["path"] for camera in results["found"] if camera["driver"] != "vivid"]
    assert len(others) == 1
    assert Path(others[0]).parent == Path("/dev")


def test_a_camera_that_may_not_be_read_is_listed_with_the_reason(results: Any) -> None:
    assert [BY_PATH, "Permission denied"] in results["unreadable"]
