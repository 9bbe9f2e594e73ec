"""Recordings over HTTP: listed for everybody, kept and marked with the right to act, fetched as archives."""

import asyncio
import io
import json
import subprocess
import tarfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from unit.publish.http.conftest import Answer, Served, Unit

from altd.publish.http.recordings import MAX_DOWNLOADS
from altd.status.services import KeptRecording, NotKeptError
from altd.status.unit import PublishedUnit

NAME = "20261120T012345Z-spot_missing-front"
KEPT = KeptRecording(
    name=NAME,
    why="spot_missing front",
    start="2026-11-20T01:23:45.000Z",
    seconds=12.0,
    exposures=240,
    bytes=50_000_000,
    marked=False,
)
FILES = "empty", "front/000000.png", "recording.json"
ACT = "X-Altd-Request: test\r\n"


class Keeper:
    """Keeps one recording, whose files a test makes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.asked: list[str] = []
        self.refuses = ""
        self.hangs_at = ""
        self.recordings: Sequence[KeptRecording] = (KEPT,)

    async def keep(self, why: str) -> KeptRecording:
        self._check()
        self.asked.append(why)
        return KEPT.model_copy(update={"why": why})

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        self._check()
        self.recordings = (KEPT.model_copy(update={"marked": is_marked}),)
        return self.recordings[0]

    async def files(self, name: str) -> Sequence[str]:
        self._check()
        return FILES

    async def content(self, name: str, file: str) -> bytes | None:
        if file == self.hangs_at:
            raise NotKeptError("the disk does not answer")
        path = self.folder / name / file
        return path.read_bytes() if path.exists() else None

    def _check(self) -> None:
        if self.refuses:
            raise NotKeptError(self.refuses)


@pytest.fixture
def keeper(tmp_path: Path, published: PublishedUnit) -> Keeper:
    folder = tmp_path / NAME
    (folder / "front").mkdir(parents=True)
    (folder / "recording.json").write_text('{"format": "altd-recording/1"}\n')
    (folder / "front" / "000000.png").write_bytes(bytes(range(256)) * 3000)
    (folder / "empty").touch()
    keeper = Keeper(tmp_path)
    published.recordings.open(keeper)
    return keeper


async def asked(unit: Unit, method: str, path: str, headers: str = "") -> Answer:
    request = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n"
    return Answer.of(await unit.send(request.encode()))


async def test_what_there_is_is_told_to_everybody(unit: Unit, keeper: Keeper) -> None:
    answer = await asked(unit, "GET", "/api/v1/recordings")
    assert answer.json == {"unavailable": "", "recordings": [KEPT.as_object()]}


async def test_a_unit_that_keeps_none_says_why(unit: Unit) -> None:
    answer = await asked(unit, "GET", "/api/v1/recordings")
    assert answer.json == {"unavailable": "this unit keeps no frames", "recordings": []}
    answer = await asked(unit, "POST", "/api/v1/recordings", ACT)
    assert (answer.status, answer.json) == (409, {"error": "this unit keeps no frames"})
    assert (await asked(unit, "POST", "/api/v1/recordings")).status == 403, "no permission, no reason"


async def test_who_may_act_keeps_the_last_seconds(unit: Unit, keeper: Keeper) -> None:
    answer = await asked(unit, "POST", "/api/v1/recordings", ACT)
    assert (answer.status, answer.headers["location"]) == (201, f"recordings/{answer.json['name']}")
    assert keeper.asked == ["asked by http 127.0.0.1"]
    assert answer.json["why"] == "asked by http 127.0.0.1"
    assert (await asked(unit, "POST", "/api/v1/recordings")).status == 403
    assert len(keeper.asked) == 1
    keeper.refuses = "the disk is nearly full"
    answer = await asked(unit, "POST", "/api/v1/recordings", ACT)
    assert (answer.status, answer.json) == (409, {"error": "the disk is nearly full"})


async def test_a_recording_is_marked_and_its_mark_taken_away(unit: Unit, keeper: Keeper) -> None:
    path = f"/api/v1/recordings/{NAME}/mark"
    assert (await asked(unit, "PUT", path, ACT)).json["marked"] is True
    assert (await asked(unit, "DELETE", path, ACT)).json["marked"] is False
    assert (await asked(unit, "PUT", path)).status == 403
    assert (await asked(unit, "PUT", "/api/v1/recordings/other/mark", ACT)).status == 404
    assert (await asked(unit, "GET", path)).status == 405


async def test_a_foreign_tar_unpacks_what_is_fetched(served: Served, keeper: Keeper, tmp_path: Path) -> None:
    async with served() as unit:
        answer = await asked(unit, "GET", f"/api/v1/recordings/{NAME}", "Connection: close\r\n")
    assert answer.status == 200
    assert answer.headers["content-type"] == "application/x-tar"
    assert answer.headers["content-disposition"] == f'attachment; filename="{NAME}.tar"'
    (tmp_path / "got.tar").write_bytes(unchunked(answer))
    (tmp_path / "out").mkdir()
    command = ["tar", "-xvf", str(tmp_path / "got.tar"), "-C", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: ASYNC221  nothing is served
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(done.stdout.split()) == [f"{NAME}/{name}" for name in FILES]
    for name in FILES:
        assert (tmp_path / "out" / NAME / name).read_bytes() == (tmp_path / NAME / name).read_bytes()


def unchunked(answer: Answer) -> bytes:
    """The body (RFC 9112, 7.1)."""
    if answer.headers.get("transfer-encoding") != "chunked":
        return answer.body
    rest, found = answer.body, b""
    while True:
        size, _, rest = rest.partition(b"\r\n")
        if not int(size, 16):
            return found
        found, rest = found + rest[: int(size, 16)], rest[int(size, 16) + 2 :]


@pytest.mark.parametrize(
    "name", ["nothing", "..", "%2e%2e", "..%2fx", f"{NAME}%00", f"{NAME}/front", "a" * 500]
)
async def test_no_other_file_is_given(unit: Unit, keeper: Keeper, name: str) -> None:
    assert (await asked(unit, "GET", f"/api/v1/recordings/{name}")).status == 404


async def test_a_file_that_is_gone_is_left_out(unit: Unit, keeper: Keeper, tmp_path: Path) -> None:
    (tmp_path / NAME / "front" / "000000.png").unlink()
    names = _names(await asked(unit, "GET", f"/api/v1/recordings/{NAME}", "Connection: close\r\n"))
    assert names == [f"{NAME}/empty", f"{NAME}/recording.json"]


async def test_what_a_disk_that_hangs_gives_is_no_recording(unit: Unit, keeper: Keeper) -> None:
    keeper.hangs_at = "front/000000.png"
    answer = await asked(unit, "GET", f"/api/v1/recordings/{NAME}", "Connection: close\r\n")
    assert _names(answer) == [f"{NAME}/empty"]
    keeper.refuses = "the disk does not answer"
    refused = await asked(unit, "GET", f"/api/v1/recordings/{NAME}")
    assert (refused.status, json.loads(refused.body)) == (409, {"error": keeper.refuses})


def _names(answer: Answer) -> list[str]:
    with tarfile.open(fileobj=io.BytesIO(unchunked(answer))) as archive:
        return archive.getnames()


async def test_few_are_fetched_at_a_time(unit: Unit, keeper: Keeper, tmp_path: Path) -> None:
    (tmp_path / NAME / "front" / "000000.png").write_bytes(bytes(8 << 20))
    slow = [await unit.connect() for _ in range(MAX_DOWNLOADS)]
    for reader, writer in slow:
        writer.write(f"GET /api/v1/recordings/{NAME} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert (await asyncio.wait_for(reader.readline(), 60)).startswith(b"HTTP/1.1 200")
    answer = await asked(unit, "GET", f"/api/v1/recordings/{NAME}")
    assert (answer.status, answer.json) == (503, {"error": "2 downloads are under way already"})
    for _, writer in slow:
        writer.close()
    for _ in range(100):
        if (await asked(unit, "HEAD", f"/api/v1/recordings/{NAME}")).status == 200:
            answer = await asked(unit, "GET", f"/api/v1/recordings/{NAME}")
            if answer.status == 200:
                break
        await asyncio.sleep(0.02)
    assert answer.status == 200
