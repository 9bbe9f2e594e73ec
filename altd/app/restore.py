"""``altd restore``: puts the files of a backup in their places after checking all of them."""

from __future__ import annotations

import errno
import fcntl
import grp
import gzip
import hashlib
import io
import os
import pwd
import re
import shutil
import socket
import tarfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, cast

from altd.app.backup import INDEX, MAX_FILE_BYTES, MODE, Entry, Index, Places, check_index
from altd.app.keeping import FILE_NAME, history_to_read
from altd.app.operating_time import file_in, has_more
from altd.app.parts import check_files
from altd.app.settings import (
    SERVICE_SOCKET,
    load_settings,
    restore_marker,
    service_name,
    socket_to_ask,
)
from altd.errors import BadInputError
from altd.files.documents import parse_json, parse_toml
from altd.files.reading import read_file
from altd.files.writing import check_replaceable, write_file
from altd.history.opening import WriteLock
from altd.history.schema import UnusableFileError

BEFORE_RESTORE = ".before-restore"
_STAGING = ".restore-"
_ENDINGS = ("-wal", "-shm", "")
"""Endings of the files of one history; an old log would be written into the restored history."""
_MAX_INDEX_BYTES = 1 << 20
_MAX_HEADER_BYTES = 1 << 16
"""Maximum number of bytes from one file of an archive to the next: a header may declare any length."""
_PIECE_BYTES = 1 << 20


def restore(source: Path, settings: Path) -> str:
    """Restore the files of an archive, the settings to ``settings``; return the unit's serial.

    All files are first read and checked in temporary folders: a refused archive changes nothing. A replaced
    file is kept as ``….before-restore``, with a number if there is one already. While files are replaced, a
    marker keeps the daemon from starting; it remains if the restore is interrupted, until one is complete.
    Raises BadInputError.
    """
    places = Places(settings)
    with ExitStack() as stack:
        _check_stopped(places, stack)
        _remove_leftovers(places, stack)
        staged = Places(settings)
        try:
            index = _read(source, staged, places, stack)
        except OSError as error:
            raise BadInputError(error.filename or source, error.strerror or str(error)) from error
        _check_content(index, staged, places, source)
        members = sorted(index.files, key=lambda member: member == index.settings)
        operated = file_in(Path("data"), index.serial)
        if str(operated) in members and has_more(places.path(str(operated)), staged.path(str(operated))):
            members.remove(str(operated))  # it is of the housing: a restore does not turn it back
        for member in members:
            target = places.path(member)
            target.parent.mkdir(parents=True, exist_ok=True)
            check_replaceable(target)
        marker, targets = restore_marker(settings), [places.path(member) for member in members]
        number = _number_of(marker, targets)
        write_file(marker, f"{number}\n".encode())
        os.sync()
        try:
            for member, target in zip(members, targets, strict=True):
                _keep(target, index.files[member], number)
                staged.path(member).replace(target)
            os.sync()
            marker.unlink()
        except OSError as error:
            raise BadInputError(error.filename, f"{error.strerror}: repeat the restore") from error
    return index.serial


def _kept(target: Path, number: int, ending: str) -> Path:
    """Return the place at which a replaced file is kept by the restore with this number."""
    numbered = BEFORE_RESTORE if number == 1 else f"{BEFORE_RESTORE}.{number}"
    return target.with_name(target.name + numbered + ending)


def _number_of(marker: Path, targets: Sequence[Path]) -> int:
    """Return the number of the interrupted restore, which is continued, or else one with no kept file."""
    with suppress(FileNotFoundError, ValueError):
        return int(marker.read_text())
    number = 1
    while any(os.path.lexists(_kept(target, number, ending)) for target in targets for ending in _ENDINGS):
        number += 1
    return number


def _keep(target: Path, restored: Entry, number: int) -> None:
    """Move a file with its logs away, unless its content is that to be restored; overwrite nothing.

    Logs that an interrupted restore has moved stay beside their history: it gets the same number.
    """
    old = {ending: target.with_name(target.name + ending) for ending in _ENDINGS}
    there = [ending for ending in _ENDINGS if os.path.lexists(old[ending])]
    if there == [""] and target.is_file() and target.stat().st_size == restored.size:
        with target.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() == restored.sha256:
                return
    while any(os.path.lexists(_kept(target, number, ending)) for ending in there):
        number += 1
    for ending in there:
        old[ending].replace(_kept(target, number, ending))


def _remove_leftovers(places: Places, stack: ExitStack) -> None:
    """Remove the temporary folders of interrupted restores; raises BadInputError while another one runs."""
    folder = places.settings.parent
    if folder.is_dir():
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        stack.callback(os.close, lock)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BadInputError(folder, "another restore runs") from error
    for each in places.folders.values():
        for left in each.glob(f"{_STAGING}*"):
            shutil.rmtree(left, ignore_errors=True)


def _check_stopped(places: Places, stack: ExitStack) -> None:
    """Raise BadInputError if a daemon runs, which has these files open; lock the history against it."""
    try:
        config = load_settings(places.settings)
        place, history = socket_to_ask(config, places.settings), history_to_read(config, places.settings)
    except BadInputError:  # the settings are missing, or unusable and to be replaced
        place = Path("/run", service_name(places.settings), SERVICE_SOCKET.name)
        history = places.folders["data"] / FILE_NAME
    with socket.socket(socket.AF_UNIX) as trial, suppress(FileNotFoundError, ConnectionRefusedError):
        trial.setblocking(False)  # the queue of a hanging daemon may be full
        with suppress(BlockingIOError):
            trial.connect(str(place))
        raise BadInputError(place, "a daemon runs: stop it first (systemctl stop altd)")
    if not history.with_name(f"{history.name}.lock").exists():
        return
    try:
        stack.callback(WriteLock(history).release)
    except (UnusableFileError, OSError) as error:
        raise BadInputError(history, f"{error}: stop it first (systemctl stop altd)") from error


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        folder.mkdir(parents=True, mode=0o755)
        if folder.parent == Path("/var/lib"):
            with suppress(LookupError, PermissionError):
                shutil.chown(folder, "altd", "altd")


