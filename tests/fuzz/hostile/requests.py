"""Requests that are nearly valid, at HTTP over TCP and over the local socket."""

import json
import random
import re
import socket
from collections.abc import Collection

Address = tuple[str, int] | str
"""Host and port, or the path of a socket in the file system."""

_TIMEOUT_S = 5.0

STATUSES = {200, 400, 401, 403, 404, 405, 408, 409, 411, 413, 414, 415, 421, 426, 429, 431, 503, 505}
"""408 answers a request that is not completed in time."""

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


def connected(address: Address) -> socket.socket:
    """A connection; raises OSError."""
    if isinstance(address, tuple):
        return socket.create_connection(address, timeout=_TIMEOUT_S)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(
            address
        )  # without a timeout: with one it fails where others are waiting (connect(2))
    except OSError:
        connection.close()
        raise
    connection.settimeout(_TIMEOUT_S)
    return connection


def request(chance: random.Random) -> bytes:
    """A request that is valid, or was corrupted in up to three places."""
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


def complaint(answer: bytes, statuses: Collection[int] = STATUSES) -> str:
    """The fault of an answer; empty: none, or no answer."""
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
    if status not in statuses:
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


def send(address: Address, chance: random.Random) -> tuple[str, str]:
    """Send one; returns the answer's status, or that there was none, and what is wrong with it."""
    sent = request(chance)
    answer = _exchange(address, sent)
    # over TCP pictures need a token, which no client here has
    why = complaint(answer, STATUSES if isinstance(address, tuple) else {*STATUSES, 101})
    return answer[9:12].decode("latin-1") or "closed", f"{why}; sent {sent[:300]!r}" if why else ""


def _exchange(address: Address, sent: bytes) -> bytes:
    """The response; a client that waits for more than was sent gets no more."""
    heard = b""
    try:
        with connected(address) as connection:
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
