"""Hostile requests at the HTTP face beside a poller: ``python -m benchmarks.hostile_http --requests 100000``.

Requests that are nearly valid come from other processes, from the unit's own computer, where no limit of
requests keeps them off. Each answer is held against the contract; the poller must read the right number each
time.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import random
import re
import socket
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

from altd.config import HttpSettings
from altd.credentials.changing import change
from altd.credentials.hashes import PasswordHash
from altd.publish.http.publisher import HttpPublisher
from altd.runtime.clock import SystemClock
from altd.status.health import Health
from tools.pages.example import MEASURED, board

PROCESSES = 2
THREADS = 16
POLL_INTERVAL_S = 0.02
STATUSES = {200, 400, 401, 403, 404, 405, 408, 409, 413, 414, 415, 421, 429, 431, 503}

_ANSWER = re.compile(rb"HTTP/1\.1 (\d{3}) [A-Za-z -]*\r\n((?:[a-zA-Z-]+: [^\r\n]*\r\n)+)\r\n", re.DOTALL)
_BLANK_LINE = re.compile(rb"\n\r?\n")
_PATHS = (
    *("/", "/api/measurement", "/api/status", "/api/self-check", "/api/stream", "/healthz", "/readyz"),
    *("/metrics", "/api/v1/", "/api/v1/openapi.json", "/api/v1/measurement", "/api/v1/self-check"),
    *("/api/v1/session", "/api/v1/login", "/api/v1/logout", "/api/v1/stream", "/api/v1/pictures"),
    *("/api/v1/calibration", "/api/v1/calibration/file", "/api/v1/calibration/report"),
    "/api/v1/diagnostics",
    *("/api%2Fstatus", "/api/../etc/passwd", "http://unit/api/status", "*", "//evil/"),
    "/api/v1/status?" + "y=1&" * 50,
)
_HEADERS = (
    *("Authorization: Bearer guess", "Authorization: Basic YW5hOmE=", "Cookie: altd_80=x; =; altd_80=y"),
    *("Content-Length: 5", "Content-Length: 99999999999", "Content-Length: -1"),
    *("Transfer-Encoding: chunked", "Transfer-Encoding: xchunked, chunked", "Expect: 100-continue"),
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAA",
    *("Connection: keep-alive", "Origin: null", "Origin: http://evil.example", "X-Altd-Request: 1"),
    *("X-Forwarded-For: 127.0.0.1", "Forwarded: for=127.0.0.1;proto=https", "Host: evil.example"),
    *("Accept-Encoding: gzip;q=1e999", "Content-Type: application/json", "Host: [::1", "X: a\r\n b"),
    *("X:\tb", "Last-Event-ID: 5C1E90A7-1", "Range: bytes=0-"),
)
_BODIES = (
    *(b"", b"hello", b'{"name": "ana", "password": "x"}', b"5\r\nhello\r\n0\r\n\r\n"),
    *(b"ffffffff\r\nx", b"[" * 900),
)
_CONTINUE = (b"HTTP/1.1 100 \r\n\r\n", b"HTTP/1.1 100 Continue\r\n\r\n")


@dataclass
class Tally:
    """What came of a run. ``wrong`` are answers and readings that break the contract, in words."""

    statuses: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    polls: int = 0
    slowest_poll_s: float = 0.0
    seconds: float = 0.0


def request(chance: random.Random) -> bytes:
    """A request that is valid, or was spoilt in up to three places."""
    method = chance.choice(("GET",) * 5 + ("POST",) * 3 + ("HEAD", "OPTIONS", "PUT", "TRACE", "CONNECT"))
    headers = ["Host: unit", *chance.sample(_HEADERS, chance.randrange(4))]
    chance.shuffle(headers)
    version = chance.choice(("1.1",) * 8 + ("1.0", "2.0"))
    head = "\r\n".join([f"{method} {chance.choice(_PATHS)} HTTP/{version}", *headers])
    data = bytearray(head.encode() + b"\r\n\r\n" + chance.choice(_BODIES))
    for _ in range(max(chance.randrange(-3, 4), 0)):
        at = chance.randrange(len(data) + 1)
        end = min(at + chance.randrange(1, 12), len(data))
        how = chance.randrange(5)
        if how == 0 and at < len(data):
            data[at] ^= 1 << chance.randrange(8)
        elif how == 1:
            del data[at:end]
        elif how == 2:
            data[at:at] = data[at:end] * chance.choice((2, 50, 2000))
        elif how == 3:
            data[at:at] = chance.choice((b"\r\n", b"\x00", b"\n\n", b"%00", b"\xff", b": ", b" ", b"\r"))
        else:
            data[at:end] = chance.randbytes(end - at)
    return bytes(data)


def complaint(answer: bytes) -> str:
    """What is wrong with an answer; empty: nothing, or it is none."""
    if not answer:
        return ""
    for interim in _CONTINUE:
        answer = answer.removeprefix(interim)
    if not answer:
        return ""
    found = _ANSWER.match(answer)
    if found is None:
        return f"no answer in HTTP: {answer[:80]!r}"
    status, body = int(found[1]), answer[found.end() :]
    if status not in STATUSES:
        return f"status {status}"
    is_json = b"content-type: application/json" in found[2].lower()
    if status >= 400 and body:
        try:
            shape = set(json.loads(body)) if is_json else set()
        except ValueError:
            return f"an error that is no JSON: {body[:80]!r}"
        if "error" not in shape or shape - {"error", "status"}:
            return f"an error of another shape: {body[:80]!r}"
    if b"Traceback" in answer or (b"set-cookie: altd" in found[2].lower() and b"Max-Age=0" not in found[2]):
        return f"a traceback or a session: {answer[:200]!r}"
    return ""


def attack(port: int, requests: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Send requests from some threads; returns the statuses of the answers and what was wrong with them."""
    statuses, wrong, lock = Counter[str](), list[str](), threading.Lock()

    def send(number: int) -> None:
        chance = random.Random(seed * THREADS + number)
        mine = Counter[str]()
        for _ in range(requests // THREADS):
            sent = request(chance)
            answer = _exchange(port, sent)
            mine[answer[9:12].decode("latin-1") or "closed"] += 1
            if why := complaint(answer):
                with lock:
                    wrong.append(f"{why}; sent {sent[:300]!r}")
        with lock:
            statuses.update(mine)

    threads = [threading.Thread(target=send, args=(number,)) for number in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return statuses, wrong[:20]


def _exchange(port: int, sent: bytes) -> bytes:
    """What comes back; whoever waits for more than was sent gets no more."""
    heard = b""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
            connection.sendall(sent)
            if _BLANK_LINE.search(sent) is None:
                connection.shutdown(socket.SHUT_WR)
            is_waiting = any(word in sent for word in (b"stream", b"pictures", b"Length", b"chunked"))
            connection.settimeout(0.03 if is_waiting else 2.0)
            while len(heard) < 1 << 17 and (piece := connection.recv(65536)):
                heard += piece
    except OSError:  # reset, or it says nothing more
        pass
    return heard


async def run(requests: int, seed: int = 1) -> Tally:
    """Serve a unit, attack it, and poll it meanwhile."""
    tally = Tally()
    said = _Said()
    with tempfile.TemporaryDirectory() as folder:
        credentials = Path(folder) / "credentials"
        password = PasswordHash.of("nobody guesses this")
        change(credentials, "ana", lambda known: known.with_password("ana", password))
        settings = HttpSettings(host="127.0.0.1", port=0, names=("unit",), credentials=credentials)
        shown = board()
        health = Health(SystemClock())
        publisher = HttpPublisher(settings, shown, health, health.component("http"))
        ready = asyncio.Event()
        serving = asyncio.create_task(publisher.run(ready.set))
        await ready.wait()
        logging.getLogger().addHandler(said)
        began = time.monotonic()
        with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
            loop = asyncio.get_running_loop()
            share = requests // PROCESSES
            attacks = [
                loop.run_in_executor(pool, attack, publisher.port, share, seed * PROCESSES + number)
                for number in range(PROCESSES)
            ]
            while not all(each.done() for each in attacks):
                await _poll(publisher.port, tally)
                await asyncio.sleep(POLL_INTERVAL_S)
            for statuses, wrong in await asyncio.gather(*attacks):
                tally.statuses.update(statuses)
                tally.wrong += wrong
        tally.seconds = time.monotonic() - began
        tally.wrong += [f"logged: {line}" for line in said.lines]
        logging.getLogger().removeHandler(said)
        serving.cancel()
        await asyncio.wait({serving})
    return tally


async def _poll(port: int, tally: Tally) -> None:
    """Read the measurement as a controller does, and check it."""
    began = time.monotonic()
    heard = b""
    try:
        async with asyncio.timeout(5.0):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"GET /api/v1/measurement HTTP/1.1\r\nHost: unit\r\n\r\n")
            heard = await reader.read()
            writer.close()
    except (OSError, TimeoutError) as error:
        tally.wrong.append(f"the poller got nothing: {error!r}")
        return
    tally.polls += 1
    tally.slowest_poll_s = max(tally.slowest_poll_s, time.monotonic() - began)
    body = heard.partition(b"\r\n\r\n")[2]
    line, _, crc = body.rpartition(b', "crc32": ')
    if crc != b'"%08X"}' % zlib.crc32(line) or json.loads(body)["x_mm"] != MEASURED.number("x_mm"):
        tally.wrong.append(f"the poller read {heard[:200]!r}")


class _Said(logging.Handler):
    """What is logged: nobody outside may make a unit log anything."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep it."""
        self.lines.append(self.format(record))


def _lines(tally: Tally) -> Iterable[str]:
    total = tally.statuses.total()
    yield f"{total} requests in {tally.seconds:.1f} s, {total / tally.seconds:.0f} a second"
    yield "answers: " + ", ".join(f"{status} {count}" for status, count in sorted(tally.statuses.items()))
    yield f"poller: {tally.polls} right readings, the slowest after {1e3 * tally.slowest_poll_s:.0f} ms"
    yield f"wrong: {len(tally.wrong)}"
    yield from tally.wrong[:20]


def main() -> int:
    """Attack as often as is asked for; 1 when something was wrong."""
    parser = argparse.ArgumentParser(prog="hostile_http")
    parser.add_argument("--requests", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    tally = asyncio.run(run(options.requests, options.seed))
    print("\n".join(_lines(tally)))
    return int(bool(tally.wrong))


if __name__ == "__main__":
    sys.exit(main())
