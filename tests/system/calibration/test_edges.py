"""Scans whose outer nodes the picture cuts, or that lack outer rows."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from support.recordings import Shot, grid, place_px, write

from altd.calibration.calibrating import calibrate
from altd.calibration.result import CalibrationResult
from altd.errors import BadInputError
from altd.recording.reader import open_recording

COLUMNS_MM = -70.0, -42.0, -14.0, 14.0, 42.0, 70.0
ROWS_MM = -55.0, -27.5, 0.0, 27.5, 55.0
CUT_ROWS_MM = -60.0, -30.0, 0.0, 30.0, 60.0
"""The spots of the outer rows have 40 px and are 9 px from the border of the picture, which cuts them."""

Place = tuple[float, float]


def calibrated(
    path: Path, dark_in_front: Iterable[Place] = (), rows_mm: Iterable[float] = ROWS_MM
) -> CalibrationResult:
    """The calibration of a scan in which some nodes have no spot on the front target."""
    dark = set(dark_in_front)
    shots: list[Shot] = [
        (None if (x, y) in dark else (x, y), (x, y), (x, y)) for y in rows_mm for x in COLUMNS_MM
    ]
    return calibrate([open_recording(write(path, "scan", shots))])


def test_nodes_that_the_border_cuts_are_used_and_named_with_their_weight(tmp_path: Path) -> None:
    result = calibrated(tmp_path / "scan", rows_mm=CUT_ROWS_MM)
    assert result.refused == ()
    named = [line for line in result.remarks if " counts by 1/" in line]
    assert named
    assert all(" y -60 mm" in line or " y 60 mm" in line for line in named)
    for seen in result.evidence:
        inner = np.abs(seen.nodes_mm[:, 1]) < 50
        assert np.all(seen.relative_sigma[inner] == 1.0)
        assert np.median(seen.relative_sigma[~inner]) > 1.0


def test_a_missing_row_is_named_and_does_not_refuse_the_scan(tmp_path: Path) -> None:
    top = [(x, ROWS_MM[-1]) for x in COLUMNS_MM]
    result = calibrated(tmp_path / "scan", [*top, (14.0, 0.0)])  # seven of thirty
    assert len(result.refused) == 7
    assert all(line.startswith("front node x ") and "spot_missing" in line for line in result.refused)
    # with four rows left none can be left out to see what is known beyond them
    (doubt,) = [line for line in result.doubts if "outer row" in line]
    assert doubt == (
        "front: no node of the outer row at y 55 mm can be used: the measurable area ends at y 27.5 mm"
    )
    front = result.calibration.target("front")
    assert front is not None
    for y_mm, known in ((20.0, True), (27.0, True), (30.0, False)):
        point = front.point(*place_px("front", -28.0, y_mm))
        assert (point is not None) is known
        if point is not None:
            assert (point.x_mm, point.y_mm) == pytest.approx((-28.0, y_mm), abs=0.05)


def test_two_missing_rows_of_five_refuse_it(tmp_path: Path) -> None:
    outer = [(x, y) for x in COLUMNS_MM for y in (ROWS_MM[0], ROWS_MM[-1])]
    with pytest.raises(BadInputError, match="front: 12 of 30 nodes have no spot"):
        calibrated(tmp_path / "scan", outer)


def test_too_few_nodes_are_named_with_what_a_map_needs(tmp_path: Path) -> None:
    write(tmp_path / "scan", "scan", [(node, node, node) for node in grid(2, 2)])
    with pytest.raises(BadInputError, match=r"4 nodes do not form a usable grid: .* at least 4 × 4"):
        calibrate([open_recording(tmp_path / "scan")])
