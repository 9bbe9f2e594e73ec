"""The event loop's side of the outbox: the recorder fills it, a publisher empties it."""

from __future__ import annotations

from collections.abc import Sequence

from altd.history.history import History
from altd.history.reader import Reader
from altd.history.records import OutboxMark, QueuedSecond


class Outbox:
    """Seconds in the history that wait for an ingest. ``mark`` is None until the file is open."""

    def __init__(self, history: History) -> None:
        self._history = history
        self.mark: OutboxMark | None = None
        self.acknowledged: tuple[str, int] | None = None
        """Stream and sequence up to which the recorder may delete."""

    async def after(
        self, sequence: int, limit: int
    ) -> tuple[OutboxMark, Sequence[QueuedSecond], Sequence[str]]:
        """Return the complete seconds after a sequence, oldest first, and the keys of all quantities.

        Raises NoHistoryError, and ValueError while there is no mark.
        """
        mark = self.mark
        if mark is None:
            raise ValueError("the outbox is not open")

        def query(reader: Reader) -> tuple[Sequence[QueuedSecond], Sequence[str]]:
            return reader.queued(mark.stream, sequence, mark.complete, limit), list(reader.summarised)

        return mark, *await self._history.ask(query)
