"""The driver against the kernel's own test drivers, in a guest."""

from typing import Any

import numpy as np
import pytest
from support import jpegs
from support.foreign import need_program
from support.guest import GuestRun, run_in_guest

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> GuestRun:
    need_program("v4l2-ctl", "v4l-utils")
    return run_in_guest(
        tmp_path_factory.mktemp("frames"),
        "vivid_frames.py",
        kernel_arguments=("vivid.n_devs=2", "vivid.multiplanar=1,2", "v4l2loopback.devices=1"),
    )


def test_vivid_shows_its_grey_ramp_in_eight_bits(frames: GuestRun) -> None:
    assert frames.results
    ramp = np.load(frames.folder / "GREY.npy")
    assert ramp.shape == (360, 640)
    assert ramp.dtype == np.uint8
    np.testing.assert_array_equal(ramp, np.broadcast_to(ramp[0], ramp.shape))
    np.testing.assert_allclose(ramp[0], np.arange(640) * 255 / 640, atol=2.0)


@pytest.mark.parametrize(("name", "more_bits"), [("Y10", 2), ("Y12", 4), ("Y16", 8)])
def test_formats_of_more_bits_show_the_same_ramp(frames: GuestRun, name: str, more_bits: int) -> None:
    assert frames.results
    eight, more = np.load(frames.folder / "GREY.npy"), np.load(frames.folder / f"{name}.npy")
    assert more.dtype == np.uint16
    np.testing.assert_array_equal(more >> more_bits, eight)


@pytest.mark.parametrize("name", ["YUYV", "UYVY", "NV12"])
def test_a_luminance_is_the_same_ramp_from_black_16_to_white_235(frames: GuestRun, name: str) -> None:
    assert frames.results
    grey, luminance = np.load(frames.folder / "GREY.npy"), np.load(frames.folder / f"{name}.npy")
    below = luminance < 235
    assert below.mean() > 0.99
    assert (luminance[~below] == 255).all()
    np.testing.assert_allclose(luminance[below], 16 + grey[below] * (219 / 255), atol=1.5)


@pytest.mark.parametrize("name", ["GREY", "Y16", "YUYV", "NV12"])
def test_a_camera_with_the_multi_planar_interface_gives_the_same_pixels(frames: GuestRun, name: str) -> None:
    assert frames.results["planes"][name] == frames.results["formats"][name]
    one, other = (np.load(frames.folder / f"{kind}{name}.npy") for kind in ("", "planes-"))
    np.testing.assert_array_equal(one, other)


def test_jpegs_are_those_that_were_sent_and_damaged_ones_are_gaps(frames: GuestRun) -> None:
    assert np.diff(frames.results["jpegs"])[-2:].tolist() == [2, 2]
    taken = np.load(frames.folder / "MJPG.npy")
    expected = [jpegs.SMOOTH, jpegs.SMOOTH[:, ::-1], jpegs.SMOOTH[::-1]]
    np.testing.assert_allclose(taken[-3:], expected, atol=4)
    np.testing.assert_array_equal(taken[:-3], [taken[-3]] * (len(taken) - 3), "shown since the feed began")


@pytest.mark.parametrize(
    ("name", "bits"), [("GREY", 8), ("Y10", 10), ("Y12", 12), ("Y16", 16), ("YUYV", 8), ("NV12", 8)]
)
def test_a_frame_is_a_read_only_copy_marked_as_simulated(frames: GuestRun, name: str, bits: int) -> None:
    said = frames.results["formats"][name]
    assert said == {
        "bits": bits,
        "writeable": False,
        "owns": True,
        "origin": "simulated",
        "exposure_range": None,
        "exposure_ms": None,
    }


def test_dropped_buffers_are_gaps_in_the_numbers(frames: GuestRun) -> None:
    sequence = frames.results["dropped"]
    steps = np.diff(sequence)
    assert (steps > 0).all()
    exposed = sequence[-1] - sequence[0] + 1
    share = 1 - len(sequence) / exposed
    assert 0.08 < share < 0.4, "0.2 are drawn, with a sigma of 0.033; a busy machine loses some more"


def test_a_damaged_frame_is_a_gap_of_one(frames: GuestRun) -> None:
    assert sorted(np.diff(frames.results["damaged"])) == [1] * 13 + [2]


