"""Opening a history file for writing by one daemon or for reading, and handling of damaged files."""

from __future__ import annotations

import fcntl
import glob
import os
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from urllib.parse import quote

from altd.errors import one_line
from altd.history.schema import (
    VERSION,
    DamagedFileError,
    ForeignFileError,
    UnusableFileError,
    check_tables,
    migrate,
    version_of,
)

WAL_PAGES = 1000
"""Size of the write-ahead log, in pages of 4096 bytes, at which its pages are transferred into the file."""

MAX_FILES_ASIDE = 3
"""Maximum number of files moved aside; a disk that damages every file must not fill up with them."""

DAMAGED, FOREIGN = "damaged", "of-another-unit"
"""Suffix of a file that was moved aside."""

_MODE = 0o600
"""Permissions of the file and SQLite's files next to it, whatever the umask: it records users' requests."""

_BUSY_TIMEOUT_S = 0.2
_MAX_VALUE_BYTES = 1 << 20
_BESIDE = ("-wal", "-shm")
_DAMAGED_CODES = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}


@contextmanager
def typed_damage() -> Iterator[None]:
    """Convert the error of a value that Python cannot read as text or number to DamagedFileError."""
    try:
        yield
    except (ValueError, TypeError, OverflowError) as error:
        raise DamagedFileError(f"is damaged: {one_line(str(error))[:200]}") from error


def is_damage(error: sqlite3.Error) -> bool:
    """Whether SQLite reports a fault of the file itself, not of the disk or of another program."""
    code = getattr(error, "sqlite_errorcode", None)
    return code is not None and code & 0xFF in _DAMAGED_CODES


