"""Wires between the unit and the reader, with a proxy on each that delivers what the error leaves.

Modbus TCP and RTU: the reader polls the proxy, which polls the unit. The telegram and the JSON stream: the
unit's unsolicited messages pass through the proxy to the reader.
"""

import contextlib
import http.client
import os
import queue
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Protocol

from benchmarks.poller import received
from benchmarks.wire_errors.errors import Delivery
from hw_sim.inclinometer import crc

UNIT_ID = 1
READ = struct.pack(">BHH", 4, 200, 80)
"""Request for the checked block."""

_ANSWER_BYTES = 2 + 160
_UPSTREAM_TIMEOUT_S = 5.0


class Client(Protocol):
    """Requests the block and returns its 160 bytes, or None if none arrive in time."""

    def ask(self, timeout_s: float) -> bytes | None:
        """Request the block."""

    def close(self) -> None:
        """Release the wire."""


class TcpClient:
    """A Modbus TCP client, with a new connection after each timeout."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._connection: socket.socket | None = None
        self._transaction = 0

    def ask(self, timeout_s: float) -> bytes | None:
        """Request the block; the answer must match this request."""
        if self._connection is None:
            self._connection = socket.create_connection(("127.0.0.1", self._port))
        self._transaction = (self._transaction + 1) % 0x10000
        self._connection.settimeout(timeout_s)
        self._connection.sendall(struct.pack(">HHHB", self._transaction, 0, 6, UNIT_ID) + READ)
        try:
            head = received(self._connection, 7)
            body = received(self._connection, _ANSWER_BYTES)
        except (TimeoutError, ConnectionError):
            self.close()
            return None
        return body[2:] if struct.unpack_from(">H", head)[0] == self._transaction else b""

    def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


class RtuClient:
    """A Modbus RTU client on a descriptor of a terminal."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def ask(self, timeout_s: float) -> bytes | None:
        """Request the block; remains of an earlier answer are discarded."""
        while select.select([self._descriptor], [], [], 0)[0]:
            os.read(self._descriptor, 4096)
        os.write(self._descriptor, _framed(READ))
        heard, until_s = b"", time.monotonic() + timeout_s
        while len(heard) < _ANSWER_BYTES + 3:
            left_s = max(until_s - time.monotonic(), 0)
            if not select.select([self._descriptor], [], [], left_s)[0]:
                return None
            heard += os.read(self._descriptor, 4096)
        return heard[3:-2] if _framed(heard[1:-2]) == heard else b""

    def close(self) -> None:
        """Do nothing: the descriptor is the caller's."""


