"""Bytes into the real HTTP server: its answers are HTTP, it logs nothing, and the next client is served."""

import asyncio
import contextlib
import json

import h11
from fuzz.served import served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.config import HttpSettings
from altd.publish.http.publisher import HttpPublisher

NAME = "http"
STATUSES = {200, 400, 401, 403, 404, 405, 409, 411, 413, 414, 415, 421, 426, 429, 431, 503, 505}

_REQUESTS = tuple(
    text.encode("latin-1")
    for text in (
        "GET /api/measurement HTTP/1.1\r\nHost: unit\r\n\r\n",
        "HEAD / HTTP/1.1\r\nHost: unit\r\n\r\n",
        "GET /api/stream HTTP/1.1\r\nHost: unit\r\nAccept: text/event-stream\r\n\r\n",
        "GET /api/status?x=%00%ff&y HTTP/1.0\r\n\r\n",
        "POST /api/measurement HTTP/1.1\r\nHost: unit\r\nContent-Length: 5\r\n\r\nhello",
        "GET /api/status HTTP/1.1\r\nHost: unit\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
        "POST /api/self-check HTTP/1.1\r\nHost: [::1\r\nX-Altd-Request: 1\r\n\r\n",
        "POST /api/self-check HTTP/1.1\r\nHost: 127.0.0.1:80\r\nX-Altd-Request: 1\r\n\r\n",
        "PUT /api/stream HTTP/1.1\r\nHost: unit\r\nTransfer-Encoding: chunked\r\n\r\nffffffffff\r\nx",
        "GET /api/status HTTP/1.1\r\nHost: unit\r\nExpect: 100-continue\r\nContent-Length: 3\r\n\r\n",
        "GET /api/status HTTP/1.1\r\nHost: unit\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n",
        "POST /api/v1/login HTTP/1.1\r\nHost: unit\r\nX-Altd-Request: 1\r\nContent-Type: application/json\r\n"
        'Content-Length: 32\r\n\r\n{"name": "ana", "password": "x"}',
        "POST /api/v1/logout HTTP/1.1\r\nHost: unit\r\nX-Altd-Request: 1\r\nAuthorization: Bearer x\r\n\r\n",
        "GET /api/v1/trend?from=-60&points=3 HTTP/1.1\r\nHost: unit\r\nCookie: altd_80=a; altd_80=b\r\n\r\n",
        "GET /api/v1/events?kind=state&before=9 HTTP/1.1\r\nHost: unit\r\n\r\n",
        "GET /api/v1/stream HTTP/1.1\r\nHost: unit\r\nLast-Event-ID: 160-8000000000\r\n\r\n",
        "GET /api/v1/calibration/report HTTP/1.1\r\nHost: unit\r\nRange: bytes=0-\r\n\r\n",
        "HEAD /api/v1/diagnostics HTTP/1.1\r\nHost: unit\r\nAuthorization: Bearer x\r\n\r\n",
        "GET /metrics HTTP/1.1\r\nHost: unit\r\nAccept: application/openmetrics-text;q=1e9\r\n\r\n",
        "HEAD /readyz HTTP/1.1\r\nHost: unit\r\nForwarded: for=127.0.0.1\r\n\r\n",
        "OPTIONS * HTTP/1.1\r\nHost: unit\r\n\r\n",
        "CONNECT unit:80 HTTP/1.1\r\nHost: unit\r\n\r\n",
        "GET http://unit/../api//status#%2e%2e HTTP/1.1\r\nHost: unit\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    )
)
_ASKED = st.lists(st.sampled_from(_REQUESTS), min_size=1, max_size=3).map(b"".join)
STREAMS = _ASKED | spoilt_bytes(_ASKED)
EXAMPLES = st.tuples(STREAMS, st.sampled_from((1_000_000, 200, 40, 7)))
"""The bytes to send, and the size of the pieces."""

_face = served(
    lambda faces: HttpPublisher(
        HttpSettings(host="127.0.0.1", port=0, names=("unit",)),
        faces.board,
        faces.health,
        faces.component(NAME),
    )
)


def check(example: tuple[bytes, int]) -> None:
    """One answer or none, as h11 reads it on the client's side."""
    faces, publisher = _face()
    heard = faces.do(_exchange(publisher.port, *example))
    client = h11.Connection(h11.CLIENT)
    client.send(h11.Request(method=_method(example[0]), target="/", headers=[("Host", "unit")]))
    client.send(h11.EndOfMessage())
    if heard:  # no bytes would mean the end of the connection
        client.receive_data(heard)
    final = None
    while (event := client.next_event()) not in (h11.NEED_DATA, h11.PAUSED):
        if isinstance(event, h11.Response):
            assert final is None
            final = event.status_code
            assert final in STATUSES
        if isinstance(event, h11.EndOfMessage):
            break
    assert (final is None) == (heard in (b"", b"HTTP/1.1 100 Continue\r\n\r\n", b"HTTP/1.1 100 \r\n\r\n"))


def _method(stream: bytes) -> bytes:
    """Whether the answer has a body depends on it."""
    return b"HEAD" if stream.lstrip(b"\r\n").startswith(b"HEAD ") else b"GET"


async def _exchange(port: int, stream: bytes, piece: int) -> bytes:
    """The bytes returned by the time that another client has its answer."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    heard = b""
    await send_in_pieces(writer, stream, piece)
    await _another_client(port)
    with contextlib.suppress(ConnectionError, TimeoutError):
        while True:
            async with asyncio.timeout(0.002):
                if not (more := await reader.read(65536)):
                    break
            heard += more
    writer.transport.abort()
    await asyncio.sleep(0)
    return heard


async def send_in_pieces(writer: asyncio.StreamWriter, stream: bytes, piece: int) -> None:
    """Send as much of it as is taken, so many bytes at a time."""
    with contextlib.suppress(ConnectionError):
        for begin in range(0, len(stream), piece):
            if writer.transport.is_closing():
                break
            writer.write(stream[begin : begin + piece])
            await asyncio.sleep(0)
        await writer.drain()


async def _another_client(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /api/measurement HTTP/1.1\r\nHost: unit\r\n\r\n")
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 ")
    assert json.loads(body)["sequence"] == 160
    writer.close()
