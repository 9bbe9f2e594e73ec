"""``altd backup`` and ``altd restore``: the files that make a unit what it is, in one archive.

The archive, ``altd-backup/1``, is a tar with gzip. Its first member, ``backup.json``, lists the others with
their sums: ``settings/…`` of the folder of the settings, ``data/…`` of that of the service. It has secrets.
"""

from __future__ import annotations

import errno
import grp
import gzip
import hashlib
import io
import os
import pwd
import re
import shutil
import socket
import sqlite3
import tarfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, BinaryIO, Literal, cast
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field

from altd import __version__
from altd.app.keeping import FILE_NAME, history_to_read
from altd.app.parts import check_files
from altd.app.settings import SERVICE_SOCKET, load_settings, service_folder, service_name, socket_to_ask
from altd.errors import BadInputError
from altd.files.documents import checksum_of, line_of, parse_json, parse_toml
from altd.files.reading import read_file
from altd.files.writing import check_replaceable, replacing
from altd.history.opening import WriteLock
from altd.history.schema import UnusableFileError
from altd.records import utc_text
from altd.status.proof import unit_number

BEFORE_RESTORE = ".before-restore"
_INDEX = "backup.json"
_MAX_INDEX_BYTES = 1 << 20
_MAX_FILE_BYTES = 1 << 28
"""Of all but the history: a calibration has some megabytes."""
_MAX_HEADER_BYTES = 1 << 16
"""From one file of an archive to the next: a header may announce any length."""
_PIECE_BYTES = 1 << 20
_MODE = 0o664

_MEMBER = r"(settings|data)(/[^/.\x00-\x1f][^/\x00-\x1f]{0,200}){1,8}"
"""No part begins with a dot: none leads out of its folder."""
_Member = Annotated[str, Field(pattern=f"^{_MEMBER}$")]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    size: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    mode: int
    user: str
    group: str


