from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import pytest

from altd.app.parts import exposure_controls_of, lamps_of
from altd.config import Config
from altd.errors import BadInputError
from altd.ports import Camera, SwitchingCamera


def test_a_recording_or_scan_sets_the_live_cameras_that_are_not_left_to_themselves() -> None:
    def live(control: str) -> dict[str, object]:
        return {
            "driver": "v4l2",
            "device": "/dev/video0",
            "exposure": {"control": control, "exposure_ms": 3.0},
        }

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
    assert {name: control.setpoint.exposure_ms for name, control in controls.items()} == {
        "auto": 3.0,
        "fixed": 3.0,
    }


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
        assert lamps is not None
        lamps.switch(True)
        assert cameras["rear"].switch_output.call_args_list == [call("Line2", True)]
        assert not cameras["front"].switch_output.called

    def test_want_cameras_that_have_outputs(self) -> None:
        cameras: dict[str, Any] = {"front": Mock(spec=Camera), "rear": Mock(spec=Camera)}
        with pytest.raises(BadInputError, match=r"altd\.toml: lamps: camera 'rear' has no output to switch"):
            lamps_of(self.CONFIG, cameras, Path("altd.toml"))