class _Limited(io.RawIOBase):
    """Stream from which at most ``left`` more bytes may be read."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.left = _MAX_HEADER_BYTES

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= self.left:
            raise ValueError("a header is too long")
        self.left -= size
        return self._stream.read(size)


def _read(source: Path, staged: Places, places: Places, stack: ExitStack) -> Index:
    """Write all files of an archive to the staging folders; raises BadInputError, OSError."""
    try:
        with gzip.open(source) as unpacked:
            stream = _Limited(cast("BinaryIO", unpacked))
            with tarfile.open(fileobj=stream, mode="r|") as archive:
                members = _regular(archive, stream)
                name, size, content = next(members, ("", 0, io.BytesIO()))
                if name != INDEX or size > _MAX_INDEX_BYTES:
                    raise BadInputError(source, "is not an altd backup")
                index = check_index(parse_json(content.read()), source)
                _check_serial(index.serial, places.settings)
                for folder in {member.partition("/")[0] for member in index.files}:
                    _make_folder(places.folders[folder])
                    work = TemporaryDirectory(dir=places.folders[folder], prefix=_STAGING)
                    staged.folders[folder] = Path(stack.enter_context(work))
                size = sum(entry.size for entry in index.files.values())
                if size > shutil.disk_usage(places.settings.parent).free:
                    raise BadInputError(source, f"{size} bytes: {os.strerror(errno.ENOSPC)}")
                missing = dict(index.files)
                for name, size, content in members:
                    entry = missing.pop(name, None)
                    if entry is None or entry.size != size:
                        raise ValueError(f"{name} is not the file of its index")
                    _stage(staged.path(name), content, entry)
            if len(unpacked.read(_MAX_HEADER_BYTES)) == _MAX_HEADER_BYTES:  # gzip checks its sum at the end
                raise ValueError("it does not end")
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError, OverflowError) as error:
        raise BadInputError(source, f"is damaged or not an altd backup: {error}") from error
    if missing:
        raise BadInputError(source, f"is damaged: it ends before {min(missing)}")
    return index


def _regular(archive: tarfile.TarFile, stream: _Limited) -> Iterator[tuple[str, int, BinaryIO]]:
    """Yield name, size and content of each member; raises ValueError if it is not a regular file."""
    while (member := archive.next()) is not None:
        content = archive.extractfile(member) if member.isreg() and not member.issparse() else None
        if content is None:
            raise ValueError(f"{member.name} is not a regular file")
        stream.left = member.size + _MAX_HEADER_BYTES
        yield member.name, member.size, cast("BinaryIO", content)


def _stage(path: Path, content: BinaryIO, entry: Entry) -> None:
    digest = hashlib.sha256()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o755)
    with path.open("xb") as file:
        os.fchmod(file.fileno(), entry.mode & MODE)
        with suppress(LookupError, PermissionError):
            os.fchown(file.fileno(), pwd.getpwnam(entry.user).pw_uid, grp.getgrnam(entry.group).gr_gid)
        while piece := content.read(_PIECE_BYTES):
            digest.update(piece)
            file.write(piece)
    if digest.hexdigest() != entry.sha256:
        raise ValueError(f"the sum of {path.name} does not match")


def _check_serial(serial: str, settings: Path) -> None:
    """Raise BadInputError if the existing settings are of another unit, or their unit cannot be read."""
    if not os.path.lexists(settings):
        return
    try:
        unit: Any = parse_toml(read_file(settings, MAX_FILE_BYTES)).get("unit")
    except ValueError as error:
        raise BadInputError(
            settings, f"the serial number of its unit cannot be read; move it away first: {error}"
        ) from error
    found = unit.get("serial") if isinstance(unit, dict) else None
    if found != serial:
        raise BadInputError(
            settings, f"is of unit {found!r}, the backup is of {serial!r}; move it away first"
        )


def _check_content(index: Index, staged: Places, places: Places, source: Path) -> None:
    """Raise BadInputError for settings, a calibration or credentials that the daemon could not use."""
    text = staged.path(index.settings).read_bytes()
    trial = staged.path(index.settings).with_name(".trial.toml")
    for name, folder in places.folders.items():
        text = text.replace(f"{folder}/".encode(), f"{staged.folders[name]}/".encode())
    trial.write_bytes(text)
    try:
        config = load_settings(trial)
        _, errors = check_files(config)
        if config.unit.serial != index.serial:
            errors = [BadInputError(trial, f"unit.serial: the backup is of {index.serial!r}")]
        if errors:
            raise errors[0]
    except BadInputError as error:
        said = re.sub(
            r"\.restore-[^/]*/(\.trial\.toml)?",
            lambda found: index.settings.split("/")[-1] * bool(found[1]),
            str(error),
        )
        raise BadInputError(source, said) from error
    if places.path(index.settings) != places.settings:
        raise BadInputError(places.settings, f"the settings of the backup are {places.path(index.settings)}")
