import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock, call

import pytest

from altd.app.parts import cameras_of, exposure_controls_of, lamps_of
from altd.app.reloading import RELOADED, changed_keys
from altd.config import Config
from altd.devices.trigger_times import TriggerTimes
from altd.errors import BadInputError
from altd.ports import Camera, SwitchingCamera


def test_a_recording_or_scan_sets_the_live_cameras_that_are_not_left_to_themselves() -> None:
    def live(control: str) -> dict[str, object]:
        exposure = {"control": control, "exposure_ms": 3.0}
        return {"driver": "v4l2", "device": "/dev/video0", "exposure": exposure}

    names = ("auto", "fixed", "camera", "recording")
    config = Config.model_validate(
        {
            "unit": {"serial": "A", "calibration": "calibration.json"},
            "targets": [{"name": n, "z_mm": 10.0 * z, "camera": n} for z, n in enumerate(names)],
            "cameras": {n: live(n) for n in names[:3]}
            | {"recording": {"driver": "recording", "path": "rec"}},
            "measuring": {"pair_by": "time"},
        }
    )
    controls = exposure_controls_of(config)
    assert {name: each.setpoint.exposure_ms for name, each in controls.items()} == {"auto": 3.0, "fixed": 3.0}


def test_cameras_that_altd_triggers_share_instants_that_the_slower_one_can_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver = SimpleNamespace(AravisCamera=Mock(), UsbCamera=Mock())
    monkeypatch.setitem(sys.modules, "altd.devices.aravis.driver", driver)
    live = {"driver": "aravis", "trigger": "software"}
    cameras = {n: live | {"device": n, "exposure": {"longest_ms": ms}} for n, ms in (("a", 40.0), ("b", 5.0))}
    config = Config.model_validate(
        {
            "unit": {"serial": "A", "calibration": "calibration.json"},
            "targets": [{"name": n, "z_mm": z, "camera": n} for n, z in (("a", 0.0), ("b", 280.0))],
            "cameras": cameras,
        }
    )
    cameras_of(config, Path("altd.toml"))
    first, second = (made.args[2] for made in driver.AravisCamera.call_args_list)
    assert first is second
    wanted = TriggerTimes(50_000_000, round(1e6 * config.cameras["a"].busy_ms))
    instants_ns = range(0, 10**10, 7_000_000)
    assert [first.after(t_ns) for t_ns in instants_ns] == [wanted.after(t_ns) for t_ns in instants_ns]


class TestLampsOfCameras:
    CONFIG = Config.model_validate(
        {
            "unit": {"serial": "A", "calibration": "calibration.json"},
            "targets": [{"name": n, "z_mm": z, "camera": n} for n, z in (("front", 0.0), ("rear", 280.0))],
            "cameras": {n: {"driver": "aravis", "device": n} for n in ("front", "rear")},
            "measuring": {"pair_by": "time"},
            "lamps": {"driver": "camera", "cameras": ["rear"], "line": "Line2"},
        }
    )

    def test_hang_on_the_outputs_that_the_config_names(self) -> None:
        cameras: dict[str, Any] = {"front": Mock(spec=SwitchingCamera), "rear": Mock(spec=SwitchingCamera)}
        lamps = lamps_of(self.CONFIG, cameras, Path("altd.toml"))
        lamps.switch(True)
        assert cameras["rear"].switch_output.call_args_list == [call("Line2", True)]
        assert not cameras["front"].switch_output.called

    def test_want_cameras_that_have_outputs(self) -> None:
        cameras: dict[str, Any] = {"front": Mock(spec=Camera), "rear": Mock(spec=Camera)}
        with pytest.raises(BadInputError, match=r"altd\.toml: lamps: camera 'rear' has no output to switch"):
            lamps_of(self.CONFIG, cameras, Path("altd.toml"))


def test_each_key_that_differs_is_named() -> None:
    old = {"unit": {"serial": "A", "k": 1}, "http": None, "targets": [{"name": "front"}], "chain": {"a": 1}}
    new = {"unit": {"serial": "B", "k": 1}, "http": {"port": 1}, "targets": [], "chain": None}
    assert list(changed_keys(old, new)) == ["unit.serial", "http", "targets", "chain"]
    assert list(changed_keys(old, old)) == []


def test_the_tables_that_may_change_are_tables() -> None:
    assert set(RELOADED) < set(Config.model_fields)