class _Index(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    format: Literal["altd-backup/1"]
    version: str
    created: str
    serial: str
    settings: _Member
    files: Mapping[_Member, _Entry]
    checksum: str


class _Places:
    """The folders of one unit, and the way from a name in an archive to a file and back."""

    def __init__(self, settings: Path) -> None:
        self.settings = settings.absolute()
        self.folders = {"settings": self.settings.parent, "data": service_folder(settings)}

    def member(self, path: Path) -> str | None:
        for name, folder in self.folders.items():
            if path.is_relative_to(folder):
                member = f"{name}/{path.relative_to(folder)}"
                return member if re.fullmatch(_MEMBER, member) else None
        return None

    def path(self, member: str) -> Path:
        name, _, rest = member.partition("/")
        return self.folders[name] / rest


def back_up(settings: Path, output: Path) -> list[str]:
    """Write the archive of the unit with these settings; returns what is not in it, in lines.

    The daemon may run meanwhile. Kept frames are not in it. Raises BadInputError.
    """
    config, places = load_settings(settings), _Places(settings)
    history = history_to_read(config, settings)
    state = places.folders["data"].glob(f"*-{unit_number(config.unit.serial):08X}.json")
    found = {path for path in _paths_in(config) if path.is_file()} - {history}
    files: dict[Path, BinaryIO] = {}
    left_out = []
    with (
        TemporaryDirectory(dir=output.absolute().parent, prefix=".altd-backup-") as folder,
        ExitStack() as stack,
    ):
        for path in sorted({places.settings, *found, *state}):
            files[path] = io.BytesIO(read_file(path, _MAX_FILE_BYTES))
        if history.exists():
            try:
                _copy(history, copy := Path(folder, FILE_NAME))
                files[history] = stack.enter_context(copy.open("rb"))
            except sqlite3.Error as error:
                left_out.append(f"{history}: not in the backup: {error}")
        entries: dict[str, dict[str, object]] = {}
        content: dict[str, BinaryIO] = {}
        for path, stream in files.items():
            if (member := places.member(path)) is None:
                left_out.append(f"{path}: not in the backup: it is outside of the folders of the unit")
            else:
                entries[member], content[member] = _entry(path, stream), stream
        index: dict[str, object] = {
            "format": "altd-backup/1",
            "version": __version__,
            "created": utc_text(datetime.now(UTC)),
            "serial": config.unit.serial,
            "settings": places.member(places.settings),
            "files": entries,
        }
        index["checksum"] = checksum_of(index)
        _check_index(index, output)
        with replacing(output) as file:
            os.fchmod(file.fileno(), 0o600)
            with tarfile.open(fileobj=file, mode="w:gz", compresslevel=1) as archive:
                _add(archive, _INDEX, io.BytesIO((line_of(index) + "\n").encode()))
                for member, stream in content.items():
                    _add(archive, member, stream)
    return left_out


def restore(source: Path, settings: Path) -> str:
    """Put the files of an archive in their places, ``settings`` for the settings; returns the unit's serial.

    All of it is read and checked beside those places first: an archive that is refused changes nothing. What
    is replaced is kept as ``….before-restore``. The settings come last. Raises BadInputError.
    """
    places = _Places(settings)
    with ExitStack() as stack:
        _check_stopped(places, stack)
        staged = _Places(settings)
        try:
            index = _read(source, staged, places, stack)
        except OSError as error:
            raise BadInputError(error.filename or source, error.strerror or str(error)) from error
        _check_content(index, staged, places, source)
        members = sorted(index.files, key=lambda member: member == index.settings)
        for member in members:
            target = places.path(member)
            target.parent.mkdir(parents=True, exist_ok=True)
            check_replaceable(target)
        os.sync()
        for member in members:
            target = places.path(member)
            for ending in ("-wal", "-shm", ""):  # a log that stayed would be written into another history
                with suppress(FileNotFoundError):
                    old = target.with_name(target.name + ending)
                    old.replace(target.with_name(target.name + BEFORE_RESTORE + ending))
            staged.path(member).replace(target)
        os.sync()
    return index.serial


def _paths_in(value: object) -> Iterator[Path]:
    """All paths of the settings."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, BaseModel):
        yield from _paths_in(dict(value))
    elif isinstance(value, Mapping):
        yield from _paths_in(tuple(value.values()))
    elif isinstance(value, tuple):
        for each in value:
            yield from _paths_in(each)


def _copy(history: Path, copy: Path) -> None:
    """Copy a history as it is at one moment, while a daemon may write it; raises sqlite3.Error."""
    place = f"file:{quote(str(history.absolute()))}?mode=ro"
    with closing(sqlite3.connect(place, uri=True)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("PRAGMA journal_mode = DELETE")  # a file alone, without a log beside it


def _entry(path: Path, content: BinaryIO) -> dict[str, object]:
    """The line of the index for a file, whose content may be a copy."""
    about, digest = path.stat(), hashlib.file_digest(cast("io.BytesIO", content), "sha256").hexdigest()
    user = group = ""
    with suppress(KeyError):
        user, group = pwd.getpwuid(about.st_uid).pw_name, grp.getgrgid(about.st_gid).gr_name
    mode = about.st_mode & _MODE
    return {
        "size": content.seek(0, os.SEEK_END),
        "sha256": digest,
        "mode": mode,
        "user": user,
        "group": group,
    }


def _add(archive: tarfile.TarFile, name: str, content: BinaryIO) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = content.seek(0, os.SEEK_END), 0o600
    content.seek(0)
    archive.addfile(member, content)


def _check_index(document: object, source: Path) -> _Index:
    if not isinstance(document, dict) or not str(document.get("format", "")).startswith("altd-backup/"):
        raise BadInputError(source, "is no backup of altd")
    try:
        index = _Index.model_validate(document)
    except ValueError as error:
        raise BadInputError(
            source, f"its index cannot be used: {str(error).splitlines()[-2].strip()}"
        ) from error
    body = {key: value for key, value in document.items() if key != "checksum"}
    if document["checksum"] != checksum_of(body):
        raise BadInputError(source, "the checksum of its index does not fit: it is damaged or was edited")
    if index.settings not in index.files:
        raise BadInputError(source, "its index does not list the settings")
    return index


def _check_stopped(places: _Places, stack: ExitStack) -> None:
    """Refuse while a daemon runs: it has these files open; keep it from writing the history."""
    try:
        config = load_settings(places.settings)
        place, history = socket_to_ask(config, places.settings), history_to_read(config, places.settings)
    except BadInputError:  # none, or what the archive shall replace
        place = Path("/run", service_name(places.settings), SERVICE_SOCKET.name)
        history = places.folders["data"] / FILE_NAME
    with socket.socket(socket.AF_UNIX) as trial, suppress(FileNotFoundError, ConnectionRefusedError):
        trial.setblocking(False)  # one that hangs lets its queue fill up
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
    """A stream of which ``left`` more bytes may be read."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.left = _MAX_HEADER_BYTES

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= self.left:
            raise ValueError("a header is too long")
        self.left -= size
        return self._stream.read(size)


def _read(source: Path, staged: _Places, places: _Places, stack: ExitStack) -> _Index:
    """Write all files of an archive to their staged places; raises BadInputError, OSError."""
    try:
        with gzip.open(source) as unpacked:
            stream = _Limited(cast("BinaryIO", unpacked))
            with tarfile.open(fileobj=stream, mode="r|") as archive:
                members = _regular(archive, stream)
                name, size, content = next(members, ("", 0, io.BytesIO()))
                if name != _INDEX or size > _MAX_INDEX_BYTES:
                    raise BadInputError(source, "is no backup of altd")
                index = _check_index(parse_json(content.read()), source)
                _check_serial(index.serial, places.settings)
                for folder in {member.partition("/")[0] for member in index.files}:
                    _make_folder(places.folders[folder])
                    work = TemporaryDirectory(dir=places.folders[folder], prefix=".restore-")
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
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError, OverflowError) as error:
        raise BadInputError(source, f"is damaged or no backup of altd: {error}") from error
    if missing:
        raise BadInputError(source, f"is damaged: it ends before {min(missing)}")
    return index


