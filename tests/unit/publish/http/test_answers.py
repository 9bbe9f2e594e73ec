"""Answers of each path, over real sockets, and the page in docs that lists them."""

import asyncio
import gzip
import hashlib
import html
import json
import math
import re
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
from support.clock import FakeClock
from support.measurements import changed
from support.places import DOCS
from support.status_fixtures import checked

from altd.publish.http import answers
from altd.publish.http.answers import page_files
from altd.publish.http.paths import PATHS
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.conditions import Condition
from altd.status.health import Component, Health, State
from altd.status.measurement_json import PROOF_KEYS, as_object_now
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit
from tools.pages.http import page

from .conftest import NEED_MORE, Unit


async def test_the_measurement_is_the_object_of_replay_with_its_proof_behind(
    unit: Unit, board: Board, clock: FakeClock, measured: Measurement
) -> None:
    board.publish(measured)
    clock.now_ns += 520_000_000
    answer = await unit.ask("/api/measurement")
    again = await unit.ask("/api/measurement")
    assert answer.status == 200
    assert answer.body.startswith(
        json.dumps(as_object_now(measured, board.age_s())).removesuffix("}").encode() + b", "
    )
    assert list(answer.json) == [*as_object_now(measured, board.age_s()), *PROOF_KEYS]
    line, crc = answer.body.rsplit(b', "crc32": ', 1)
    assert crc == b'"%08X"}' % zlib.crc32(line)
    assert answer.json["unit"] == f"{zlib.crc32(b'ALT-0007'):08X}"
    assert (answer.json["message"], again.json["message"]) == (1, 2)
    assert answer.json["session"] == again.json["session"]
    assert (answer.json["published"], answer.json["age_s"], answer.json["clock_ms"]) == (1, 0.52, 520)


async def test_before_the_first_measurement_it_says_why_there_is_none(unit: Unit) -> None:
    answer = await unit.ask("/api/measurement")
    assert answer.status == 503
    assert answer.json["status"] == ["warming_up"]
    assert "nothing was measured" in answer.json["error"]


async def test_what_is_not_valid_is_an_answer_without_numbers(
    unit: Unit, board: Board, clock: FakeClock, measured: Measurement
) -> None:
    board.publish(changed(measured, None, status=(Fault(Reason.SPOT_MISSING, "front"),)))
    invalid = await unit.ask("/api/measurement")
    board.publish(measured)
    clock.now_ns += 1_100_000_000
    old = await unit.ask("/api/measurement")
    for answer, reason in ((invalid, "front_spot_missing"), (old, "stale")):
        assert (answer.status, answer.json["valid"], answer.json["x_mm"]) == (200, False, None)
        assert answer.json["status"] == [reason]


async def test_the_status_is_the_health_of_the_unit(unit: Unit, health: Health) -> None:
    health.component("camera front").set_state(State.FAILED, "no such device")
    answer = await unit.ask("/api/status")
    assert answer.status == 200
    assert answer.json["serial"] == "ALT-0007"
    assert answer.json["components"]["camera front"]["message"] == "no such device"
    assert answer.json["components"]["http"]["state"] == "ok"


async def test_the_status_tells_who_set_the_zero(
    unit: Unit, published: PublishedUnit, board: Board, measured: Measurement
) -> None:
    before = await unit.ask("/api/status")
    board.publish(measured)
    published.zero.set(board, "modbus 10.0.0.9")
    assert before.json["zero"] is None
    time = (await unit.ask("/api/measurement")).json["time"]
    zero = (await unit.ask("/api/status")).json["zero"]
    assert zero == {"count": 1, "by": "modbus 10.0.0.9", "time": time}


