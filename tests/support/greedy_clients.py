"""Clients on raw sockets that ask and never read, that never ask, and a controller that polls beside them."""

import asyncio
import contextlib
import math
import pickle
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass

HANDSHAKE = (
    b"GET /api/v1/pictures HTTP/1.1\r\nHost: unit\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
NEXT = b"\x81\x84\x00\x00\x00\x00next"
"""A text message from a browser (RFC 6455, 5.2), its mask 0."""
EMPTY_PING = b"\x89\x80\x00\x00\x00\x00"

_RECEIVE_BYTES = 2048
_REGISTERS = 10
_POLL_S = 0.02
_PAUSE_S = 0.1


_WATCH = """
import time
before = time.monotonic()
while True:
    time.sleep(0.005)
    before, late_s = time.monotonic(), time.monotonic() - before
    if late_s > 0.02:
        print(late_s, flush=True)
"""


@dataclass
class Stalls:
    """For how long the machine gave a process that only sleeps no processor, s."""

    each_s: tuple[float, ...] = ()

    def periods(self, period_s: float) -> int:
        """The largest number of exposures that they may have taken from a program with deadlines."""
        return sum(math.ceil(stall_s / period_s) for stall_s in self.each_s)


@contextlib.contextmanager
def watched_machine() -> Iterator[Stalls]:
    """The stalls of the machine within, known at the end."""
    stalls = Stalls()
    with subprocess.Popen([sys.executable, "-c", _WATCH], stdout=subprocess.PIPE, text=True) as watching:
        assert watching.stdout is not None
        try:
            yield stalls
        finally:
            watching.terminate()
            stalls.each_s = tuple(map(float, watching.stdout))


def get(path: str) -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: unit\r\n\r\n".encode()


async def _crowd(port: int, count: int, sent: list[bytes], more: bytes) -> None:
    """Connect and send, each piece a little after the one before; then send ``more`` until killed."""
    loop = asyncio.get_running_loop()
    connections = [socket.socket() for _ in range(count)]

    async def opened(connection: socket.socket) -> None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        connection.setblocking(False)
        await loop.sock_connect(connection, ("127.0.0.1", port))
        with contextlib.suppress(ConnectionError):
            for piece in sent:
                await loop.sock_sendall(connection, piece)
                await asyncio.sleep(_PAUSE_S)

    async def push(connection: socket.socket) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                try:
                    connection.send(more)
                except BlockingIOError:
                    await asyncio.sleep(0.01)
                await asyncio.sleep(0)

    await asyncio.gather(*map(opened, connections))
    print("connected", flush=True)
    if more:
        await asyncio.gather(*map(push, connections))
    await asyncio.Event().wait()


@contextlib.asynccontextmanager
async def crowd(port: int, count: int, *sent: bytes, more: bytes = b"") -> AsyncIterator[None]:
    """Clients whose receive buffers are as small as the kernel has them, connected within.

    They have a process of their own: their work is not the unit's, which runs in this one.
    """
    command = [sys.executable, __file__, str(port), str(count)]
    pipe = asyncio.subprocess.PIPE
    child = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe)
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        child.stdin.write(pickle.dumps((sent, more)))
        child.stdin.write_eof()
        async with asyncio.timeout(30):
            assert await child.stdout.readline() == b"connected\n"
        yield
    finally:
        child.kill()
        await child.wait()


class Poller:
    """A controller; ``answers`` are status word and number of the last exposure (registers 0 and 8)."""

    def __init__(self) -> None:
        self.answers: list[tuple[int, int]] = []
        self._ended = asyncio.Event()

    async def run(self, port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            while not self._ended.is_set():
                writer.write(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, _REGISTERS))
                async with asyncio.timeout(5):
                    answer = await reader.readexactly(9 + 2 * _REGISTERS)
                registers = struct.unpack(f">{_REGISTERS}H", answer[9:])
                self.answers.append((registers[0], registers[8] << 16 | registers[9]))
                await asyncio.sleep(_POLL_S)
        finally:
            writer.close()

    def end(self) -> None:
        self._ended.set()


@contextlib.asynccontextmanager
async def polled(port: int) -> AsyncIterator[Poller]:
    """Poll for as long as the block lasts."""
    poller = Poller()
    task = asyncio.create_task(poller.run(port))
    try:
        yield poller
    finally:
        poller.end()
        await task


if __name__ == "__main__":
    asyncio.run(_crowd(int(sys.argv[1]), int(sys.argv[2]), *pickle.load(sys.stdin.buffer)))
