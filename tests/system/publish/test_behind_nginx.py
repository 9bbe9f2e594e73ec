"""A unit behind a plain nginx, at a prefix: its page is whole, and its stream is not held back."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import time
import urllib.request
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.foreign import need_program
from support.ports import free_port
from support.serving import serving

from altd.config import HttpSettings
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.answers import page_files
from altd.publish.http.publisher import HttpPublisher
from altd.runtime.clock import SystemClock
from altd.status.board import Board
from altd.status.health import Health
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit
from tools.pages.example import MEASURED

CONFIG = """
daemon off; pid {folder}/pid; error_log {folder}/log; events {{}}
http {{ access_log off;
  client_body_temp_path {folder}/b; proxy_temp_path {folder}/p; fastcgi_temp_path {folder}/f;
  uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
  server {{ listen 127.0.0.1:{port}; location /unit7/ {{ proxy_pass http://127.0.0.1:{unit}/; }} }} }}
"""


@pytest.fixture
async def proxied(tmp_path: Path) -> AsyncIterator[tuple[Board, str]]:
    """The unit's board, and its address at the proxy."""
    nginx, port, clock = need_program("nginx", "nginx-light"), free_port(), SystemClock()
    health, board = Health(clock), Board(clock, 10.0, QUANTITIES)
    published = PublishedUnit(board, health, state=UnitState(board, health, clock).read)
    publisher = HttpPublisher(HttpSettings(host="127.0.0.1", port=0), published, health.component("http"))
    async with serving(publisher):
        config = tmp_path / "nginx.conf"
        config.write_text(CONFIG.format(folder=tmp_path, port=port, unit=publisher.port))
        command = nginx, "-e", str(tmp_path / "log"), "-c", str(config)
        process = await asyncio.create_subprocess_exec(*command)
        try:
            async with asyncio.timeout(20):
                while True:
                    with contextlib.suppress(OSError):
                        (await asyncio.open_connection("127.0.0.1", port))[1].close()
                        break
                    await asyncio.sleep(0.01)
            yield board, f"http://127.0.0.1:{port}/unit7/"
        finally:
            process.terminate()
            await process.wait()


def got(url: str) -> str:
    with urllib.request.urlopen(url, timeout=20) as answer:
        return answer.read().decode()


async def test_all_that_the_page_names_is_below_the_prefix(proxied: tuple[Board, str]) -> None:
    board, url = proxied
    board.publish(MEASURED)
    page = await asyncio.to_thread(got, url)
    for link in re.findall(r'(?:href|src)="([^":]+)"', page):
        await asyncio.to_thread(got, url + link)
    for name, file in page_files().items():
        assert not re.search(r"""["'`(]/(api|page|metrics)\b""", file.content.decode()), name
    api = await asyncio.to_thread(got, f"{url}api/v1/")
    assert "../../api/v1/measurement" in api
    assert not re.search(r'href="/', api)


async def test_every_event_of_the_stream_comes_when_it_is_sent(proxied: tuple[Board, str]) -> None:
    board, url = proxied
    port, path = re.fullmatch(r"http://127\.0\.0\.1:(\d+)(.*)", url).groups()
    reader, writer = await asyncio.open_connection("127.0.0.1", int(port))
    writer.write(f"GET {path}api/v1/stream HTTP/1.0\r\n\r\n".encode())
    delays_s = []
    async with asyncio.timeout(60):
        for sequence in range(12):
            now_ns = time.monotonic_ns()
            board.publish(replace(MEASURED, sequence=sequence, t_ns=now_ns, last_exposure_ns=now_ns))
            while not (line := await reader.readline()).startswith(b"data: "):
                assert line
            assert json.loads(line[6:])["sequence"] == sequence
            delays_s.append((time.monotonic_ns() - now_ns) * 1e-9)
    writer.close()
    assert sorted(delays_s)[6] < 0.2, delays_s
