"""The calibration's file, its report and its summary are those of what was loaded, or not given at all."""

import asyncio
import hashlib
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.evidence import DISTANCE_MM, calibration, evidence, target
from support.recordings import PX_PER_MM, header
from support.unit_toml import played_toml

from altd.app import calibration_files
from altd.app.calibration_files import ReadCalibrationFiles
from altd.app.calibration_summary import summary_of, target_areas_of
from altd.app.settings import load_settings
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.report.budget import beams_of
from altd.calibration.report.content import report_on
from altd.calibration.report.write import Source
from altd.publish.serial.console import Console
from altd.recording.header import RecordingHeader
from altd.records import CameraIdentity, Origin
from altd.status.calibration_summary import MAX_TEXT_CHARACTERS, CalibrationSummary
from altd.status.services import NoCalibrationFileError, NoReportError
from altd.terminal.documents import CalibrationDocument, checked
from tools.pages.serial_examples import unit_that_shows


def page_of(checksum: str) -> str:
    """As the head of a report is, by hand."""
    head = f'<meta charset="utf-8">\n<meta name="altd-calibration" content="{checksum}">'
    return f"<!DOCTYPE html>\n<html>\n<head>\n{head}\n</head><body>made up</body></html>\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save_calibration(calibration(), tmp_path / "unit-7.json")
    return tmp_path / "unit-7.json"


@pytest.fixture
def content(path: Path) -> bytes:
    return path.read_bytes()


@pytest.fixture
def files(path: Path) -> ReadCalibrationFiles:
    return ReadCalibrationFiles(path, load_calibration(path).file)


def checksum_of(path: Path) -> str:
    file = load_calibration(path).file
    return file.checksum


async def why_no_report(files: ReadCalibrationFiles) -> str:
    with pytest.raises(NoReportError) as seen:
        await files.check_report()
    with pytest.raises(NoReportError) as read:
        await files.report()
    assert str(seen.value) == str(read.value)
    return str(seen.value)


async def test_both_are_given_as_they_lie(files: ReadCalibrationFiles, path: Path, content: bytes) -> None:
    page = page_of(checksum_of(path))
    path.with_suffix(".html").write_text(page)
    assert await files.calibration() == content
    await files.check_report()
    assert await files.report() == page.encode()


async def test_a_file_that_was_replaced_since_is_not_given(files: ReadCalibrationFiles, path: Path) -> None:
    save_calibration(calibration(target("front"), target("rear", 0.3)), path)
    with pytest.raises(NoCalibrationFileError, match="not the one that the unit has loaded"):
        await files.calibration()
    os.unlink(path)  # noqa: PTH108  asynchronous tests may not use pathlib's own
    with pytest.raises(NoCalibrationFileError, match="No such file"):
        await files.calibration()