async def test_the_page_needs_nothing_from_elsewhere(unit: Unit) -> None:
    text = ""
    for path in ("/", "/screen"):
        answer = await unit.ask(path)
        text += answer.body.decode()
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "unsafe" not in policy
    assert "://" not in text
    named = set(re.findall(r'(?:src|href)="(page/[^"]*)"', text))
    for file in page_files().values():  # a script may load another one
        named.update(re.findall(r'src: "(page/[^"]*)"', file.content.decode()))
    scripts = {f"page/{name}" for name in page_files() if name.endswith(".js")}
    assert named == {"page/style.css", "page/screen.css", "page/vendor/uPlot.min.css", *scripts}
    for path in named:
        assert (await unit.ask(f"/{path}")).status == 200
    folder = Path(answers.__file__).with_name("page_files")  # served alone before there is a calibration
    screen = (folder / "screen.html").read_text(encoding="utf-8")
    beside = re.findall(r'(?:src|href)="([^":]*)"', screen)
    assert beside == ["screen.css", "screen.js"]
    assert all((folder / name).is_file() for name in beside)
    linked = set(re.findall(r'href="(api[^"]*)"', text))
    assert linked <= {path.path.removeprefix("/") for path in PATHS}


async def test_each_cause_is_explained_at_its_code_by_the_unit_itself(unit: Unit) -> None:
    answer = await unit.ask("/reasons")
    text = html.unescape(re.sub("</?code>", "`", answer.body.decode()))
    assert (
        answer.headers["content-security-policy"] == (await unit.ask("/")).headers["content-security-policy"]
    )
    assert set(re.findall(r'(?:src|href)="([^"]*)"', text)) == {
        "data:,",
        "page/style.css",
        "page/vendor/uPlot.min.css",
        "./",
    }
    entries = dict(re.findall(r'<li id="(\w+)" .*?>(.*)</li>', text))
    assert list(entries) == [
        *(each for each in Reason if not each.is_warning),
        *(each for each in Reason if each.is_warning),
        *Condition,
    ]
    for kind in (*Reason, *Condition):
        for words in (kind.brief, kind.remedy, kind.meaning):
            assert words in entries[kind]


async def test_every_file_of_the_page_is_served_as_what_it_is(unit: Unit) -> None:
    for name, file in page_files().items():
        answer = await unit.ask(f"/page/{name}")
        assert (answer.status, answer.body) == (200, file.content)
        kind = "text/javascript" if name.endswith(".js") else "text/css"
        assert answer.headers["content-type"] == f"{kind}; charset=utf-8"
        assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", ["/", "/reasons", "/page/main.js", "/api/v1/openapi.json"])
async def test_a_text_is_sent_as_gzip_to_who_accepts_it(unit: Unit, path: str) -> None:
    plain = await unit.ask(path)
    packed = await unit.ask(path, headers={"Accept-Encoding": "br, gzip;q=0.5"})
    head = await unit.ask(path, "HEAD", {"Accept-Encoding": "GZIP"})
    assert gzip.decompress(packed.body) == plain.body
    assert packed.headers["content-length"] == str(len(packed.body))
    assert len(packed.body) < 0.7 * len(plain.body)
    assert (head.body, head.headers) == (b"", {**packed.headers, "date": head.headers["date"]})
    assert head.headers["content-encoding"] == "gzip"
    for refused in ("br", "gzip;q=0", "identity, gzip; q=0.000", ""):
        answer = await unit.ask(path, headers={"Accept-Encoding": refused})
        assert (answer.body, answer.headers["vary"]) == (plain.body, "Accept-Encoding")


async def test_streams_and_small_answers_are_sent_as_they_are(unit: Unit) -> None:
    reader, writer = await unit.connect()
    writer.write(b"GET /api/stream HTTP/1.1\r\nHost: unit\r\nAccept-Encoding: gzip\r\n\r\n")
    assert b"retry: 2000" in await asyncio.wait_for(reader.readuntil(b"retry: 2000"), 60)
    writer.close()
    small = await unit.ask("/healthz", headers={"Accept-Encoding": "gzip"})
    assert small.json == {"alive": True}


NO_FILES = (
    "", "nothing.js", "index.html", "vendor/uPlot.LICENSE", "../answers.py", "..%2fanswers.py",
    "%2e%2e/answers.py", "/etc/passwd", "vendor", "main.js/", "main.js%00", "vendor/../main.js", "MAIN.JS",
)  # fmt: skip


@pytest.mark.parametrize("name", NO_FILES)
async def test_nothing_else_is_served_of_it(unit: Unit, name: str) -> None:
    assert (await unit.ask(f"/page/{name}")).status == 404


