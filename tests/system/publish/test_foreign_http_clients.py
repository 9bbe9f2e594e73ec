"""curl and openssl at a unit with credentials and TLS as docs/http.md says; limits in an own network."""

import asyncio
import json
import re
import subprocess
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here
from support.foreign import need_program
from support.measurements import measurement
from support.places import DOCS
from support.serving import serving
from support.status_fixtures import checked

from altd.config import HttpSettings
from altd.publish.http.clients import REQUESTS
from altd.publish.http.publisher import HttpPublisher
from altd.status.board import Board
from altd.status.health import Health
from altd.status.unit import PublishedUnit


@asynccontextmanager
async def unit(board: Board, published: PublishedUnit, **settings: Any) -> AsyncIterator[int]:
    board.publish(measurement())
    settings = {"host": "127.0.0.1", "port": 0, **settings}
    publisher = HttpPublisher(HttpSettings(**settings), published, published.health.component("http"))
    async with serving(publisher):
        yield publisher.port


async def curl(*arguments: object) -> tuple[int, str]:
    """The status that curl got and what came; 0: no answer."""
    line = [need_program("curl"), "--silent", "--max-time", "5", "--noproxy", "*", "-w", "\n%{http_code}"]
    line += [str(argument) for argument in arguments]
    done = await asyncio.to_thread(subprocess.run, line, capture_output=True, text=True, check=False)
    body, _, status = done.stdout.rpartition("\n")
    return int(status), body


def certificate_as_documented(folder: Path) -> tuple[Path, Path]:
    """The files made by the commands in docs/http.md, run unchanged, in another folder."""
    page = (DOCS / "http.md").read_text()
    found = re.search(r"^    openssl req .*(?:\n      .*)*", page, re.MULTILINE)
    assert found is not None
    command = found[0].replace("/etc/altd/", f"{folder}/").replace("192.0.2.7", "127.0.0.1")
    subprocess.run(["sh", "-euc", command], check=True, capture_output=True)
    certificate, key = folder / "unit.pem", folder / "unit.key"
    key.chmod(0o640)
    return certificate, key


async def test_curl_acts_by_token_and_by_session_over_tls(
    board: Board, health: Health, published: PublishedUnit, tmp_path: Path
) -> None:
    certificate, key = certificate_as_documented(tmp_path)
    credentials, jar = tmp_path / "credentials", tmp_path / "jar"
    assert altd_here("password", credentials, "ana", stdin="open sesame\n").status == 0
    token = altd_here("token", credentials, "press").out.strip()
    desk = published.self_check
    report = checked(1)
    desk.open(lambda: asyncio.get_running_loop().call_soon(desk.publish, report) and None)
    ours = ("--cacert", certificate, "-H", "X-Altd-Request: 1")
    login = json.dumps({"name": "ana", "password": "open sesame"})
    async with unit(board, published, certificate=certificate, key=key, credentials=credentials) as port:
        url = f"https://127.0.0.1:{port}/api/v1"
        assert (await curl(f"{url}/status"))[0] == 0, "nobody trusts a certificate that he was not given"
        assert (await curl(f"http://127.0.0.1:{port}/"))[0] == 0
        assert (await curl(*ours, f"{url}/measurement"))[0] == 200
        assert (await curl(*ours, "-X", "POST", f"{url}/self-check"))[0] == 401
        bearer = ("-H", f"Authorization: Bearer {token}")
        assert (await curl(*ours, *bearer, "-X", "POST", f"{url}/self-check"))[0] == 200
        body = ("-H", "Content-Type: application/json", "--data", login)
        assert (await curl(*ours, "--cookie-jar", jar, *body, f"{url}/login"))[0] == 200
        assert "#HttpOnly_127.0.0.1\tFALSE\t/\tTRUE" in jar.read_text()  # for TLS alone, for no script
        status, said = await curl(*ours, "--cookie", jar, f"{url}/session")
        assert (status, json.loads(said)["name"]) == (200, "ana")
        assert (await curl(*ours, "--cookie", jar, "-X", "POST", f"{url}/self-check"))[0] == 200
        line = [need_program("openssl"), "s_client", "-connect", f"127.0.0.1:{port}", "-brief"]
        line += ["-CAfile", str(certificate), "-verify_return_error", "-alpn", "h2,http/1.1"]
        done = await asyncio.to_thread(
            subprocess.run, line, input=b"", capture_output=True, check=False, timeout=20
        )
        assert b"Verification: OK" in done.stderr
        assert b"TLSv1.3" in done.stderr


@pytest.mark.own_network
async def test_an_address_asks_only_so_often_and_others_are_not_kept_off(
    board: Board, health: Health, published: PublishedUnit, clock: Any
) -> None:
    """From an address that is not the computer's loopback; time stands still, so that no token comes back."""
    await addresses("10.9.0.1/24", "10.9.0.2/24", "10.8.0.1/24")
    async with unit(board, published, host="0.0.0.0", allow=["10.9.0.0/24"]) as port:
        at = f"http://10.9.0.1:{port}/healthz"
        got = Counter[int]()
        for _ in range(4):
            many = [each for _ in range(REQUESTS.burst // 4 + 5) for each in ("-o", "/dev/null", at)]
            line = [
                need_program("curl"),
                "--silent",
                "--interface",
                "10.9.0.1",
                "-w",
                "%{http_code}\n",
                *many,
            ]
            done = await asyncio.to_thread(subprocess.run, line, capture_output=True, text=True, check=False)
            got.update(map(int, done.stdout.split()))
        assert got == {200: REQUESTS.burst, 429: 20}
        status, said = await curl("--interface", "10.9.0.1", "-i", at)
        assert (status, "retry-after: 1" in said.lower()) == (429, True)
        assert (await curl("--interface", "10.9.0.2", at))[0] == 200
        assert (await curl(f"http://127.0.0.1:{port}/healthz"))[0] == 200
        assert (await curl("--interface", "10.8.0.1", f"http://10.8.0.1:{port}/healthz"))[0] == 0
        assert health.component("http").counters["connections_not_allowed"] == 1


async def addresses(*each: str) -> None:
    for address in each:
        line = ["ip", "address", "add", address, "dev", "lo"]
        await asyncio.to_thread(subprocess.run, line, check=True)
