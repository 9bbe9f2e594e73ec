"""Modbus TCP and RTU: the reader asks a proxy, which asks the unit and hands over what the error leaves."""

from __future__ import annotations

import contextlib
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

UNIT_ID = 1
READ = struct.pack(">BHH", 4, 200, 80)
"""The request for the checked block."""

_ANSWER_BYTES = 2 + 160
_UPSTREAM_TIMEOUT_S = 5.0


class Client(Protocol):
    """Asks for the block and gets its 160 bytes, or None when none come in time."""

    def ask(self, timeout_s: float) -> bytes | None:
        """The block."""

    def close(self) -> None:
        """Let go of the wire."""


class TcpClient:
    """A Modbus TCP client, with a new connection after each time-out."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._connection: socket.socket | None = None
        self._transaction = 0

    def ask(self, timeout_s: float) -> bytes | None:
        """The block of one answer, which has to be that to this request."""
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
        """The block of one answer; what was left over of an earlier one is thrown away."""
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
        """The descriptor is the caller's."""


def tcp_proxy(deliveries: Iterator[Delivery], truth: queue.Queue[bool]) -> int:
    """The port at which a thread answers with these deliveries; says first whether each is spoilt."""
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
    """The reader's descriptor of a pseudo terminal at whose other end a thread answers."""
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
    """Asks a unit until it answers."""

    def ask() -> bytes:
        for _ in range(10):
            answer = client.ask(_UPSTREAM_TIMEOUT_S)
            if answer:
                return answer
        raise RuntimeError("the unit does not answer")

    return ask


def raw_terminal() -> tuple[int, int]:
    """Both ends of a pseudo terminal that hands bytes on as they are."""
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
    register = 0xFFFF
    for byte in frame:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
    return frame + struct.pack("<H", register)
