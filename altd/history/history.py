"""The queries of the interfaces to the history: bounded; none holds the event loop or another one up."""

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
"""Of one query: so long it may keep the write-ahead log from the file."""

MAX_WAITING = 8
"""More do not wait for the disk at once."""


class NoHistoryError(Exception):
    """The history cannot be read now; the sentence says why."""


class History:
    """The history of the unit, for interfaces. ``unavailable`` says why there is none; empty: there is one.

    Where ``serial`` says which unit it is, a file of another one is refused: until it is moved aside, or
    while the other's daemon writes it, it lies in the place of this unit's.
    """

    def __init__(self, path: Path | None, unavailable: str = "", serial: str | None = None) -> None:
        self.path = path
        self.serial = serial
        self.unavailable = unavailable if path is None else ""
        self.waiting = 0
        """Queries that are not answered yet."""
        self._thread: DeviceThread | None = None

    async def ask(self, query: Callable[[Reader], Result]) -> Result:
        """The result of a query on an open file, in a thread; raises what it raises, and NoHistoryError."""
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
        """No more is asked."""
        thread, self._thread = self._thread, None
        if thread is not None:
            await thread.end(lambda: None, QUERY_TIMEOUT_S)


def _answer(path: Path, serial: str | None, query: Callable[[Reader], Result]) -> Result:
    with Reader(path, QUERY_TIMEOUT_S) as reader:
        if serial is not None:
            reader.check_unit(serial)
        return query(reader)
