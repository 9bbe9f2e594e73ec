"""A camera whose frames Aravis receives, as of USB3 Vision: its fake camera of no network."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from support.gige import Grabbed

from altd.devices.aravis import AravisCameraSettings
from altd.devices.aravis.check import check
from altd.ports import CameraLostError, CameraNotFoundError
from altd.process.machine import Machine
from altd.records import CameraIdentity, Origin

pytestmark = pytest.mark.real_time


def usb_table(device: str, **settings: object) -> AravisCameraSettings:
    table = {"driver": "aravis", "interface": "usb", "device": device, "width": 512, "height": 512}
    return AravisCameraSettings.model_validate(table | settings)


def usb_camera(device: str = "1", **settings: object) -> Any:
    from altd.devices.aravis.driver import UsbCamera

    camera = usb_table(device, **settings).camera("front", None, {})
    assert type(camera) is UsbCamera
    return camera


@pytest.fixture(autouse=True)
def fake_interface() -> Iterator[None]:
    from altd.devices.aravis.binding import Aravis

    Aravis.enable_interface("Fake")
    yield
    Aravis.disable_interface("Fake")


@pytest.mark.parametrize(("pixel_format", "modulus"), [("Mono8", 255), ("Mono16", 65535)])
def test_frames_are_the_camera_s_own_in_time_and_without_gaps(pixel_format: str, modulus: int) -> None:
    """Aravis draws a ramp that moves by one grey value a frame, at the free rate that is set."""
    with Grabbed(usb_camera(pixel_format=pixel_format, fps=25.0)) as grabbed:
        grabbed.await_frames(10)
    assert not grabbed.errors
    frames = [frame for _, frame in grabbed.frames]
    x, y = np.meshgrid(np.arange(512), np.arange(512))
    ramp = (x + y) * (256 if modulus > 255 else 1)
    steps = {int(frame.pixels[0, 0]) for frame in frames}
    assert all(np.array_equal(frame.pixels, (ramp + int(frame.pixels[0, 0])) % modulus) for frame in frames)
    assert len(steps) == len(frames)
    assert [frame.sequence for frame in frames] == list(range(len(frames)))
    times_s = np.array([frame.t_ns for frame in frames]) * 1e-9
    assert np.median(np.diff(times_s)) == pytest.approx(1 / 25, rel=0.1)
    assert all(0 <= at - frame.t_ns < 100_000_000 for at, frame in grabbed.frames)
    assert grabbed.camera.origin is Origin.SIMULATED
    assert grabbed.camera.identity == CameraIdentity("1", "Fake", "aravis")


def test_exposure_and_gain_are_set_and_a_camera_is_opened_again() -> None:
    camera = usb_camera()
    for _ in range(2):
        camera.open()
        camera.set_exposure(5.0, 3.0)
        frame = camera.next_frame(2.0)
        assert (frame.exposure_ms, frame.gain_db) == (5.0, 3.0)
        camera.close()


def test_a_camera_that_is_not_connected_is_not_found_and_those_that_are_are_named() -> None:
    with pytest.raises(CameraNotFoundError, match="no USB3 Vision camera is 22; connected and open to us: 1"):
        usb_camera("22").open()


def test_the_doctor_tells_a_connected_camera_from_another() -> None:
    tables = {device: usb_table(device) for device in ("1", "22")}
    verdicts = {finding.subject: str(finding.verdict) for finding in check(tables, Machine())}
    assert verdicts == {"camera 1 1": "good", "camera 22 22": "ERROR"}


def test_a_camera_that_sends_other_frames_or_is_unplugged_is_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from altd.devices.aravis.binding import UsbDevice

    start, camera = UsbDevice.start, usb_camera()

    def start_and_change(device: UsbDevice, *arguments: Any) -> UsbDevice:
        start(device, *arguments)
        device.set("Width", 256)
        return device

    def unplugged(device: UsbDevice) -> None:
        raise CameraLostError("LIBUSB_ERROR_NO_DEVICE")

    monkeypatch.setattr(UsbDevice, "start", start_and_change)
    camera.open()
    with pytest.raises(CameraLostError, match=r"answers, but sent no frame for .*: sends 256 x 512"):
        camera.next_frame(5.0)
    monkeypatch.setattr(UsbDevice, "region", unplugged)
    with pytest.raises(CameraLostError, match="does not answer any more: LIBUSB_ERROR_NO_DEVICE"):
        camera.next_frame(5.0)
    camera.close()
