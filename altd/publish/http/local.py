"""The same answers on a socket in the file system: for ``altd status``, ``watch`` and ``selfcheck``."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from pathlib import Path

from altd.config import HttpSettings
from altd.history.history import History
from altd.local_socket.listening import identity_at, listening
from altd.publish.http.publisher import HttpPublisher
from altd.status.board import Board
from altd.status.health import Component, Health

_LOOK_INTERVAL_S = 1.0
"""Interval at which the socket's file is checked; clients cannot connect without it."""


class LocalPublisher(HttpPublisher):
    """Serves the unit's own computer; who may open the file may act, too."""

    is_local = True

    def __init__(
        self,
        path: Path,
        board: Board,
        health: Health,
        component: Component,
        history: History | None = None,
    ) -> None:
        super().__init__(HttpSettings(), board, health, component, history)
        self._path = path

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the socket cannot be had, or has lost its file."""
        with listening(self._path) as listener:
            made = identity_at(self._path)
            serving = asyncio.ensure_future(self.serve(listener, "for this computer alone", ready))
            try:
                while not (await asyncio.wait({serving}, timeout=_LOOK_INTERVAL_S))[0]:
                    if identity_at(self._path) != made:
                        raise OSError(errno.ENOENT, "the file of the socket was deleted or replaced")
                await serving
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
