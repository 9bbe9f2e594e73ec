"""A TCP proxy on loopback that can stop to forward, as a cable that is cut: nothing fails, nothing comes."""

import asyncio
import contextlib

from support.tcp_server import TcpServer


class Cable(TcpServer):
    """``async with``: from ``port`` to the unit's port."""

    def __init__(self, unit_port: int) -> None:
        super().__init__(self._connected)
        self._unit_port = unit_port
        self._whole = asyncio.Event()
        self._whole.set()

    def cut(self) -> None:
        self._whole.clear()

    def mend(self) -> None:
        self._whole.set()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        unit_reader, unit_writer = await asyncio.open_connection("127.0.0.1", self._unit_port)
        try:
            async with asyncio.TaskGroup() as both:
                both.create_task(self._forward(reader, unit_writer))
                both.create_task(self._forward(unit_reader, writer))
        except* (OSError, EOFError):
            pass
        finally:
            unit_writer.close()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1 << 16):
            await self._whole.wait()
            writer.write(data)
            await writer.drain()
        with contextlib.suppress(OSError):
            writer.close()
        raise EOFError
