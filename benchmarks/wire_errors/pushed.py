"""The telegram and the JSON stream: what the unit sends unasked runs through a proxy to the reader."""

from __future__ import annotations

import http.client
import os
import queue
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator

from benchmarks.wire_errors.errors import Delivery
from benchmarks.wire_errors.polled import raw_terminal

_SILENCE_S = 0.004
_TIMEOUT_S = 60.0


class Newest:
    """Messages that come in a thread; who takes gets what came since, old ones of long ago are dropped."""

    def __init__(self, messages: Iterator[bytes]) -> None:
        self._queue: queue.Queue[bytes] = queue.Queue()
        self._thread = threading.Thread(target=self._fill, args=(messages,), daemon=True)
        self._thread.start()

    def _fill(self, messages: Iterator[bytes]) -> None:
        for message in messages:
            self._queue.put(message)

    def take(self) -> bytes:
        """The next message."""
        return self._queue.get(timeout=_TIMEOUT_S)

    def drop(self) -> None:
        """What waits is lost."""
        while not self._queue.empty():
            self._queue.get_nowait()


def telegrams(descriptor: int) -> Iterator[bytes]:
    """The telegrams that a unit writes to a terminal, each with three sentences."""
    heard = b""
    while True:
        heard += os.read(descriptor, 4096)
        while b"$PALTC" in heard and b"\r\n" in heard[heard.index(b"$PALTC") :]:
            end = heard.index(b"\r\n", heard.index(b"$PALTC")) + 2
            yield heard[heard.index(b"$PALTM") : end]
            heard = heard[end:]


def stream(port: int) -> Iterator[bytes]:
    """The JSON objects of a unit's stream, as a browser gets them."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_TIMEOUT_S)
    connection.request("GET", "/api/stream")
    yield from _data_of(connection.getresponse())


def _data_of(lines: http.client.HTTPResponse) -> Iterator[bytes]:
    while line := lines.readline():
        if line.startswith(b"data: "):
            yield line[len(b"data: ") :].rstrip(b"\n")


class Relay:
    """Hands deliveries over one by one: the next only when the reader has judged the last."""

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
    """A pseudo terminal: how the relay writes a telegram, and what a reader reads up to a silence."""
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
    """A TCP connection with server-sent events: how the relay writes one, and what an HTTP client reads."""
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
