"""The OpenAPI document drives a served unit: schemathesis asks for what it promises, and for other things."""

import asyncio
import json
import re
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from support.evidence import calibration
from support.history import START_S, batch, event, sample, store
from support.measurements import measurement
from support.serving import serving
from support.status_fixtures import checked

from altd.app.calibration_files import ReadCalibrationFiles
from altd.app.calibration_summary import summary_of
from altd.calibration.file import load_calibration, save_calibration
from altd.config import HttpSettings
from altd.credentials.file import change
from altd.credentials.hashes import new_token, token_digest
from altd.history.history import History
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http import guard
from altd.publish.http.openapi import document_of
from altd.publish.http.paths import PATHS
from altd.publish.http.publisher import HttpPublisher
from altd.status.board import Board
from altd.status.health import Health
from altd.status.unit import PublishedUnit
from altd.tcp_port import Rate

SCHEMATHESIS = (sys.executable, "-m", "schemathesis.cli", "run", "--no-color", "--checks", "all")
OPTIONS = ("--max-examples", "20", "--request-timeout", "5", "--generation-deterministic")
NO_END = ("--exclude-path", "/api/v1/stream")
"""The stream never ends: ``tests/unit/publish/http/test_stream.py`` reads it."""


DOWNLOADS = ("/api/v1/calibration/file", "/api/v1/calibration/report", "/api/v1/diagnostics")


@pytest.fixture
def token() -> str:
    return new_token()


@pytest.fixture
async def port(
    board: Board,
    health: Health,
    published: PublishedUnit,
    tmp_path: Path,
    token: str,
    monkeypatch: pytest.MonkeyPatch,
) -> AsyncIterator[int]:
    """That of a unit which measures, checks itself, and asks for a token, as often as it is guessed."""
    for name in ("ATTEMPTS", "ALL_ATTEMPTS"):
        monkeypatch.setattr(guard, name, Rate(burst=10**6, per_s=1e6))
    board.publish(measurement())
    service = published.self_check
    report = checked(1)
    service.open(lambda: asyncio.get_running_loop().call_soon(service.publish, report) and None)
    digest = token_digest(token)
    change(tmp_path / "credentials", "press", lambda known: known.with_token("press", digest))
    settings = HttpSettings(host="127.0.0.1", port=0, credentials=tmp_path / "credentials")
    save_calibration(calibration(), tmp_path / "cal.json")
    loaded = load_calibration(tmp_path / "cal.json")
    files = ReadCalibrationFiles(tmp_path / "cal.json", loaded.file)
    published.calibration, published.calibration_files = (
        summary_of(loaded, loaded.target_names, "cal.json"),
        files,
    )
    kept = store(tmp_path)
    kept.write(batch(START_S + 61, [sample(START_S + t, 0.1 * t, t) for t in range(60)], [event(1, START_S)]))
    kept.end(None)
    history = History(tmp_path / "history.db")
    publisher = HttpPublisher(settings, published, health.component("http"), history)
    async with serving(publisher):
        yield publisher.port
    await history.end()


async def tried(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    line = [*SCHEMATHESIS, *OPTIONS, *arguments]
    return await asyncio.to_thread(
        subprocess.run, line, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


async def test_the_unit_answers_as_its_document_says(port: int, tmp_path: Path) -> None:
    done = await tried(*NO_END, f"http://127.0.0.1:{port}/api/v1/openapi.json", folder=tmp_path)
    assert done.returncode == 0, done.stdout[-5000:]
    assert re.search(r"(\d+) generated, \1 passed", done.stdout), done.stdout[-3000:]
    count = sum(len(path.operations) + ("GET" in path.operations) for path in PATHS if not path.is_old)
    # all but the stream, which has GET and HEAD, and the document that it has read already
    assert f"Tested: {count - 3}" in done.stdout


async def test_who_shows_the_token_is_given_what_the_document_says(
    port: int, token: str, tmp_path: Path
) -> None:
    chosen = [part for path in DOWNLOADS for part in ("--include-path", path)]
    shown = ("-H", f"Authorization: Bearer {token}")
    done = await tried(*chosen, *shown, f"http://127.0.0.1:{port}/api/v1/openapi.json", folder=tmp_path)
    assert done.returncode == 0, done.stdout[-5000:]
    assert re.search(r"(\d+) generated, \1 passed", done.stdout), done.stdout[-3000:]
    assert "Authentication failed" not in done.stdout


async def test_a_document_that_is_not_true_is_found_out(port: int, tmp_path: Path) -> None:
    document = document_of(PATHS, QUANTITIES, "0.1.0")
    document["components"]["schemas"]["Alive"]["properties"]["alive"]["const"] = False
    (tmp_path / "wrong.json").write_text(json.dumps(document))
    url = f"http://127.0.0.1:{port}"
    done = await tried("--include-path", "/healthz", "--url", url, "wrong.json", folder=tmp_path)
    assert done.returncode == 1, done.stdout[-5000:]
