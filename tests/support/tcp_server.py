"""A TCP server on loopback that leaves no connection behind."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Self

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]

_TURNS_OF_AN_ACCEPT = 5
"""Of the loop, from the connection's acceptance to its call of ``_begin``."""


class TcpServer:
    """``async with``: ``serve`` runs for each connection, and is cancelled at the end.

    A connection that is being accepted at that moment is closed too. asyncio forgets such a one when the loop
    ends: its warnings come with the next garbage collection, in any other test.
    """

    def __init__(self, serve: Serve, port: int = 0, limit: int = 1 << 16) -> None:
        self.port = port
        self._serve, self._limit = serve, limit
        self._connections: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._begin, "127.0.0.1", self.port, limit=self._limit)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        for listening in self._server.sockets:
            asyncio.get_running_loop().remove_reader(listening.fileno())
        for _turn in range(_TURNS_OF_AN_ACCEPT):
            await asyncio.sleep(0)
        self._server.close()
        self.hang_up()
        await asyncio.gather(*self._connections, return_exceptions=True)
        for writer in self._connections.values():
            writer.close()
        await asyncio.sleep(0)

    def hang_up(self) -> None:
        """End all connections."""
        for task in self._connections:
            task.cancel()

    def _begin(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections[asyncio.ensure_future(self._run(reader, writer))] = writer

    async def _run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._serve(reader, writer)
        except (OSError, EOFError, asyncio.CancelledError):
            pass
        finally:
            writer.close()
