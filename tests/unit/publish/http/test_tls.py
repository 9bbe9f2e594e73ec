"""TLS by a foreign client (Python's ssl and http.client), against certificates that openssl made."""

import asyncio
import contextlib
import http.client
import os
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support.certificates import Files, made

from altd.credentials.certificates import server_context
from altd.errors import BadInputError
from altd.publish.http import server
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, State

from .conftest import Served, Unit


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return made(tmp_path_factory.mktemp("tls"), "unit")


@pytest.fixture(scope="session")
def others(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return made(tmp_path_factory.mktemp("tls"), "other")


@pytest.fixture
async def unit(served: Served, files: Files) -> AsyncIterator[Unit]:
    async with served(certificate=files[0], key=files[1]) as unit:
        yield unit


def _remove(path: Path) -> None:
    path.unlink()


def client(certificate: Path) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=str(certificate))


def fetched(port: int, context: ssl.SSLContext, path: str = "/api/v1/status") -> http.client.HTTPResponse:
    connection = http.client.HTTPSConnection("127.0.0.1", port, timeout=60, context=context)
    connection.request("GET", path)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer


async def name_shown(unit: Unit, context: ssl.SSLContext) -> str:
    """The name in the certificate that the unit shows."""

    def ask() -> str:
        with (
            socket.create_connection(("127.0.0.1", unit.port), timeout=60) as raw,
            context.wrap_socket(raw, server_hostname="127.0.0.1") as secured,
        ):
            found = secured.getpeercert()
            assert found is not None
            return str(dict(part[0] for part in found["subject"])["commonName"])

    return await asyncio.to_thread(ask)


async def test_it_speaks_tls_and_nothing_else(unit: Unit, files: Files) -> None:
    answer = await asyncio.to_thread(fetched, unit.port, client(files[0]))
    assert answer.status == 200
    assert await unit.send(b"GET / HTTP/1.1\r\nHost: unit\r\n\r\n") == b""
    with pytest.raises(ssl.SSLCertVerificationError):
        await asyncio.to_thread(fetched, unit.port, ssl.create_default_context())


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
async def test_it_speaks_these_versions(unit: Unit, files: Files, version: ssl.TLSVersion) -> None:
    context = client(files[0])
    context.minimum_version = context.maximum_version = version
    assert (await asyncio.to_thread(fetched, unit.port, context)).status == 200


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
async def test_it_speaks_no_older_version(unit: Unit, files: Files) -> None:
    context = client(files[0])
    context.set_ciphers("ALL:@SECLEVEL=0")
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with pytest.raises(OSError):  # noqa: PT011  whichever side gives up first
        await asyncio.to_thread(fetched, unit.port, context)
    with pytest.raises(
        ssl.SSLError, match=r"(?i)unsupported|no protocols|version"
    ):  # and not the client itself
        _handshake(server_context(*files), context)


def _handshake(ours: ssl.SSLContext, theirs: ssl.SSLContext) -> None:
    to_us, to_them = ssl.MemoryBIO(), ssl.MemoryBIO()
    server_side = ours.wrap_bio(to_us, to_them, server_side=True)
    client_side = theirs.wrap_bio(to_them, to_us, server_hostname="127.0.0.1")
    for side in (client_side, server_side, client_side, server_side):
        with contextlib.suppress(ssl.SSLWantReadError):
            side.do_handshake()