async def test_a_report_on_another_calibration_is_not_shown_as_its_own(
    files: ReadCalibrationFiles, path: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.json"
    save_calibration(calibration(target("front"), target("rear", 0.3)), other)
    path.with_suffix(".html").write_text(page_of(checksum_of(other)))
    assert "is the report of another calibration" in await why_no_report(files)


async def test_why_there_is_no_report_is_said(files: ReadCalibrationFiles, path: Path) -> None:
    page = path.with_suffix(".html")
    assert "unit-7.html next to the calibration: No such file" in await why_no_report(files)
    page.write_text("<!DOCTYPE html><title>some page</title>")
    assert "does not name its calibration" in await why_no_report(files)
    page.unlink()
    page.symlink_to("/etc/passwd")
    assert "does not name its calibration" in await why_no_report(files)
    page.unlink()
    page.mkdir()
    assert "is a folder, not a file" in await why_no_report(files)
    page.rmdir()
    os.mkfifo(page)
    assert "is a pipe, not a file" in await why_no_report(files)
    page.unlink()
    with page.open("w") as file:
        file.write(page_of(checksum_of(path)))
        file.truncate(calibration_files.MAX_REPORT_BYTES + 1)
    with pytest.raises(NoReportError, match="bytes long, more than"):
        await files.report()


async def test_a_calibration_that_was_not_read_from_a_file_has_none(path: Path) -> None:
    files = ReadCalibrationFiles(path, None)
    path.with_suffix(".html").write_text(page_of(checksum_of(path)))
    with pytest.raises(NoCalibrationFileError):
        await files.calibration()
    assert "another calibration" in await why_no_report(files)


async def test_a_disk_that_does_not_answer_is_given_up(
    files: ReadCalibrationFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = asyncio.Event()
    loop = asyncio.get_running_loop()

    def stuck(*_: object) -> bytes:
        asyncio.run_coroutine_threadsafe(read.wait(), loop).result(20)
        return b""

    monkeypatch.setattr(calibration_files, "READ_TIMEOUT_S", 0.05)
    monkeypatch.setattr(calibration_files, "read_file", stuck)
    with pytest.raises(NoCalibrationFileError, match="the disk does not answer"):
        await files.calibration()
    with pytest.raises(NoReportError, match="the disk does not answer"):
        await files.check_report()
    read.set()
    monkeypatch.undo()


BOTH = ("front", "rear")
REPORT = {"report": {"available": False, "why": "none"}}


def test_it_says_what_stands_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "unit-7.json"
    save_calibration(calibration(), path)
    written = json.loads(path.read_text())
    told = summary_of(load_calibration(path), BOTH, path.name).as_object()
    assert told["unit"] == written["unit"]["serial"]
    assert told["created"] == written["created"] == "2026-11-20T08:15:30.000Z"
    assert told["recording"] == written["recording"]
    assert (told["file"]["name"], told["file"]["checksum"]) == ("unit-7.json", written["checksum"])
    for shown, of in zip(told["targets"], written["targets"], strict=True):
        assert shown["residuals"] == pytest.approx(of["residuals"], rel=1e-3)
        assert shown["repeatability_px"] == pytest.approx(of["repeatability_px"], rel=1e-3)
        assert shown["cross_check"]["bound_px"] == of["cross_check"]["bound_px"]
        assert (shown["leds"], shown["width"], shown["height"]) == (len(of["leds_px"]), 752, 480)
        assert (shown["flat"], shown["fingerprint"], shown["simulated"]) == (None, None, False)
    CalibrationSummary.model_validate({**told, **REPORT})
    read = checked(CalibrationDocument, {**told, **REPORT})
    assert [target.model_dump(mode="json") for target in read.targets] == told["targets"]


def expected_sigma() -> dict[str, float]:
    """Straight maps: an angle is known better by 1 + slope², and the beams have the slopes of the range."""
    one_mm = math.sqrt(0.03**2 + 0.01**2 + 0.02**2 / 20) / PX_PER_MM
    slopes = np.array([(b[1].x_mm - b[0].x_mm, b[1].y_mm - b[0].y_mm) for b in beams_of(calibration())])
    share = np.sqrt(np.mean((1 + np.square(slopes / DISTANCE_MM)) ** -2.0, axis=0))
    yaw_deg, pitch_deg = (math.degrees(math.sqrt(2) * one_mm / DISTANCE_MM) * share).tolist()
    return {"x_mm": one_mm, "y_mm": one_mm, "yaw_deg": yaw_deg, "pitch_deg": pitch_deg}


def test_the_expected_sigma_of_straight_maps_is_the_closed_form() -> None:
    """0.03 px of pattern, 0.01 px of a common shift, 0.02 px of scatter of one exposure: all independent."""
    told = summary_of(calibration(), BOTH, "cal.json").as_object()
    assert told["exposures"] == 20
    assert told["expected_sigma"] == pytest.approx(expected_sigma(), rel=1e-3)


def test_report_api_and_console_show_one_hash_one_sigma_and_one_valid_area(tmp_path: Path) -> None:
    """The hash is that of the bytes; 12.5 mm around nodes on 125 x 100 mm is valid.

    The page shows what the API has, sigma with four decimals and the area with one.
    """
    targets = [replace(target(name), map=replace(target(name).map, margin_mm=12.5)) for name in BOTH]
    made, path = calibration(*targets), tmp_path / "unit-7.json"
    save_calibration(made, path)
    file_sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    seen = (evidence("front"), evidence("rear", seed=2))
    header_of_scan = RecordingHeader.model_validate(header("scan"))
    report = repr(report_on(Source(made, seen, {}, "altd calibrate", (header_of_scan,))))

    loaded = load_calibration(path)
    figures = summary_of(loaded, BOTH, path.name)
    told = figures.as_object()
    published = unit_that_shows(None)
    published.calibration, published.calibration_files = figures, ReadCalibrationFiles(path, loaded.file)
    settings = tmp_path / "altd.toml"
    settings.write_text(played_toml(path, tmp_path))
    published.targets = target_areas_of(load_settings(settings), loaded)
    console = Console(published).feed(b"calibration\r").decode()

    assert told["file"]["sha256"] == file_sha256
    assert f"('SHA-256 of the calibration file', '{file_sha256}')" in report
    assert file_sha256 in console

    expected = expected_sigma()
    x, yaw = (f"{expected[key]:.4f}" for key in ("x_mm", "yaw_deg"))
    assert [f"{told['expected_sigma'][key]:.4f}" for key in ("x_mm", "yaw_deg")] == [x, yaw]
    combined = "Combined standard uncertainty of a measurement of 20 exposures: "
    assert f"{combined}{float(yaw):.4f}° in yaw" in report
    assert f"{x} mm in x" in report
    for part in ("sigma of 20 exposures:", f"x {x} mm", f"yaw {yaw} deg"):
        assert part in console.replace("\r\n             ", " ")

    for shown in told["targets"]:
        assert (shown["x_mm"], shown["y_mm"]) == ([-75.0, 75.0], [-62.5, 62.5])
    for text in (report, console):
        assert text.count("valid within x -75.0 to 75.0, y -62.5 to 62.5 mm") == 2


def test_targets_without_a_common_area_have_no_expected_sigma() -> None:
    rear = target("rear")
    aside = replace(rear.map, hull_mm=rear.map.hull_mm + np.array([0.0, 200.0]))
    told = summary_of(calibration(target("front"), replace(rear, map=aside)), BOTH, "cal.json").as_object()
    assert told["expected_sigma"] == {}


def test_what_was_simulated_says_so_and_only_the_units_targets_are_told() -> None:
    made = calibration(target("front"), replace(target("rear"), origin=Origin.SIMULATED))
    told = summary_of(made, ("front",), "cal.json").as_object()
    assert told["simulated"] is True
    assert [(each["name"], each["simulated"]) for each in told["targets"]] == [("front", False)]


def test_texts_of_a_foreign_file_stay_short_and_are_json() -> None:
    evil = "<img src=x onerror=alert(1)>\ud800\x1b[2J\u202e" + "A" * 5_000_000
    camera = CameraIdentity(evil, evil, evil)
    made = replace(
        calibration(replace(target("front"), camera=camera)),
        unit_serial=evil,
        recording_note=evil,
        recording_sha256=evil,
    )
    told = summary_of(made, ("front",), evil).as_object()
    text = json.dumps(told, ensure_ascii=False, allow_nan=False).encode("utf-8")
    assert len(text) < 20 * MAX_TEXT_CHARACTERS
    assert told["recording"]["note"].startswith("<img src=x onerror=alert(1)>\\ud800\\x1b[2J\\u202eAAA")


def test_a_number_that_is_none_is_null() -> None:
    broken = replace(target("front"), residual_mean_mm=math.nan, leave_one_out_px=math.inf)
    (told,) = summary_of(calibration(broken), ("front",), "cal.json").as_object()["targets"]
    assert (told["residuals"]["mean_mm"], told["left_out_px"]) == (None, None)
