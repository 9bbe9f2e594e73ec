"""What a running daemon says of its unit through the local socket, checked."""

from __future__ import annotations

import http.client
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from altd.instruments.beam.quantities import QUANTITIES
from altd.local_socket.asking import NoAnswerError, ask
from altd.terminal.documents import (
    Reading,
    SelfCheckDocument,
    StatusDocument,
    TargetsDocument,
    reading_of,
    self_check_of,
    status_of,
    targets_of,
)

Document = TypeVar("Document")

_GOOD = (http.client.OK, http.client.SERVICE_UNAVAILABLE)
"""503 is how a measurement is answered while there is none; whatever else is said so has other keys."""


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """The daemon at a socket; each question raises NoAnswerError, and ends within ``timeout_s``."""

    path: Path
    timeout_s: float

    def reading(self) -> tuple[Reading | None, object]:
        """The latest measurement and its document; None: nothing was measured so far."""
        return self._asked("/api/v1/measurement", lambda document: reading_of(document, QUANTITIES))

    def status(self) -> tuple[StatusDocument, object]:
        """The unit's state, causes, availability and components."""
        return self._asked("/api/v1/status", status_of)

    def self_check(self) -> tuple[SelfCheckDocument, object]:
        """The last self-check."""
        return self._asked("/api/v1/self-check", self_check_of)

    def targets(self) -> tuple[TargetsDocument, object]:
        """Where the targets are measured."""
        return self._asked("/api/v1/targets", targets_of)

    def _asked(self, target: str, understood: Callable[[object], Document]) -> tuple[Document, object]:
        status, document = ask(self.path, target, self.timeout_s)
        if status not in _GOOD:
            raise NoAnswerError(f"what answers at {self.path} gives no {target}: it answers {status}")
        try:
            return understood(document), document
        except ValueError as error:
            raise NoAnswerError(f"what answers at {self.path} gives no {target}: {error}") from error