def tcp_proxy(deliveries: Iterator[Delivery], truth: queue.Queue[bool]) -> int:
    """Answer with these deliveries in a thread; return its port. Puts first whether each is corrupted."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            connection, _ = listener.accept()
            with connection, contextlib.suppress(ConnectionError, OSError):
                while request := received(connection, 12):
                    content = _due(deliveries, truth)
                    if content is not None:
                        answer = bytes([4, len(content)]) + content
                        head = struct.pack(">HHHB", *struct.unpack(">HH", request[:4]), len(answer) + 1, 1)
                        connection.sendall(head + answer)

    threading.Thread(target=serve, daemon=True).start()
    return int(listener.getsockname()[1])


def rtu_proxy(deliveries: Iterator[Delivery], truth: queue.Queue[bool]) -> int:
    """Answer in a thread at a pseudo terminal's far end; return the reader's descriptor."""
    ours, theirs = raw_terminal()

    def serve() -> None:
        while True:
            heard = b""
            while len(heard) < 8:
                heard += os.read(ours, 4096)
            content = _due(deliveries, truth)
            if content is not None:
                os.write(ours, _framed(bytes([4, len(content)]) + content))

    threading.Thread(target=serve, daemon=True).start()
    return theirs


def fetch(client: Client) -> Callable[[], bytes]:
    """Return a function that polls a unit until it answers."""

    def ask() -> bytes:
        for _ in range(10):
            answer = client.ask(_UPSTREAM_TIMEOUT_S)
            if answer:
                return answer
        raise RuntimeError("the unit does not answer")

    return ask


def raw_terminal() -> tuple[int, int]:
    """Both ends of a pseudo terminal that transfers bytes unchanged."""
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    return ours, theirs


def _due(deliveries: Iterator[Delivery], truth: queue.Queue[bool]) -> bytes | None:
    delivery = next(deliveries)
    time.sleep(delivery.hold_s)
    truth.put(delivery.is_spoilt)
    return delivery.content


def _framed(pdu: bytes) -> bytes:
    frame = bytes([UNIT_ID]) + pdu
    return frame + crc(frame)


_SILENCE_S = 0.004
_TIMEOUT_S = 60.0


class Newest:
    """Messages received in a thread, in their order; ``drop`` discards the waiting ones."""

    def __init__(self, messages: Iterator[bytes]) -> None:
        self._queue: queue.Queue[bytes] = queue.Queue()
        self._thread = threading.Thread(target=self._fill, args=(messages,), daemon=True)
        self._thread.start()

    def _fill(self, messages: Iterator[bytes]) -> None:
        for message in messages:
            self._queue.put(message)

    def take(self) -> bytes:
        """Return the next message."""
        return self._queue.get(timeout=_TIMEOUT_S)

    def drop(self) -> None:
        """Discard the waiting messages."""
        while not self._queue.empty():
            self._queue.get_nowait()


def telegrams(descriptor: int) -> Iterator[bytes]:
    """Yield the telegrams that a unit writes to a terminal, each with three sentences."""
    heard = b""
    while True:
        heard += os.read(descriptor, 4096)
        while b"$PALTC" in heard and b"\r\n" in heard[heard.index(b"$PALTC") :]:
            end = heard.index(b"\r\n", heard.index(b"$PALTC")) + 2
            yield heard[heard.index(b"$PALTM") : end]
            heard = heard[end:]


def stream(port: int) -> Iterator[bytes]:
    """Yield the JSON objects of a unit's stream, as received by a browser."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_TIMEOUT_S)
    connection.request("GET", "/api/stream")
    yield from _data_of(connection.getresponse())


def _data_of(lines: http.client.HTTPResponse) -> Iterator[bytes]:
    while line := lines.readline():
        if line.startswith(b"data: "):
            yield line[len(b"data: ") :].rstrip(b"\n")


class Relay:
    """Delivers messages one by one: the next only after the reader has judged the last."""

    def __init__(
        self, deliveries: Iterator[Delivery], source: Newest, write: Callable[[bytes], None]
    ) -> None:
        self.truth: queue.Queue[bool] = queue.Queue()
        self.judged = threading.Semaphore(1)
        self._deliveries, self._source, self._write = deliveries, source, write
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        for delivery in self._deliveries:
            time.sleep(delivery.hold_s)
            if not self.judged.acquire(timeout=_TIMEOUT_S):
                return
            if delivery.hold_s:
                self._source.drop()
            self.truth.put(delivery.is_spoilt)
            self._write(delivery.content or b"")


def telegram_wire() -> tuple[Callable[[bytes], None], Iterator[bytes]]:
    """Pseudo terminal: a function that writes a telegram, and a reader's data up to each silence."""
    ours, theirs = raw_terminal()

    def received() -> Iterator[bytes]:
        while True:
            heard = os.read(theirs, 4096)
            while select.select([theirs], [], [], _SILENCE_S)[0]:
                heard += os.read(theirs, 4096)
            yield heard

    def write(data: bytes) -> None:
        os.write(ours, data)

    return write, received()


def stream_wire() -> tuple[Callable[[bytes], None], Iterator[bytes]]:
    """TCP connection with server-sent events: a function that writes one, and an HTTP client's data."""
    listener = socket.create_server(("127.0.0.1", 0))
    client = http.client.HTTPConnection("127.0.0.1", listener.getsockname()[1], timeout=_TIMEOUT_S)
    client.request("GET", "/api/stream")
    connection, _ = listener.accept()
    connection.recv(4096)
    connection.sendall(
        b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
    )

    def write(data: bytes) -> None:
        event = b"data: " + data + b"\n\n"
        connection.sendall(b"%x\r\n%s\r\n" % (len(event), event))

    return write, _data_of(client.getresponse())