def test_the_numbers_go_on_over_the_end_of_the_driver_s(frames: GuestRun) -> None:
    sequence = frames.results["wrapped"]
    assert sequence[0] == 0
    assert sequence[-1] > 128, "it began 128 before the wrap"
    assert max(np.diff(sequence)) < 30
    assert min(np.diff(sequence)) > 0


def test_the_numbers_go_on_after_a_re_opening(frames: GuestRun) -> None:
    sequence = frames.results["reopened"]
    assert min(np.diff(sequence)) > 0
    assert sequence[4] == sequence[3] + 1


def test_an_automatic_gain_is_switched_off_unless_it_is_accepted(frames: GuestRun) -> None:
    assert frames.results["automatic"] == [[], "gain_automatic: 0", [], "gain_automatic: 1"]


def test_a_camera_that_is_silent_is_said_to_be_in_time(frames: GuestRun) -> None:
    silent = frames.results["silent"]
    assert silent["error"] == "CameraTimeoutError"
    assert 0.3 <= silent["seconds"] < 0.6
    assert "no frame within 0.3 s" in silent["message"]


@pytest.mark.parametrize("source", ["end_of_frame", "start_of_exposure"])
def test_frames_are_stamped_on_the_monotonic_clock_at_the_camera_s_rate(
    frames: GuestRun, source: str
) -> None:
    stamps = frames.results["stamps"][source]
    t_s = np.array(stamps["t_ns"]) * 1e-9
    assert np.median(np.diff(t_s)) == pytest.approx(1 / 25, rel=0.05)
    assert abs(np.median(np.array(stamps["taken_ns"]) * 1e-9 - t_s)) < 0.1


@pytest.fixture(scope="module")
def failures(tmp_path_factory: pytest.TempPathFactory) -> Any:
    need_program("v4l2-ctl", "v4l-utils")
    run = run_in_guest(
        tmp_path_factory.mktemp("failures"), "vivid_failures.py", kernel_arguments=("vivid.n_devs=2",)
    )
    return run.results


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [
        ("absent", "CameraNotFoundError", "/dev/video-none: there is no such camera now"),
        ("no camera", "CameraRefusedError", "/dev/null: is not a Video4Linux device"),
        ("an output", "CameraRefusedError", "is not a camera: it streams no frames"),
        (
            "size",
            "CameraRefusedError",
            "has no frames of 752 × 480 in GREY; the nearest is 640 × 480 of 320 × 180",
        ),
        ("rate", "CameraRefusedError", "does not run at 20 frames/s; the nearest is"),
        (
            "no such control",
            "CameraRefusedError",
            "has no control exposure_time; it has brightness, contrast",
        ),
        (
            "control out of range",
            "CameraRefusedError",
            "control brightness does not take 256: it takes 0 to 255",
        ),
    ],
)
def test_a_refusal_says_what_there_is_instead(failures: Any, asked: str, error: str, words: str) -> None:
    assert failures[asked]["error"] == error
    assert words in failures[asked]["message"]


def test_controls_are_set_when_the_camera_is_opened(failures: Any) -> None:
    assert failures["control"]["error"] == ""
    assert failures["brightness"] == "brightness: 200"


def test_a_camera_is_not_taken_from_another_program(failures: Any) -> None:
    refused, undisturbed, free_again = failures["busy"]
    assert refused["error"] == "CameraBusyError"
    assert "another program uses the camera" in refused["message"]
    assert undisturbed["error"] == free_again["error"] == ""


def test_an_exposure_is_refused_where_the_driver_has_none(failures: Any) -> None:
    assert failures["set_exposure"]["error"] == "CameraRefusedError"
    assert "no exposure" in failures["set_exposure"]["message"]


def test_a_stream_that_breaks_off_is_lost_at_once_and_opened_again(failures: Any) -> None:
    lost, again = failures["broken"]
    assert lost["error"] == "CameraLostError"
    assert "the driver broke off the stream" in lost["message"]
    assert lost["seconds"] < 1.5
    assert again["error"] == ""


def test_a_camera_pulled_out_is_lost_at_once_and_found_again_at_its_place(failures: Any) -> None:
    lost, away, back = failures["re-plugged"]
    assert lost["error"] == "CameraLostError"
    assert "the camera is gone" in lost["message"]
    assert lost["seconds"] < 1.5
    assert away["error"] == "CameraNotFoundError"
    assert back["error"] == ""
