"""The GigE Vision cameras that are found, and the message of a machine without Aravis."""

import subprocess
import sys
import time

import pytest
from support.gige import HOME, Cameras, Grabbed, driver, register


@pytest.mark.waits
@pytest.mark.own_network
class TestFoundCameras:
    def test_are_named_as_the_config_wants_them(self, cameras: Cameras) -> None:
        from altd.devices.aravis.open_camera import find_cameras

        cameras.start(HOME, "T1")
        cameras.start("127.0.0.2", "T2")
        first, second = find_cameras()
        assert (first.id, first.serial, first.address) == ("Aravis-Fake-T1", "T1", HOME)
        assert (second.id, second.serial, second.address) == ("Aravis-Fake-T2", "T2", "127.0.0.2")
        assert first.formats == second.formats == ("Mono8", "Mono16")
        assert register(HOME, 0xA00) == 0

    def test_in_use_are_left_alone(self, cameras: Cameras) -> None:
        from altd.devices.aravis.open_camera import find_cameras

        cameras.start()
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(3)
            began_s = time.monotonic()
            (found,) = find_cameras()
            assert (found.serial, found.in_use, found.formats) == ("T1", True, None)
            assert time.monotonic() - began_s < 1.5
            grabbed.await_frames(3)
            assert not grabbed.errors


def test_without_aravis_the_config_is_refused_with_the_remedy() -> None:
    program = """
import sys
from pathlib import Path
sys.modules["gi"] = None
from altd.devices import aravis
aravis.DEBIAN_GI = Path("none")
from altd.devices.aravis import AravisCameraSettings
from altd.errors import BadInputError
from altd.runtime.clock import SystemClock
try:
    AravisCameraSettings(driver="aravis", device="10.0.0.7").camera("front", SystemClock(), {})
except BadInputError as error:
    print(error)
"""
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.startswith("cameras.front: this camera needs Aravis")
    assert "apt-get install python3-gi gir1.2-aravis-0.8, see docs/cameras.md" in said
