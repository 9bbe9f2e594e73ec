"""The calibration's file and its report are given as those that were loaded, or not at all."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from support.evidence import calibration, target

from altd.app import calibration_files
from altd.app.calibration_files import ReadCalibrationFiles
from altd.calibration.file import load_calibration, save_calibration
from altd.status.services import NoCalibrationFileError, NoReportError


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
async def files(path: Path) -> AsyncIterator[ReadCalibrationFiles]:
    made = ReadCalibrationFiles(path, load_calibration(path).file)
    yield made
    await made.end()


def checksum_of(path: Path) -> str:
    file = load_calibration(path).file
    assert file is not None
    return file.checksum


async def why_no_report(files: ReadCalibrationFiles) -> str:
    with pytest.raises(NoReportError) as seen:
        await files.check_report()
    with pytest.raises(NoReportError) as read:
        await files.report()
    assert str(seen.value) == str(read.value)
    return str(seen.value)


async def test_both_are_given_as_they_lie_there(
    files: ReadCalibrationFiles, path: Path, content: bytes
) -> None:
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
    await files.end()


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
