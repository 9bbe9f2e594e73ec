"""The loaded calibration over HTTP: shown to everybody, its files with the right to see pictures."""

import asyncio
from pathlib import Path

import pytest
from support.evidence import calibration

from altd.app.calibration_summary import summary_of
from altd.credentials.file import change
from altd.credentials.hashes import new_token, token_digest
from altd.publish.http.recordings import MAX_DOWNLOADS
from altd.status.unit import PublishedUnit

from .calibration_files import FILE, PAGE, Files
from .conftest import DOCUMENT, Served, Unit, fits

PATHS = ("/api/v1/calibration/file", "/api/v1/calibration/report")


@pytest.fixture
def files(published: PublishedUnit) -> Files:
    files = Files()
    published.calibration, published.calibration_files = (
        summary_of(calibration(), ("front", "rear"), "cal.json"),
        files,
    )
    return files


async def test_everybody_is_told_what_it_says(unit: Unit, files: Files, published: PublishedUnit) -> None:
    told = fits(DOCUMENT, "/api/v1/calibration", await unit.ask("/api/v1/calibration"))
    assert published.calibration is not None
    assert told == {**published.calibration.as_object(), "report": {"available": True, "why": ""}}
    files.no_report = "unit-7.html next to the calibration is the report of another calibration"
    told = fits(DOCUMENT, "/api/v1/calibration", await unit.ask("/api/v1/calibration"))
    assert told["report"] == {"available": False, "why": files.no_report}
    assert told["recording"]["note"] == "made up <by> a test & 5 $"


async def test_the_file_is_saved_under_a_name_that_no_header_breaks(unit: Unit, files: Files) -> None:
    answer = await unit.ask("/api/v1/calibration/file")
    assert fits(DOCUMENT, "/api/v1/calibration/file", answer) == {"format": "altd-calibration/1"}
    assert answer.body == FILE
    assert answer.headers["content-disposition"] == 'attachment; filename="unit_7__X__y.json"'
    assert answer.headers["content-length"] == str(len(FILE))
    files.refuses = "the file is not the one that the unit has loaded"
    answer = await unit.ask("/api/v1/calibration/file")
    assert (answer.status, answer.json) == (409, {"error": files.refuses})


async def test_a_report_may_do_nothing_in_the_pages_name(unit: Unit, files: Files) -> None:
    """A browser is shown that in ``tests/system/publish/test_unit_view_in_a_browser.py``."""
    answer = await unit.ask("/api/v1/calibration/report")
    assert (answer.status, answer.body) == (200, PAGE)
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    policy = [part.strip() for part in answer.headers["content-security-policy"].split(";")]
    assert {"sandbox", "default-src 'none'", "frame-ancestors 'none'"} <= set(policy)
    assert not any("script" in part or "allow-" in part for part in policy)
    assert answer.headers["x-content-type-options"] == "nosniff"
    files.no_report = "there is none"
    answer = await unit.ask("/api/v1/calibration/report")
    assert (answer.status, answer.json) == (404, {"error": "there is none"})


@pytest.mark.parametrize("path", [*PATHS, "/api/v1/diagnostics"])
async def test_the_files_hold_pictures_and_are_for_who_may_see_them(
    served: Served, files: Files, tmp_path: Path, path: str
) -> None:
    token = new_token()
    change(tmp_path / "known", "press", lambda known: known.with_token("press", token_digest(token)))
    async with served(credentials=tmp_path / "known") as unit:
        assert (await unit.ask("/api/v1/calibration")).status == 200
        assert (await unit.ask(path)).status == 401
        assert (await unit.ask(path, headers={"Authorization": "Bearer wrong"})).status == 401
        assert (await unit.ask(path, headers={"Authorization": f"Bearer {token}"})).status == 200


async def test_few_are_given_at_a_time(unit: Unit, files: Files) -> None:
    files.goes_on.clear()
    waiting = [asyncio.create_task(unit.ask(PATHS[0])) for _ in range(MAX_DOWNLOADS)]
    await unit.until(lambda: files.asked == MAX_DOWNLOADS)
    for path in (*PATHS, "/api/v1/diagnostics"):
        answer = await unit.ask(path)
        assert (answer.status, answer.json) == (503, {"error": "2 downloads are under way already"})
    assert (await unit.ask("/api/v1/calibration")).status == 200
    files.goes_on.set()
    assert [(await each).status for each in waiting] == [200] * MAX_DOWNLOADS
    assert (await unit.ask(PATHS[0])).status == 200


@pytest.mark.parametrize("path", ["/api/v1/calibration", *PATHS])
async def test_a_unit_without_one_says_so(unit: Unit, path: str) -> None:
    answer = await unit.ask(path)
    assert (answer.status, answer.json) == (503, {"error": "there is no calibration"})
