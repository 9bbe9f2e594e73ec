"""A plate with four dark LEDs, and the calibration that is made of it."""

from pathlib import Path

import numpy as np
import pytest
from support.plates import FRONT, REAR, View, plate_light, write_plate

from altd.calibration.calibrating import calibrate
from altd.calibration.result import CalibrationResult
from altd.recording.reader import open_recording


@pytest.fixture(scope="module")
def two_dark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the plate; two LEDs of each target are dark."""
    folder = tmp_path_factory.mktemp("plate") / "rec"
    return write_plate(folder, plate_light(FRONT, [(2, 1), (3, 3)]), plate_light(REAR, [(5, 4), (3, 2)]))


@pytest.fixture(scope="module")
def result(two_dark: Path) -> CalibrationResult:
    """The calibration made from it."""
    return calibrate([open_recording(two_dark)])


def misses_mm(result: CalibrationResult, name: str, view: View) -> np.ndarray:
    """The errors of a target's map at points of the plate."""
    target = result.calibration.target(name)
    assert target is not None
    return view.misses_mm(lambda px: target.inverse.to_mm(px)[0])


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports have all their words but no drawings, which take ten seconds."""
    monkeypatch.setattr("altd.calibration.report.html.svg", lambda *_: b"<svg></svg>")
    monkeypatch.setattr("altd.calibration.report.sheets.pdf_sheets", lambda *_: b"%PDF")