def test_vendored_files_are_those_of_their_releases() -> None:
    folder = Path(answers.__file__).with_name("page_files") / "vendor"
    listed = re.findall(r"^([0-9a-f]{64})  (\S+)$", (folder / "README.md").read_text(), re.M)
    assert {name for _, name in listed} == {path.name for path in folder.iterdir()} - {"README.md"}
    for digest, name in listed:
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/api/status/", 404),
        ("GET", "/../../etc/passwd", 404),
        ("GET", "/%00%ff", 404),
        ("POST", "/api/measurement", 405),
        ("DELETE", "/api/stream", 405),
        ("OPTIONS", "/api/status", 405),
        ("TRACE", "/api/status", 405),
        ("get", "/api/status", 405),
        ("PUT", "/page/main.js", 405),
    ],
)
async def test_refusals_are_json(unit: Unit, method: str, path: str, status: int) -> None:
    answer = await unit.ask(path, method)
    assert answer.status == status
    assert set(answer.json) == {"error"}
    assert ("GET" in answer.headers.get("allow", "")) is (status == 405)


async def test_a_misspelled_path_names_the_right_one(unit: Unit) -> None:
    answer = await unit.ask("/api/v1/measurements")
    assert answer.json["error"].startswith(
        "there is no /api/v1/measurements; did you mean `/api/v1/measurement`?"
    )


async def test_a_defect_is_answered_in_json_and_logged_as_one(
    unit: Unit, published: PublishedUnit, caplog: pytest.LogCaptureFixture
) -> None:
    """Such as a number that JSON does not have."""
    published.self_check.publish(replace(checked(1), exposures_lost=math.nan))
    answer = await unit.ask("/api/v1/self-check")
    assert (await unit.ask("/healthz")).status == 200
    assert (answer.status, answer.json) == (500, {"error": "a defect of the unit; its log has the details"})
    assert [(record.name, record.getMessage()) for record in caplog.records] == [("altd", "http: a defect")]
    assert caplog.records[0].exc_info is not None


@pytest.mark.parametrize(
    "path",
    [
        path.path
        for path in PATHS
        if "GET" in path.operations and path.path not in NEED_MORE and "{" not in path.path
    ],
)
async def test_head_has_the_headers_and_no_body(
    unit: Unit, board: Board, measured: Measurement, path: str
) -> None:
    board.publish(measured)
    answer = await unit.ask(path, "HEAD")
    assert (answer.status, answer.body) == (200, b"")


@pytest.mark.parametrize("path", ["/", "/api/measurement", "/api/status", "/nothing"])
async def test_no_answer_is_kept_by_caches_or_given_to_other_sites(unit: Unit, path: str) -> None:
    answer = await unit.ask(path)
    assert answer.headers["cache-control"] == "no-store"
    assert not any(name.startswith("access-control") for name in answer.headers)
    assert "server" not in answer.headers


async def test_only_a_measurement_is_data(
    unit: Unit, board: Board, measured: Measurement, component: Component
) -> None:
    for path in ("/", "/api/status", "/api/measurement"):
        await unit.ask(path)
    assert component.data_given == 0  # nothing has been measured yet
    board.publish(measured)
    await unit.ask("/api/measurement")
    assert component.data_given == 1


async def test_a_unit_is_ready_once_it_measures_even_without_a_beam(
    unit: Unit,
    board: Board,
    health: Health,
    published: PublishedUnit,
    clock: FakeClock,
    measured: Measurement,
) -> None:
    published.state = UnitState(board, health, clock).read
    starting = await unit.ask("/readyz")
    board.publish(changed(measured, None, status=(Fault(Reason.SPOT_MISSING, "front"),)))
    without_beam = await unit.ask("/readyz")
    board.publish(measured)
    measuring = await unit.ask("/readyz")
    clock.now_ns += 5_000_000_000
    stale, alive = await unit.ask("/readyz"), await unit.ask("/healthz")
    assert (alive.status, alive.json) == (200, {"alive": True})
    assert (starting.status, stale.status) == (503, 503)
    assert starting.json == {"error": "the unit starts"}
    assert stale.json == {"error": Reason.STALE.brief}
    assert without_beam.json == measuring.json == {"ready": True}


def test_the_page_is_generated_from_the_code() -> None:
    assert (DOCS / "http.md").read_text() == page(), "run: make pages"
