"""Writing the history, one transaction per batch. All calls block and run in a dedicated thread."""

from __future__ import annotations

import secrets
import sqlite3
from dataclasses import replace
from pathlib import Path

from altd.history.facts import check_unit
from altd.history.open_store import OpenStore
from altd.history.opening import (
    WriteLock,
    check_folder,
    check_pages,
    is_private,
    open_to_write,
    set_aside,
    typed_damage,
)
from altd.history.records import About, Batch, Notice, Written
from altd.history.schema import MovedFileError, TouchedFileError, UnusableFileError
from altd.status.event_log import EventKind


class Store:
    """History of one daemon. After a failure the next batch opens the file again.

    A file that is damaged or of another unit is moved aside, and a new one is created. Each opening begins an
    epoch, so that earlier rows are never changed. A batch whose COMMIT failed may still be in the file: its
    items are then left out of the next batch. ``has_outbox``: summaries of 1 s are queued for an ingest.
    """

    def __init__(self, path: Path, max_bytes: int, about: About, has_outbox: bool = False) -> None:
        self.path = path
        self._max_bytes = max_bytes
        self._about = about
        self._has_outbox = has_outbox
        self._session = secrets.token_hex(8)
        self._unwritten: list[Notice] = []
        self._notices_left: list[Notice] = []
        self._open: OpenStore | None = None
        self._lock: WriteLock | None = None
        self._was_open = False
        self._batches = 0
        self._doubtful: dict[str, Batch] = {}
        """Batches whose COMMIT failed, by name, since the last one that succeeded."""

    def write(self, batch: Batch) -> Written:
        """Write a batch completely or not at all; raises OSError, sqlite3.Error and UnusableFileError."""
        try:
            if self._open is None:
                self._open = self._opened(batch)
            self._batches += 1
            name = f"{self._session} {self._batches}"
            self._open.write(self._without_written(batch, self._open), name)
            self._doubtful = {}
            notices, self._notices_left = [*self._notices_left, *self._open.take_notices()], []
            return self._open.after_commit(notices)
        except (OSError, sqlite3.Error, UnusableFileError) as error:
            if self._open is not None and self._open.is_committing:
                self._doubtful[name] = batch
            self._close_file()
            if (aside := set_aside(self.path, error)) is not None:
                text = f"the history before is kept as {aside.name}: {error}"
                self._unwritten.append(Notice(EventKind.HISTORY, text, {"file": str(aside)}))
                raise MovedFileError(f"{error}: moved to {aside}, new history file created") from error
            if isinstance(error, TouchedFileError):
                self._was_open = False  # its pages are checked before it is trusted again
                self._unwritten.append(Notice(EventKind.HISTORY, f"the history {error}"))
            raise
        except BaseException:  # a defect: the open summaries are not trusted either
            self._close_file()
            raise
        finally:
            if self._open is None:
                self._release()

    def _without_written(self, batch: Batch, opened: OpenStore) -> Batch:
        """Return the batch without what is in the file although its COMMIT failed."""
        if not self._doubtful:
            return batch
        last = opened.last_batch()
        self._doubtful = {name: each for name, each in self._doubtful.items() if name == last}
        written = {id(one) for each in self._doubtful.values() for one in (*each.items, *each.events)}
        return replace(
            batch,
            items=[item for item in batch.items if id(item) not in written],
            events=[event for event in batch.events if id(event) not in written],
        )

    def end(self, batch: Batch | None) -> None:
        """Write the last batch and mark the epoch as ended; failures are ignored."""
        try:
            if batch is not None:
                self.write(batch)
                if self._open is not None:
                    self._open.end(batch.wall_us)
        except (OSError, sqlite3.Error, UnusableFileError):
            return
        finally:
            self._close_file()
            self._release()

    def _opened(self, batch: Batch) -> OpenStore:
        check_folder(self.path)
        self._lock = WriteLock(self.path)
        is_new = not self.path.exists() or not self.path.stat().st_size
        with typed_damage():
            connection = open_to_write(self.path)
        try:
            with typed_damage():
                check_unit(connection, self._about.facts)
                opened = OpenStore(connection, self.path, self._max_bytes, self._about, self._has_outbox)
                if opened.epochs.was_interrupted and not self._was_open:
                    check_pages(connection)  # interrupted in another daemon, or by a power cut
                opened.begin(batch, self._session, [*self._unwritten, *_begun(self.path, is_new)])
            self._unwritten, self._notices_left = [], [*self._notices_left, *opened.take_notices()]
        except BaseException:
            connection.close()
            raise
        self._was_open = True
        return opened

    def _close_file(self) -> None:
        opened, self._open = self._open, None
        if opened is not None:
            opened.close()

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()


def _begun(path: Path, is_new: bool) -> list[Notice]:
    texts = ["new history file created"] if is_new else []
    if not is_private(path):
        texts.append("others may read the history, or write it: its permissions cannot be changed")
    return [Notice(EventKind.HISTORY, text, {"file": str(path)}) for text in texts]
