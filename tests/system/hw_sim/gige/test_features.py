"""A camera's features and settings, asked by Aravis' own tool and by a client on Aravis."""

import itertools
import subprocess
import time
from collections.abc import Iterator

import numpy as np
import pytest
from support.foreign import need_program
from support.gige_unit import Client, Received, Served, client

from hw_sim.sensor import BLACK_LEVEL
from hw_sim.unit import CAMERAS, EXPOSURES_MS


def arv_tool(*arguments: str) -> list[str]:
    tool = need_program("arv-tool-0.8", "aravis-tools-cli")
    done = subprocess.run([tool, *arguments], capture_output=True, text=True, timeout=30, check=True)
    return done.stdout.splitlines()


def light(pixels: np.ndarray, bits: int = 8) -> float:
    """Mean light in shares of full scale."""
    return float(pixels.mean()) / ((1 << bits) - 1) - BLACK_LEVEL


def test_aravis_finds_both_cameras_by_their_serial_numbers(unit_at_rest: Served) -> None:
    """It asks for half a second, and lists one of two cameras of a name, as another test's."""
    listed = [f"altd-hw_sim-SIM-5-{name} ({getattr(unit_at_rest, name)})" for name in CAMERAS]
    end_s = time.monotonic() + 60.0
    while not set(listed) <= set(found := arv_tool()):
        assert time.monotonic() < end_s, found
    for name in CAMERAS:
        assert f"SIM-5-{name} at {getattr(unit_at_rest, name)}" in unit_at_rest.said


def test_a_client_that_finds_a_camera_by_its_name_gets_its_frames(unit_at_rest: Served) -> None:
    # beside a network card, where the same broadcast goes out, it must not be looked for there
    with client("altd-hw_sim-SIM-5-front") as front:
        assert front.take(2)[-1].pixels.shape == (480, 752)


def test_the_features_have_the_standard_names(unit_at_rest: Served) -> None:
    said = "\n".join(arv_tool("-a", unit_at_rest.front, "values"))
    for line in (
        "'DeviceManufacturerInfo' = 'simulated: nothing here is live'",
        "'DeviceUserID' = 'front'",
        "'DeviceTemperature' = 38 C",
        "'Width' = 752",
        "'Height' = 480",
        "'PixelFormat' = 'Mono8'",
        "'AcquisitionFrameRate' = 20 Hz",
        f"'ExposureTime' = {1000 * EXPOSURES_MS['front']:g} us",
        "'Gain' = 0 dB",
        "'LineSource' = 'UserOutput0'",
        "'UserOutputValue' = false",
        "'PayloadSize' = 360960",
    ):
        assert line in said


def test_the_light_goes_with_the_exposure_and_with_the_gain(unit_at_rest: Served) -> None:
    with client(unit_at_rest.rear) as rear:

        def lit(exposure_us: float, gain_db: float) -> float:
            rear.set(ExposureTime=exposure_us, Gain=gain_db, PixelFormat="Mono16")
            return light(rear.take(3)[-1].pixels, 16)

        hot = lit(20.0, 0.0)  # hot pixels leak whatever the exposure
        once = lit(400.0, 0.0) - hot
        assert lit(800.0, 0.0) - hot == pytest.approx(2 * once, rel=0.05)
        assert lit(1600.0, 0.0) - hot == pytest.approx(4 * once, rel=0.05)
        assert lit(400.0, 20 * np.log10(2.0)) - 2 * hot == pytest.approx(2 * once, rel=0.05)
        rear.set(ExposureTime=1600.0, Gain=0.0, PixelFormat="Mono8")


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_each_pixel_format_has_the_same_picture_on_its_own_scale(unit_at_rest: Served, bits: int) -> None:
    with client(unit_at_rest.rear) as rear:
        rear.set(PixelFormat="Mono16")
        reference = rear.take(1)[0].pixels
        rear.set(PixelFormat=f"Mono{bits}")
        pixels = rear.take(1)[0].pixels
        rear.set(ExposureTime=40_000.0)
        bright = rear.take(2)[-1].pixels
        rear.set(ExposureTime=1600.0, PixelFormat="Mono8")
    assert pixels.shape == bright.shape == (480, 752)
    assert pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
    full = (1 << bits) - 1
    assert bright.max() == full
    assert (bright == full).sum() > 1000
    assert (pixels == full).sum() < 20  # hot pixels
    scaled = pixels * (65535 / full)
    assert np.percentile(scaled, 99.9) == pytest.approx(np.percentile(reference, 99.9), rel=0.02)
    assert scaled.mean() == pytest.approx(reference.mean(), rel=0.01)
    if bits > 8:
        assert len(np.unique(pixels)) > 256


def test_a_region_is_cut_out_of_the_chip(unit_at_rest: Served) -> None:
    with client(unit_at_rest.rear) as rear:
        whole = rear.take(1)[0].pixels
        rear.set(Width=320, Height=200, OffsetX=250, OffsetY=150)
        part = rear.take(1)[0].pixels
        rear.set(OffsetX=0, OffsetY=0, Width=752, Height=480)
    assert part.shape == (200, 320)
    # only noise is between two exposures of a beam at rest
    difference = part.astype(float) - whole[150:350, 250:570]
    assert np.corrcoef(part.ravel(), whole[150:350, 250:570].ravel())[0, 1] > 0.98
    assert difference.mean() == pytest.approx(0.0, abs=0.2)


def after_a_pause(camera: Client, pause_s: float) -> Iterator[Received]:
    """The first frame of a camera that is started after a pause; none when none comes."""
    time.sleep(pause_s)
    camera.start()
    frame = camera.next(within_us=5_000_000)
    camera.stop()
    if frame is not None:
        yield frame


@pytest.mark.parametrize(
    ("register", "value"),
    [(0x100, 0x10000), (0x104, 481), (0x100, 0), (0x130, 1), (0x130, 0x80000000), (0x128, 0xDEAD0007)],
    ids=["width", "height", "no width", "offset", "negative offset", "format"],
)
def test_registers_that_no_chip_can_follow_send_nothing_and_harm_nothing(
    unit_at_rest: Served, register: int, value: int
) -> None:
    with client(unit_at_rest.rear) as rear:
        before = rear.poke(register, value)
        rear.start()
        assert rear.next(within_us=300_000) is None
        rear.stop()
        rear.poke(register, before)
        # Aravis' own loop asks where to send frames only once it found itself stopped between two of them
        pauses_s = 0.3, 1.0, 3.0, 10.0
        frames = itertools.chain.from_iterable(after_a_pause(rear, pause_s) for pause_s in pauses_s)
        assert next(frames).pixels.shape == (480, 752)


def test_an_exposure_beyond_its_bounds_is_the_nearest_possible(unit_at_rest: Served) -> None:
    with client(unit_at_rest.rear) as rear:
        rear.poke(0x120, 0xFFFFFFFF)
        rear.take(1)
        assert rear.number("ExposureTime") == 40_000.0
        rear.set(ExposureTime=1600.0)