def check_folder(path: Path) -> None:
    """Raise UnusableFileError if the folder of a history does not exist or cannot be written."""
    if not path.parent.is_dir():
        raise UnusableFileError(f"the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise UnusableFileError(f"the folder {path.parent} cannot be written")


def open_to_write(path: Path) -> sqlite3.Connection:
    """Open an existing history of any version, migrated to the newest, or create a new one.

    Each commit is on the disk when it returns (WAL, ``synchronous = FULL``). Raises UnusableFileError,
    OSError and sqlite3.Error.
    """
    check_folder(path)
    if os.path.lexists(path):
        _check_regular(path)
    _make_private(path)
    connection = _connected(path, "rw")
    try:
        version = version_of(connection)
        if version == 0:
            connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
        if mode != "wal":
            raise UnusableFileError("its file system gives no write-ahead log")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA wal_autocheckpoint = {WAL_PAGES}")
        connection.execute(f"PRAGMA journal_size_limit = {WAL_PAGES * 4096}")
        migrate(connection, version)
        check_tables(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def is_private(path: Path) -> bool:
    """Whether only its owner may read and write a history."""
    return not stat.S_IMODE(path.stat().st_mode) & ~_MODE


def _make_private(path: Path) -> None:
    """Restrict the history and SQLite's files to their owner; create the history if it does not exist."""
    with suppress(FileExistsError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _MODE))
    for each in (path, *(path.with_name(path.name + ending) for ending in _BESIDE)):
        if each.exists() and not is_private(each):
            with suppress(PermissionError):  # owned by another user, or a file system without permissions
                each.chmod(_MODE)


def check_pages(connection: sqlite3.Connection) -> None:
    """Check every page of the file (``quick_check``); raises DamagedFileError with the fault."""
    (said,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if said != "ok":
        raise DamagedFileError(f"is damaged: {' '.join(str(said).split())[:200]}")


def open_to_read(path: Path) -> sqlite3.Connection:
    """Open a history read-only: of a running daemon, of one that ended, or a lone copy of its file.

    Raises UnusableFileError for a file that is not a history of this version, OSError and sqlite3.Error.
    """
    _check_regular(path)
    try:
        return _checked(_connected(path, "ro"))
    except sqlite3.OperationalError as error:
        if not _is_lone_copy(path, error):
            raise
    return _checked(_connected(path, "ro&immutable=1"))


def set_aside(path: Path, error: Exception) -> Path | None:
    """Move a file aside if ``error`` shows that it is damaged or of another unit; None: not moved.

    Raises the same errors as ``move_aside``.
    """
    if isinstance(error, ForeignFileError):
        return move_aside(path, FOREIGN)
    if isinstance(error, DamagedFileError) or (isinstance(error, sqlite3.Error) and is_damage(error)):
        return move_aside(path, DAMAGED)
    return None


def move_aside(path: Path, what: str) -> Path:
    """Rename a file that is ``DAMAGED`` or ``FOREIGN``, and SQLite's files next to it.

    Returns the new name. Raises UnusableFileError if too many were moved aside before, and OSError.
    """
    earlier = [of.name for of in path.parent.glob(f"{glob.escape(path.name)}.{what}-*")]
    if sum(not name.endswith(_BESIDE) for name in earlier) >= MAX_FILES_ASIDE:
        before = f"is {what.replace('-', ' ')}, as {MAX_FILES_ASIDE} before it"
        raise UnusableFileError(f"{before}: move {path}.{what}-* away")
    when = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
    aside = path.with_name(f"{path.name}.{what}-{when}")
    for ending in _BESIDE:
        beside = path.with_name(path.name + ending)
        if beside.exists():
            beside.replace(aside.with_name(aside.name + ending))
    path.replace(aside)
    return aside


class transaction:  # noqa: N801  used as a statement
    """Context manager from ``BEGIN IMMEDIATE`` to ``COMMIT``, or ``ROLLBACK`` after a failure."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        self._connection.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._connection.execute("COMMIT")
        elif self._connection.in_transaction:
            self._connection.execute("ROLLBACK")


def touched(path: Path) -> tuple[object, ...]:
    """Return a state that changes when a history's files are replaced, deleted or written.

    Readers also map the index of the log into memory, so only the identity of that file counts.
    """
    files = (_stat(path), _stat(path.with_name(f"{path.name}-wal")))
    index = _stat(path.with_name(f"{path.name}-shm"))
    kept = [each and (each.st_dev, each.st_ino, each.st_size, each.st_mtime_ns) for each in files]
    return (*kept, index and (index.st_dev, index.st_ino))


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(
        f"file:{quote(str(path.absolute()))}?mode={mode}",
        uri=True,
        isolation_level=None,
        timeout=_BUSY_TIMEOUT_S,
        check_same_thread=False,
    )
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE_BYTES)
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    return connection


def _checked(connection: sqlite3.Connection) -> sqlite3.Connection:
    """Return the connection if its file is a history of this version; otherwise close it and raise."""
    try:
        with typed_damage():
            version = version_of(connection)
        if version == 0:
            raise UnusableFileError("is an empty history")
        if version < VERSION:
            raise UnusableFileError(
                f"is of version {version}, this program reads {VERSION}: a daemon that starts mends that"
            )
        with typed_damage():
            check_tables(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _check_regular(path: Path) -> None:
    if not stat.S_ISREG(path.stat().st_mode):
        raise UnusableFileError("is not a regular file")


def _is_lone_copy(path: Path, error: sqlite3.OperationalError) -> bool:
    """Whether SQLite only failed to create its files next to a copy in a read-only folder."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
    is_refused = code in {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY}
    return is_refused and not any(path.with_name(path.name + ending).exists() for ending in _BESIDE)


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None


class WriteLock:
    """Lock file next to a history, so that only one daemon writes it.

    Held until it is released or its process ends. Raises OSError, and UnusableFileError while another daemon
    holds it.

    SQLite itself would let two daemons write alternately: their measurements would be mixed, and each would
    treat the other as crashed.
    """

    def __init__(self, history: Path) -> None:
        path = history.with_name(f"{history.name}.lock")
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, _MODE)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise UnusableFileError("another daemon writes it") from None
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)
