"""Bytes into the local socket: it is the server of HTTP, by what its client makes of the answers."""

import asyncio
import contextlib
import tempfile
from pathlib import Path

from fuzz.served import served
from fuzz.targets.http import STREAMS, send_in_pieces
from hypothesis import strategies as st

from altd.local_socket import ask
from altd.publish.http.publisher import LocalPublisher

NAME = "local_socket"
EXAMPLES = st.tuples(STREAMS, st.sampled_from((1_000_000, 200, 40, 7)))
"""The bytes to send, and the size of the pieces."""

_PATH = Path(tempfile.mkdtemp(prefix="altd-fuzz-"), "altd.sock")
_face = served(lambda faces: LocalPublisher(_PATH, faces.board, faces.health, faces.component(NAME)))


def check(example: tuple[bytes, int]) -> None:
    """For any input: an answer of HTTP or none, and the next client has the measurement."""
    faces, _ = _face()
    heard = faces.do(_exchange(*example))
    assert heard == b"" or heard.startswith((b"HTTP/1.1 ", b"HTTP/1.0 ")), heard[:200]
    assert b"Traceback" not in heard


async def _exchange(stream: bytes, piece: int) -> bytes:
    reader, writer = await asyncio.open_unix_connection(_PATH)
    heard = b""
    await send_in_pieces(writer, stream, piece)
    status, document = await asyncio.to_thread(ask, _PATH, "/api/v1/measurement", 5.0)
    assert (status, document["sequence"]) == (200, 160)
    with contextlib.suppress(ConnectionError, TimeoutError):
        async with asyncio.timeout(0.002):
            heard = await reader.read(65536)
    writer.transport.abort()
    await asyncio.sleep(0)
    return heard