def _regular(archive: tarfile.TarFile, stream: _Limited) -> Iterator[tuple[str, int, BinaryIO]]:
    """Name, size and content of each member, which must be a regular file."""
    while (member := archive.next()) is not None:
        content = archive.extractfile(member) if member.isreg() and not member.issparse() else None
        if content is None:
            raise ValueError(f"{member.name} is no regular file")
        stream.left = member.size + _MAX_HEADER_BYTES
        yield member.name, member.size, cast("BinaryIO", content)


def _stage(path: Path, content: BinaryIO, entry: _Entry) -> None:
    digest = hashlib.sha256()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o755)
    with path.open("xb") as file:
        os.fchmod(file.fileno(), entry.mode & _MODE)
        with suppress(LookupError, PermissionError):
            os.fchown(file.fileno(), pwd.getpwnam(entry.user).pw_uid, grp.getgrnam(entry.group).gr_gid)
        while piece := content.read(_PIECE_BYTES):
            digest.update(piece)
            file.write(piece)
    if digest.hexdigest() != entry.sha256:
        raise ValueError(f"the sum of {path.name} does not fit")


def _check_serial(serial: str, settings: Path) -> None:
    """Refuse to make one unit of another."""
    if not os.path.lexists(settings):
        return
    try:
        unit: Any = parse_toml(read_file(settings, _MAX_FILE_BYTES)).get("unit")
    except ValueError as error:
        raise BadInputError(
            settings, f"which unit this is cannot be read; move it away first: {error}"
        ) from error
    found = unit.get("serial") if isinstance(unit, dict) else None
    if found != serial:
        raise BadInputError(
            settings, f"is of unit {found!r}, the backup is of {serial!r}; move it away first"
        )


def _check_content(index: _Index, staged: _Places, places: _Places, source: Path) -> None:
    """Refuse settings, a calibration or credentials that the daemon could not use."""
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
