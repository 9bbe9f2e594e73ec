import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.cli import Outcome, altd_here
from support.played_unit import PlayedUnit
from support.recordings import place_px

from altd.calibration.file import load_calibration, save_calibration
from altd.records import Origin

U, V = place_px("rear", 12.0, -20.0)
LINES = f"{U} {V}\n\n1 1\n12 north\nnan 3\n1_0 20\n3\n1 2 3\n{U} {V} \n"


@pytest.fixture(scope="module")
def folder(played_unit: PlayedUnit) -> Path:
    return played_unit.folder


def map_(calibration: Path, *more: object, stdin: str = LINES) -> Outcome:
    return altd_here("map", "--calibration", calibration, "--target", "rear", *more, stdin=stdin)


def test_px_become_mm_or_the_reason(folder: Path) -> None:
    outcome = map_(folder / "cal.json", stdin=f"{U} {V}\n\n1 1\n")
    assert (outcome.status, outcome.err) == (0, "")
    inside, outside = outcome.out.splitlines()
    x, y, sigma_x, sigma_y = map(float, inside.split())
    assert (x, y) == pytest.approx((12.0, -20.0), abs=0.02)
    assert 0 < sigma_x < 0.02
    assert 0 < sigma_y < 0.02
    assert outside == "invalid out_of_range"


def test_where_two_maps_contradict_each_other(folder: Path, tmp_path: Path) -> None:
    calibration = load_calibration(folder / "cal.json")
    rear = calibration.targets[1]
    spectra = rear.cross_check.map.spectra.copy()
    spectra[1, 0, 0] += 10.0
    wrong = replace(rear.cross_check, map=replace(rear.cross_check.map, spectra=spectra))
    save_calibration(
        replace(calibration, targets=(calibration.targets[0], replace(rear, cross_check=wrong))),
        tmp_path / "cal.json",
    )
    outcome = map_(tmp_path / "cal.json", stdin=f"{U} {V}\n")
    assert (outcome.status, outcome.out) == (0, "invalid implausible\n")


def test_bad_lines_do_not_stop_the_others(folder: Path) -> None:
    outcome = map_(folder / "cal.json")
    assert outcome.status == 2
    first, *between, last = outcome.out.splitlines()
    assert between == ["invalid out_of_range", *["invalid unreadable"] * 5]
    assert first == last
    said = outcome.err.splitlines()
    assert [line.split(":")[2] for line in said] == [f" line {number}" for number in range(4, 9)]
    assert said[0] == "altd map: stdin: line 4: expected 'u v', got '12 north'"


def test_a_line_without_end_is_one_line(folder: Path) -> None:
    outcome = map_(folder / "cal.json", stdin="7" * 5000 + f"\n{U} {V}\n" + "x" * 1001 + f"\n{U} {V}")
    assert [line.split()[0] for line in outcome.out.splitlines()][::2] == ["invalid", "invalid"]
    assert [line.split(":")[2] for line in outcome.err.splitlines()] == [" line 1", " line 3"]
    assert all(len(line) < 200 for line in outcome.err.splitlines())


def test_rows_have_a_header_and_match_the_lines(folder: Path) -> None:
    plain = map_(folder / "cal.json").out.splitlines()
    of_json = map_(folder / "cal.json", "--format", "jsonl").objects
    outcome = map_(folder / "cal.json", "--format", "csv")
    header, *rows = csv.reader(io.StringIO(outcome.out, newline=""), strict=True)
    assert outcome.status == 2
    assert header == [
        *("line", "u_px", "v_px", "x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm", "reason", "origin")
    ]
    assert [row[0] for row in rows] == ["1", "3", "4", "5", "6", "7", "8", "9"]
    assert rows == [["" if value is None else str(value) for value in row.values()] for row in of_json]
    for line, row in zip(plain, of_json, strict=True):
        numbers = [row[name] for name in ("x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm")]
        if line.startswith("invalid"):
            assert line == f"invalid {row['reason']}"
            assert numbers == [None] * 4
        else:
            assert [float(field) for field in line.split()] == numbers
            assert (row["u_px"], row["v_px"], row["reason"]) == (U, V, None)


def test_a_calibration_of_simulated_frames_says_so(folder: Path, tmp_path: Path) -> None:
    calibration = load_calibration(folder / "cal.json")
    targets = tuple(replace(target, origin=Origin.SIMULATED) for target in calibration.targets)
    save_calibration(replace(calibration, targets=targets), tmp_path / "cal.json")
    outcome = map_(tmp_path / "cal.json", "--format", "jsonl", stdin=f"{U} {V}\n")
    assert json.loads(outcome.out)["origin"] == "simulated"
    assert outcome.err == f"altd map: {tmp_path}/cal.json: rear was calibrated from SIMULATED frames\n"
    assert outcome.status == 0
