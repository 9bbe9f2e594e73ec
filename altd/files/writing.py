"""Writing a file completely or not at all: first to a temporary file next to it, then renamed.

Only a regular file is replaced. A device, a pipe or a folder would be lost. A symbolic link may point to
anything: the error names its target, so that the user can name that file instead.
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
    """Check before any work is done whether ``write_file`` is possible; raises BadInputError."""
    try:
        _check_is_replaceable(path)
        if not path.parent.is_dir():
            raise BadInputError(path, "its folder does not exist")
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise BadInputError(path, f"its folder cannot be written{refusing(path.parent)}")
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be written") from error
    except ValueError as error:  # a NUL, or characters that the file system does not support
        raise BadInputError(path, "is not a path") from error


def write_file(path: Path, content: bytes) -> None:
    """Create or replace a regular file; raises BadInputError and then leaves the old one unchanged."""
    with replacing(path) as file:
        file.write(content)


def replace_file(path: Path, content: bytes) -> None:
    """Create or replace a regular file; raises OSError when the disk refuses."""
    with _replaced(path) as file:
        file.write(content)


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file next to ``path``; it replaces ``path`` when the block ends normally.

    Otherwise it is deleted, and an older file is unchanged. Raises BadInputError for a path that cannot be
    replaced, and in place of an OSError.
    """
    try:
        with _replaced(path) as file:
            yield file
    except OSError as error:
        raise BadInputError(path, error.strerror or "cannot be written") from error


def write_files(files: Mapping[Path, bytes]) -> None:
    """Create or replace regular files, all or none.

    Raises OSError, and BadInputError for a path that cannot be replaced; all files are then as before.
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
    """Write a new file in the same folder, on the disk; it is deleted on failure."""
    with _temporary_file(path) as (file, temporary):
        file.write(content)
    return temporary


@contextmanager
def _replaced(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file; it replaces ``path`` if the block ends normally, else it is deleted."""
    with _temporary_file(path) as (file, temporary):
        yield file
    try:
        temporary.replace(path)
    except BaseException:
        temporary.unlink()
        raise


@contextmanager
def _temporary_file(path: Path) -> Iterator[tuple[BinaryIO, Path]]:
    """Open a new file in the same folder; on the disk when the block ends, deleted when it fails.

    It has the mode and the owner that ``path`` shall have: those of the replaced file, or 0666 reduced by the
    umask.
    """
    old = _check_is_replaceable(path)
    temporary = path.with_name(f".{path.name[:200]}.{secrets.token_hex(4)}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(temporary, flags, 0o666 if old is None else 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if old is not None:
                with suppress(PermissionError):  # another owner's file; only root may change owners
                    os.fchown(descriptor, old.st_uid, old.st_gid)
                os.fchmod(descriptor, old.st_mode & 0o777)
            yield file, temporary
            file.flush()
            os.fsync(descriptor)
    except BaseException:
        temporary.unlink()
        raise


def _check_is_replaceable(path: Path) -> os.stat_result | None:
    """Return the status of the regular file at the path; None: there is no file yet."""
    try:
        now = path.lstat()
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(now.st_mode):
        raise BadInputError(path, f"is a symbolic link: name the file that it points to, {path.readlink()}")
    if not stat.S_ISREG(now.st_mode):
        raise BadInputError(path, f"is {kind_of(now.st_mode)}, not a file that can be replaced")
    return now
