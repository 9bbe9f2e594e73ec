"""Writing a file whole or not at all: beside its place, and then under its name.

Only a regular file is replaced. A device, a pipe or a folder would be lost, and behind a symbolic link may be
anything: it is named to the person, who can name that file.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from altd.errors import BadInputError
from altd.files.reading import kind_of, refusing


def check_replaceable(path: Path) -> None:
    """Say before any work is done what would stop ``write_file``; raises BadInputError."""
    try:
        _check_is_replaceable(path)
        if not path.parent.is_dir():
            raise BadInputError(path, "its folder does not exist")
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise BadInputError(path, f"its folder cannot be written{refusing(path.parent)}")
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be written") from error
    except ValueError as error:  # a NUL, or letters that the file system does not have
        raise BadInputError(path, "is no path") from error


def write_file(path: Path, content: bytes) -> None:
    """Make or replace a regular file; raises BadInputError, and then the old one is as it was."""
    with replacing(path) as file:
        file.write(content)


def replace_file(path: Path, content: bytes) -> None:
    """The same, with OSError when the disk refuses."""
    with _replaced(path) as file:
        file.write(content)


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file to write into, beside its place; it gets there when the block ends normally.

    Else nothing is left of it, and an older one is as it was. Raises BadInputError for what cannot be
    replaced, and in place of an OSError.
    """
    try:
        with _replaced(path) as file:
            yield file
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be written") from error


def write_files(files: Mapping[Path, bytes]) -> None:
    """Make or replace regular files, all or none.

    Raises OSError, and BadInputError for what cannot be replaced; then all are as they were.
    """
    written: dict[Path, Path] = {}
    older: dict[Path, bytes | None] = {}
    try:
        for path, content in files.items():
            written[path] = _write_beside(path, content)
        for path, temporary in written.items():
            older[path] = path.read_bytes() if path.exists() else None
            temporary.replace(path)
    except BaseException:
        for path, content_before in older.items():
            if content_before is None:
                path.unlink(missing_ok=True)
            else:
                replace_file(path, content_before)
        raise
    finally:
        for temporary in written.values():
            temporary.unlink(missing_ok=True)


def _write_beside(path: Path, content: bytes) -> Path:
    """A new file in the same folder, on the disk; nothing is left of it when that fails."""
    with _opened_beside(path) as (file, temporary):
        file.write(content)
    return temporary


@contextmanager
def _replaced(path: Path) -> Iterator[BinaryIO]:
    """A file to write into that gets to its place when the block ends normally; else nothing is left."""
    with _opened_beside(path) as (file, temporary):
        yield file
    try:
        temporary.replace(path)
    except BaseException:
        temporary.unlink()
        raise


@contextmanager
def _opened_beside(path: Path) -> Iterator[tuple[BinaryIO, Path]]:
    """A new file in the same folder, and its name; on the disk when the block ends, gone when it fails.

    With the mode and the owner that ``path`` shall have: those of the file that it will replace, or what the
    umask leaves of 0666.
    """
    old = _check_is_replaceable(path)
    temporary = path.with_name(f".{path.name[:200]}.{secrets.token_hex(4)}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(temporary, flags, 0o666 if old is None else 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if old is not None:
                with suppress(PermissionError):  # of another owner; only root may give files away
                    os.fchown(descriptor, old.st_uid, old.st_gid)
                os.fchmod(descriptor, old.st_mode & 0o777)
            yield file, temporary
            file.flush()
            os.fsync(descriptor)
    except BaseException:
        temporary.unlink()
        raise


def _check_is_replaceable(path: Path) -> os.stat_result | None:
    """The file at the path now: a regular file, or none yet."""
    try:
        now = path.lstat()
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(now.st_mode):
        raise BadInputError(path, f"is a symbolic link: name the file that it points to, {path.readlink()}")
    if not stat.S_ISREG(now.st_mode):
        raise BadInputError(path, f"is {kind_of(now.st_mode)}, not a file that can be replaced")
    return now
