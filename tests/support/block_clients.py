"""Raw clients of the checked messages: Modbus TCP and RTU for registers 200 to 279, and the telegram."""

import os
import select
import socket
import struct
import time
from collections.abc import Iterator

from benchmarks.poller import received
from hw_sim.inclinometer import crc

UNIT_ID = 1
READ = struct.pack(">BHH", 4, 200, 80)
"""Request for the checked block."""

_ANSWER_BYTES = 2 + 160


class TcpClient:
    """A Modbus TCP client, with a new connection after each timeout."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._connection: socket.socket | None = None
        self._transaction = 0

    def ask(self, timeout_s: float) -> bytes | None:
        """The 160 bytes of the block; none if they do not come in time, empty for another request's."""
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
        """The block, as of ``TcpClient``; remains of an earlier answer are discarded."""
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


def _framed(pdu: bytes) -> bytes:
    frame = bytes([UNIT_ID]) + pdu
    return frame + crc(frame)


def telegrams(descriptor: int) -> Iterator[bytes]:
    """Yield the telegrams that a unit writes to a terminal, each with three sentences."""
    heard = b""
    while True:
        heard += os.read(descriptor, 4096)
        while b"$PALTC" in heard and b"\r\n" in heard[heard.index(b"$PALTC") :]:
            end = heard.index(b"\r\n", heard.index(b"$PALTC")) + 2
            yield heard[heard.index(b"$PALTM") : end]
            heard = heard[end:]
