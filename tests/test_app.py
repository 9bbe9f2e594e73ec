from __future__ import annotations

from altd.app import setters_of
from altd.config import Config


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
    setters = setters_of(config)
    assert {name: setter.wish.exposure_ms for name, setter in setters.items()} == {"auto": 3.0, "fixed": 3.0}
