"""Modbus TCP as a raw socket speaks it, for tests; nothing of it comes from the product."""

import asyncio
import contextlib
import ssl
import struct
from collections.abc import AsyncIterator, Callable

import pytest

from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.records import Measurement

Measured = Callable[..., Measurement]

UNIT = 7
EVERYTHING = struct.pack(">BHH", 4, 0, 120)
ONE = struct.pack(">BHH", 4, 102, 2)
ONE_ANSWER = bytes.fromhex("04 04 12345678")


def frame(pdu: bytes, transaction: int = 1, unit: int = UNIT, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, len(pdu) + 1, unit) + pdu


class Client:
    """A controller that sends what it likes."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    async def hear(self) -> tuple[int, int, bytes]:
        """Transaction, unit and protocol data unit of the next answer."""
        async with asyncio.timeout(60):
            transaction, _, length, unit = struct.unpack(">HHHB", await self._reader.readexactly(7))
            return transaction, unit, await self._reader.readexactly(length - 1)

    async def ask(self, pdu: bytes, unit: int = UNIT) -> bytes:
        self.send(frame(pdu, unit=unit))
        return (await self.hear())[2]

    async def is_closed_without_an_answer(self) -> bool:
        """Closed, after an alert of TLS at most (RFC 8446, 6)."""
        async with asyncio.timeout(60):
            with contextlib.suppress(ConnectionError):
                heard = await self._reader.read()
                return heard == b"" or (heard[0] == 21 and len(heard) == 7)
        return True

    async def is_closed(self) -> bool:
        async with asyncio.timeout(60):
            with contextlib.suppress(ConnectionError):
                return await self._reader.read(1) == b""
        return True


@contextlib.asynccontextmanager
async def connected(
    tcp: ModbusTcpPublisher, address: str = "127.0.0.1", tls: ssl.SSLContext | None = None
) -> AsyncIterator[Client]:
    """A connection from an address of the loopback; at the end the server has released it, too."""
    reader, writer = await asyncio.open_connection("127.0.0.1", tcp.port, local_addr=(address, 0), ssl=tls)
    try:
        yield Client(reader, writer)
    finally:
        with contextlib.suppress(OSError):
            if tls is None:
                writer.write_eof()
                await reader.read()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def eventually(condition: Callable[[], bool]) -> None:
    for _ in range(2000):
        if condition():
            return
        await asyncio.sleep(0.001)
    pytest.fail("it did not come about in 2 s")


def words(pdu: bytes) -> tuple[int, ...]:
    assert pdu[1] == len(pdu) - 2
    return struct.unpack(f">{pdu[1] // 2}H", pdu[2:])