async def test_a_handshake_that_does_not_come_holds_nobody_up(
    unit: Unit, files: Files, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(server, "HANDSHAKE_TIMEOUT_S", 3.0)
    silent = [await unit.connect() for _ in range(server.MAX_HANDSHAKES - 1)]
    began = time.perf_counter()
    assert (await asyncio.to_thread(fetched, unit.port, client(files[0]))).status == 200
    assert time.perf_counter() - began < 3.0, "it waited for the others"
    for reader, writer in silent:
        with contextlib.suppress(ConnectionError):
            assert await asyncio.wait_for(reader.read(), 60) == b""
        writer.close()
    assert (await asyncio.to_thread(fetched, unit.port, client(files[0]))).status == 200
    assert caplog.records == []


async def test_handshakes_are_few_at_a_time(unit: Unit, files: Files, component: Component) -> None:
    flood = [await unit.connect() for _ in range(60)]
    await unit.until(lambda: component.counters.get("connections_refused", 0) >= 60 - server.MAX_HANDSHAKES)
    for _, writer in flood:
        writer.close()
    await unit.until(lambda: component.counters.get("handshakes_failed", 0) >= server.MAX_HANDSHAKES)
    assert (await asyncio.to_thread(fetched, unit.port, client(files[0]))).status == 200


@pytest.mark.parametrize(
    "garbage",
    [
        b"",
        b"\x00" * 100,
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00" + b"\xff" * 600,
        b"\x80" * 70_000,
    ],
)
async def test_garbage_instead_of_a_handshake_logs_nothing(
    unit: Unit, files: Files, garbage: bytes, caplog: pytest.LogCaptureFixture, component: Component
) -> None:
    reader, writer = await unit.connect()
    writer.write(garbage)
    with contextlib.suppress(ConnectionError):
        writer.write_eof()
        await asyncio.wait_for(reader.read(), 60)
    writer.close()
    await unit.until(lambda: component.counters.get("handshakes_failed", 0) == 1)
    assert (await asyncio.to_thread(fetched, unit.port, client(files[0]))).status == 200
    assert caplog.records == []


async def test_a_request_that_comes_with_the_handshake_is_answered(unit: Unit, files: Files) -> None:
    """The bytes that TLS deciphers at once must not be lost on their way to HTTP."""

    def ask(port: int) -> bytes:
        ours, theirs = ssl.MemoryBIO(), ssl.MemoryBIO()
        tls = client(files[0]).wrap_bio(ours, theirs, server_hostname="127.0.0.1")
        heard = b""
        with socket.create_connection(("127.0.0.1", port), timeout=60) as raw:
            while True:
                try:
                    tls.do_handshake()
                    break
                except ssl.SSLWantReadError:
                    raw.sendall(theirs.read())
                    ours.write(raw.recv(65536))
            tls.write(b"GET /healthz HTTP/1.1\r\nHost: unit\r\n\r\n")
            raw.sendall(theirs.read())  # the end of the handshake and the request in one piece
            while not heard.endswith(b"}"):
                try:
                    heard += tls.read(65536)
                except ssl.SSLWantReadError:
                    ours.write(raw.recv(65536))
        return heard

    for _ in range(20):
        assert (await asyncio.to_thread(ask, unit.port)).startswith(b"HTTP/1.1 200")


async def test_a_slow_client_skips_with_tls_too(
    unit: Unit, files: Files, board: Board, component: Component, measured: Measurement
) -> None:
    """Old measurements must not wait in a buffer of TLS."""

    def until_the_last(secured: ssl.SSLSocket) -> bytes:
        received = b""
        while b"id: 1999\n" not in received:
            received += secured.recv(65536)
        return received

    with await asyncio.to_thread(slow_stream, unit.port, client(files[0])) as secured:
        await unit.until(lambda: component.counters.get("streams", 0) == 1)
        for sequence in range(2000):
            board.publish(replace(measured, sequence=sequence))
            await asyncio.sleep(0)
        received = await asyncio.to_thread(until_the_last, secured)
    ids = [int(line[4:]) for line in received.split(b"\n") if line.startswith(b"id: ")]
    assert ids == sorted(set(ids))
    assert len(ids) < 300, "old measurements were queued"
    await unit.until(lambda: unit.publisher.answers.streams.open == 0)


def slow_stream(port: int, context: ssl.SSLContext) -> ssl.SSLSocket:
    """A client that asked for the stream and has room for little."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.settimeout(60)
    raw.connect(("127.0.0.1", port))
    secured = context.wrap_socket(raw, server_hostname="127.0.0.1")
    secured.sendall(b"GET /api/stream HTTP/1.1\r\nHost: unit\r\n\r\n")
    return secured


async def test_a_stalled_client_is_cut_off_with_tls_too(
    served: Served, files: Files, board: Board, measured: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "SEND_TIMEOUT_S", 1)
    async with served(certificate=files[0], key=files[1]) as unit:
        with await asyncio.to_thread(slow_stream, unit.port, client(files[0])):
            await unit.until(lambda: unit.publisher.answers.streams.open == 1)
            for sequence in range(500):
                board.publish(replace(measured, sequence=sequence))
                await asyncio.sleep(0)
            await unit.until(lambda: unit.publisher.answers.streams.open == 0, timeout_s=60)


async def test_a_renewed_certificate_is_shown_without_a_restart(
    served: Served, files: Files, others: Files, tmp_path: Path, component: Component
) -> None:
    certificate, key = tmp_path / "unit.pem", tmp_path / "unit.key"

    def put(first: Path, second: Path) -> None:
        shutil.copy(first, certificate)
        shutil.copy(second, key)
        key.chmod(0o600)

    put(*files)
    both = client(files[0])
    both.load_verify_locations(others[0])
    async with served(certificate=certificate, key=key) as unit:
        assert await name_shown(unit, both) == "unit"
        put(others[0], files[1])  # half renewed: the old one stays
        assert await name_shown(unit, both) == "unit"
        assert component.state is State.DEGRADED
        assert "is not the key of the certificate" in component.message
        put(*others)
        assert await name_shown(unit, both) == "other"
        assert component.state is State.OK
        _remove(key)
        assert await name_shown(unit, both) == "other"


@pytest.mark.parametrize(
    ("spoil", "named", "said"),
    [
        (lambda cert, key: cert.write_text("nonsense"), "cert", "contains no certificate"),
        (lambda cert, key: cert.write_bytes(b""), "cert", "contains no certificate"),
        (lambda cert, key: cert.unlink(), "cert", "No such file"),
        (lambda cert, key: key.write_text("nonsense"), "key", "contains no usable private key"),
        (lambda cert, key: key.unlink(), "key", "No such file"),
        (lambda cert, key: key.chmod(0o644), "key", "chmod 640"),
        (lambda cert, key: _swap(cert, key), "key", "unit.pem does: the two are swapped"),
        (lambda cert, key: (key.unlink(), os.mkfifo(key, 0o600)), "key", "is a pipe, not a file"),
        (lambda cert, key: (cert.unlink(), cert.mkdir()), "cert", "is a folder, not a file"),
        (
            lambda cert, key: cert.chmod(0o646),
            "cert",
            "others than its owner may write it (mode 0646): chmod o-w ",
        ),
    ],
)
def test_files_that_cannot_be_used_are_one_clear_line(
    tmp_path: Path, files: Files, spoil: Callable[[Path, Path], object], named: str, said: str
) -> None:
    copies = {"cert": tmp_path / "unit.pem", "key": tmp_path / "unit.key"}
    for path, original in zip(copies.values(), files, strict=True):
        shutil.copy(original, path)
    copies["key"].chmod(0o600)
    spoil(copies["cert"], copies["key"])
    with pytest.raises(BadInputError) as caught:
        server_context(copies["cert"], copies["key"])
    assert str(caught.value).startswith(f"{copies[named]}: ")
    assert said in str(caught.value)


def _swap(one: Path, other: Path) -> None:
    content, content_of_other = one.read_bytes(), other.read_bytes()
    one.write_bytes(content_of_other)
    other.write_bytes(content)


def test_a_key_of_another_certificate_and_one_with_a_passphrase_are_told_apart(
    tmp_path: Path, files: Files, others: Files
) -> None:
    with pytest.raises(BadInputError, match="is not the key of the certificate"):
        server_context(files[0], others[1])
    locked = tmp_path / "locked.key"
    line = ["openssl", "ec", "-in", files[1], "-aes256", "-passout", "pass:secret", "-out", locked]
    subprocess.run(line, check=True, capture_output=True)
    locked.chmod(0o600)
    with pytest.raises(BadInputError, match="passphrase, which a daemon cannot type"):
        server_context(files[0], locked)
