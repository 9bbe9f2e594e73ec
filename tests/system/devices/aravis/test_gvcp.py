"""Single questions to Aravis' simulated cameras."""

import pytest
from support.gige import HOME, Cameras, register, wait_for

from altd.devices.aravis import gvcp


@pytest.mark.own_network
class TestCameras:
    def test_are_found_by_broadcast_and_called_by_four_names(self, cameras: Cameras) -> None:
        cameras.start(HOME, "T1")
        cameras.start("127.0.0.2", "T2")
        first, second = gvcp.discover(1.5)
        assert (first.address, first.serial) == (HOME, "T1")
        assert (second.address, second.serial, second.vendor, second.model) == (
            "127.0.0.2",
            "T2",
            "Aravis",
            "Fake",
        )
        assert second.has_name("Aravis-Fake-T2")
        assert not second.has_name("T1")
        assert not second.has_name("")

    def test_tell_who_controls_them(self, cameras: Cameras) -> None:
        cameras.start()
        assert gvcp.control_privilege(HOME, 5.0) == 0
        assert gvcp.heartbeat_timeout_s(HOME, 5.0) == 3.0
        register(HOME, 0xA00, 2)
        assert gvcp.control_privilege(HOME, 5.0) == 2
        cameras.stop()
        wait_for(lambda: gvcp.control_privilege(HOME, 0.1) is None)
