"""``altd backup``: a unit's settings, the files that they name, its state and history in one archive.

The archive, ``altd-backup/1``, is a tar with gzip. Its first member, ``backup.json``, lists the other members
with their checksums: ``settings/…`` from the settings folder, ``data/…`` from the service's folder. The
archive contains secrets.
"""

from __future__ import annotations

import grp
import hashlib
import io
import os
import pwd
import re
import sqlite3
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, BinaryIO, Literal, cast
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field

from altd import __version__
from altd.app.keeping import FILE_NAME, history_to_read
from altd.app.settings import check_restored, load_settings, service_folder
from altd.errors import BadInputError
from altd.files.documents import checksum_of, line_of
from altd.files.reading import read_file
from altd.files.writing import check_replaceable, replacing
from altd.records import utc_text
from altd.status.proof import unit_number

INDEX = "backup.json"
MAX_FILE_BYTES = 1 << 28
"""Maximum size of a file other than the history; a calibration has some megabytes."""
MODE = 0o664
"""Maximum permissions of a file."""

_MEMBER = r"(settings|data)(/[^/.\x00-\x1f][^/\x00-\x1f]{0,200}){1,8}"
"""Pattern of a member's name. No part begins with a dot, so no name leads out of its folder."""
_Member = Annotated[str, Field(pattern=f"^{_MEMBER}$")]


class Entry(BaseModel):
    """Entry of the index for a file of an archive."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    size: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    mode: int
    user: str
    group: str


class Index(BaseModel):
    """Index of an archive's files."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    format: Literal["altd-backup/1"]
    version: str
    created: str
    serial: str
    settings: _Member
    files: Mapping[_Member, Entry]
    checksum: str


class Places:
    """The folders of one unit; converts between file paths and names in an archive."""

    def __init__(self, settings: Path) -> None:
        self.settings = settings.absolute()
        self.folders = {"settings": self.settings.parent, "data": service_folder(self.settings)}

    def member(self, path: Path) -> str | None:
        """Return the name in an archive; None: the file is in another folder or its name is not allowed."""
        for name, folder in self.folders.items():
            if path.is_relative_to(folder):
                member = f"{name}/{path.relative_to(folder)}"
                return member if re.fullmatch(_MEMBER, member) else None
        return None

    def path(self, member: str) -> Path:
        """Return the path of a member of an archive."""
        name, _, rest = member.partition("/")
        return self.folders[name] / rest


def back_up(settings: Path, output: Path) -> list[str]:
    """Write the archive of the unit with these settings; return one line per file that is not included.

    The daemon may run meanwhile. Kept frames are not included. Raises BadInputError.
    """
    check_replaceable(output)
    check_restored(settings)
    config, places = load_settings(settings), Places(settings)
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
            files[path] = io.BytesIO(read_file(path, MAX_FILE_BYTES))
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
        check_index(index, output)
        with replacing(output) as file:
            os.fchmod(file.fileno(), 0o600)
            with tarfile.open(fileobj=file, mode="w:gz", compresslevel=1) as archive:
                _add(archive, INDEX, io.BytesIO((line_of(index) + "\n").encode()))
                for member, stream in content.items():
                    _add(archive, member, stream)
    return left_out


def check_index(document: object, source: Path) -> Index:
    """Validate and return the index of an archive; raises BadInputError."""
    if not isinstance(document, dict) or not str(document.get("format", "")).startswith("altd-backup/"):
        raise BadInputError(source, "is not an altd backup")
    try:
        index = Index.model_validate(document)
    except ValueError as error:
        raise BadInputError(
            source, f"its index cannot be used: {str(error).splitlines()[-2].strip()}"
        ) from error
    body = {key: value for key, value in document.items() if key != "checksum"}
    if document["checksum"] != checksum_of(body):
        raise BadInputError(source, "the checksum of its index does not match: it is damaged or was edited")
    if index.settings not in index.files:
        raise BadInputError(source, "its index does not list the settings")
    return index


def _paths_in(value: object) -> Iterator[Path]:
    """Yield all paths in the settings."""
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
    """Copy a consistent state of a history while a daemon may write it; raises sqlite3.Error."""
    place = f"file:{quote(str(history.absolute()))}?mode=ro"
    with closing(sqlite3.connect(place, uri=True)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("PRAGMA journal_mode = DELETE")  # a single file, without a separate log


def _entry(path: Path, content: BinaryIO) -> dict[str, object]:
    """Return the entry of the index for a file, whose content may be a copy."""
    about, digest = path.stat(), hashlib.file_digest(cast("io.BytesIO", content), "sha256").hexdigest()
    user = group = ""
    with suppress(KeyError):
        user, group = pwd.getpwuid(about.st_uid).pw_name, grp.getgrgid(about.st_gid).gr_name
    mode = about.st_mode & MODE
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
