"""The same answers on a socket in the file system: for ``altd status``, ``watch`` and ``selfcheck``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from altd.config import HttpSettings
from altd.history.history import History
from altd.local_socket.listening import listening
from altd.publish.http.publisher import HttpPublisher
from altd.status.board import Board
from altd.status.health import Component, Health


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
        """Serve until cancelled; raises OSError when the socket cannot be had."""
        with listening(self._path) as listener:
            await self.serve(listener, "for this computer alone", ready)
