"""History queries of the interfaces: limited in time; they block neither the event loop nor each other."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from altd.history.reader import HistoryTimeoutError, Reader
from altd.history.schema import UnusableFileError
from altd.runtime.threads import DeviceThread

Result = TypeVar("Result")

QUERY_TIMEOUT_S = 2.0
"""Time limit of one query; a query can delay the write-ahead log's transfer into the file for this long."""

MAX_WAITING = 8
"""Maximum number of queries that wait for the disk at once."""


class NoHistoryError(Exception):
    """The history cannot be read now; the message gives the reason."""


class History:
    """History of the unit for interfaces. ``unavailable``: why there is none; empty if there is one.

    If ``serial`` identifies this unit, a file of another unit is refused. Such a file can be in this place
    until it is moved aside, or while the other unit's daemon writes it.
    """

    def __init__(self, path: Path | None, unavailable: str = "", serial: str | None = None) -> None:
        self.path = path
        self.serial = serial
        self.unavailable = unavailable if path is None else ""
        self.waiting = 0
        """Number of unanswered queries."""
        self._thread: DeviceThread | None = None

    async def ask(self, query: Callable[[Reader], Result]) -> Result:
        """Run a query on an open file in a thread; raises the query's errors and NoHistoryError."""
        if self.path is None:
            raise NoHistoryError(self.unavailable)
        if self.waiting >= MAX_WAITING:
            raise NoHistoryError(f"{self.waiting} ask the history already")
        if self._thread is None:
            self._thread = DeviceThread("history queries")
        self.waiting += 1
        try:
            return await self._thread.call(
                _answer, self.path, self.serial, query, within_s=MAX_WAITING * QUERY_TIMEOUT_S
            )
        except HistoryTimeoutError as error:
            raise NoHistoryError(f"the query was given up: {error}") from error
        except TimeoutError as error:
            raise NoHistoryError("the disk does not answer") from error
        except UnusableFileError as error:
            raise NoHistoryError(f"the history {error}") from error
        except OSError as error:
            raise NoHistoryError(f"the history cannot be read: {error.strerror or error}") from error
        except sqlite3.Error as error:
            raise NoHistoryError(f"the history cannot be read: {error}") from error
        finally:
            self.waiting -= 1

    async def end(self) -> None:
        """Stop the query thread."""
        thread, self._thread = self._thread, None
        if thread is not None:
            await thread.end(lambda: None, QUERY_TIMEOUT_S)


def _answer(path: Path, serial: str | None, query: Callable[[Reader], Result]) -> Result:
    with Reader(path, QUERY_TIMEOUT_S) as reader:
        if serial is not None:
            reader.check_unit(serial)
        return query(reader)
