"""Opening a history file: for writing, by one daemon, for reading, and the treatment of a damaged one."""

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
"""Of 4096 bytes: so large the write-ahead log grows before its pages are put into the file."""

MAX_FILES_ASIDE = 3
"""More are not put beside each other: a disk that damages every file shall not be filled with them."""

DAMAGED, FOREIGN = "damaged", "of-another-unit"
"""The suffix of a file that was moved aside."""

_MODE = 0o600
"""Of the file and what SQLite keeps beside it, whatever the umask: it names who asked for what."""

_BUSY_TIMEOUT_S = 0.2
_MAX_VALUE_BYTES = 1 << 20
_BESIDE = ("-wal", "-shm")
_DAMAGED_CODES = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}


@contextmanager
def damage_told() -> Iterator[None]:
    """Refuse a value that is neither text nor a number in Python: DamagedFileError."""
    try:
        yield
    except (ValueError, TypeError, OverflowError) as error:
        raise DamagedFileError(f"is damaged: {one_line(str(error))[:200]}") from error


def is_damage(error: sqlite3.Error) -> bool:
    """Whether SQLite says that the file itself is wrong, and not the disk or another program."""
    code = getattr(error, "sqlite_errorcode", None)
    return code is not None and code & 0xFF in _DAMAGED_CODES


def check_folder(path: Path) -> None:
    """Raise UnusableFileError where nothing can be written beside a history."""
    if not path.parent.is_dir():
        raise UnusableFileError(f"the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise UnusableFileError(f"the folder {path.parent} cannot be written")


def open_to_write(path: Path) -> sqlite3.Connection:
    """A history that is there, of whichever version, brought to the newest; or a new one.

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
    """Whether its owner alone may read and write a history."""
    return not stat.S_IMODE(path.stat().st_mode) & ~_MODE


def _make_private(path: Path) -> None:
    """For its owner alone: what is there, and the file itself, which is made where it is not."""
    with suppress(FileExistsError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _MODE))
    for each in (path, *(path.with_name(path.name + ending) for ending in _BESIDE)):
        if each.exists() and not is_private(each):
            with suppress(PermissionError):  # of another owner, or of a file system without permissions
                each.chmod(_MODE)


def check_pages(connection: sqlite3.Connection) -> None:
    """Go through every page of the file (``quick_check``); raises DamagedFileError with what is wrong."""
    (said,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if said != "ok":
        raise DamagedFileError(f"is damaged: {' '.join(str(said).split())[:200]}")


def open_to_read(path: Path) -> sqlite3.Connection:
    """A history to read only: of a daemon that runs, of one that ended, or a copy of its file alone.

    Raises UnusableFileError for what is no history of this version, OSError and sqlite3.Error.
    """
    _check_regular(path)
    try:
        return _checked(_connected(path, "ro"))
    except sqlite3.OperationalError as error:
        if not _is_lone_copy(path, error):
            raise
    return _checked(_connected(path, "ro&immutable=1"))


def set_aside(path: Path, error: Exception) -> Path | None:
    """Move a file away if ``error`` shows that it is damaged or of another unit; None: it stays.

    Raises as ``move_aside`` does.
    """
    if isinstance(error, ForeignFileError):
        return move_aside(path, FOREIGN)
    if isinstance(error, DamagedFileError) or (isinstance(error, sqlite3.Error) and is_damage(error)):
        return move_aside(path, DAMAGED)
    return None


def move_aside(path: Path, what: str) -> Path:
    """Give a file that is ``DAMAGED`` or ``FOREIGN``, and what SQLite keeps beside it, another name.

    Returns that name. Raises UnusableFileError when there are too many already, OSError.
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
    """``BEGIN IMMEDIATE`` to ``COMMIT``, or ``ROLLBACK`` after a failure."""

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
    """The state that changes when a file of a history is replaced, deleted or written.

    Readers too map the index of the log into memory: of it, only the identity of the file counts.
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
    """The connection of a history of this version; any other one is closed."""
    try:
        with damage_told():
            version = version_of(connection)
        if version == 0:
            raise UnusableFileError("is an empty history")
        if version < VERSION:
            raise UnusableFileError(
                f"is of version {version}, this program reads {VERSION}: a daemon that starts mends that"
            )
        with damage_told():
            check_tables(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _check_regular(path: Path) -> None:
    if not stat.S_ISREG(path.stat().st_mode):
        raise UnusableFileError("is no regular file")


def _is_lone_copy(path: Path, error: sqlite3.OperationalError) -> bool:
    """Whether SQLite lacks only a place for its files beside a copy in a folder that cannot be written."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
    is_refused = code in {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY}
    return is_refused and not any(path.with_name(path.name + ending).exists() for ending in _BESIDE)


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None


class WriteLock:
    """The lock of the file beside a history: one daemon writes it.

    Held until it is released or its process ends. Raises OSError, and UnusableFileError while another
    holds it.

    SQLite would let two write by turns: their measurements would be mixed, and each would take the other
    for one that crashed.
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
        """Let others write."""
        os.close(self._descriptor)
