"""A history that a person names, open for a command; what is wrong with it is one line."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from altd.errors import BadInputError
from altd.history.reader import Reader
from altd.history.schema import UnusableFileError


@contextmanager
def opened(path: Path) -> Iterator[Reader]:
    """The history in that file; raises BadInputError for whatever it is that cannot be read."""
    try:
        with Reader(path) as reader:
            yield reader
    except UnusableFileError as error:
        raise BadInputError(path, str(error)) from error
    except sqlite3.Error as error:
        raise BadInputError(path, f"cannot be read: {error}") from error
    except FileNotFoundError as error:
        if error.filename is None or Path(error.filename) != path:
            raise
        raise BadInputError(path, "No such file or directory") from error
    except PermissionError as error:
        if error.filename is None or Path(error.filename) != path:
            raise
        raise BadInputError(path, "Permission denied: it is the daemon's and root's") from error
    except ValueError as error:  # a NUL in the path
        raise BadInputError(path, "is no path") from error
