"""Recordings on the unit's disk, in a bounded space: the oldest go first, marked ones stay."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import read_file
from altd.files.writing import replace_file
from altd.recording.header import HEADER_FILE
from altd.records import utc_text
from altd.status.recording_desk import KeptRecording, NoExposureError, NotKeptError

_ABOUT_FILE = "kept.json"
_MAX_ABOUT_BYTES = 4096
_UNDER_WAY = ".under-way-"
_NAME = re.compile(r"[0-9A-Za-z_-]{1,120}")
MIN_FREE_BYTES = 200 << 20
"""Left free on the disk, for the history and whatever else the unit writes."""
_MAX_SAME_NAME = 100
_BLOCK_BYTES = 4096
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""Of a file system without locks: there two daemons do not see each other."""


@dataclass(frozen=True, slots=True)
class Written:
    """What a recording holds, once it is written."""

    exposures: int
    seconds: float


class RecordingStore:
    """The recordings in ``folder``, which may take ``max_bytes`` together. Its calls block.

    A recording is written beside the others and gets its name when it is whole; until then who writes it
    holds the lock of its folder (flock(2)), which ends with the process. Each has a number, by which the
    oldest is told: a clock that nobody set names the newest by a day of long ago.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def open(self) -> tuple[KeptRecording, ...]:
        """Make the folder, remove what a daemon that was killed left half done; the recordings there are."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._remove_unfinished()
            return self.recordings()
        except OSError as error:
            raise self._refused(error) from error

    def recordings(self) -> tuple[KeptRecording, ...]:
        """What there is, the newest first; what altd did not put there is passed over."""
        newest_first = sorted(self._numbered(), key=lambda each: (each[0], each[1].name), reverse=True)
        return tuple(kept for _, kept in newest_first)

    def folder_of(self, name: str) -> Path:
        """Where a recording lies; raises NotKeptError when there is none of that name."""
        path = self._folder / name
        if not _NAME.fullmatch(name) or not (path / _ABOUT_FILE).is_file():
            raise NotKeptError("there is no such recording")
        return path

    def files(self, name: str) -> list[str]:
        """The files of a recording, by their paths in it, the header last; raises NotKeptError."""
        folder = self.folder_of(name)
        files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
        names = (path.relative_to(folder).as_posix() for path in files)
        return sorted(names, key=lambda name: (name == HEADER_FILE, name))

    def content(self, name: str, file: str) -> bytes | None:
        """One of ``files``; None: it is gone."""
        try:
            return (self._folder / name / file).read_bytes()
        except OSError:
            return None

    def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """Mark a recording, or take its mark away."""
        path = self.folder_of(name)
        found = self._read(path)
        if found is None:
            raise NotKeptError(f"{path / _ABOUT_FILE} is damaged")
        number, kept = found[0], replace(found[1], is_marked=is_marked)
        try:
            _write_about(path, number, kept)
        except OSError as error:
            raise self._refused(error) from error
        return kept

    def add(
        self, why: str, start: datetime | None, max_bytes: int, write: Callable[[Path], Written]
    ) -> KeptRecording:
        """Have a recording of up to ``max_bytes`` written, after room was made for it.

        Raises NotKeptError where there is no room or the disk refuses, and then there is nothing of it.
        """
        under_way = self._folder / f"{_UNDER_WAY}{secrets.token_hex(8)}"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._remove_unfinished()
            self._make_room(max_bytes)
            under_way.mkdir()
            with _locked(under_way):
                written = write(under_way)
                if not written.exposures:
                    raise NoExposureError("there is no exposure of all cameras in the last seconds")
                kept = KeptRecording(
                    self._new_name(why, start),
                    why,
                    "" if start is None else utc_text(start),
                    written.seconds,
                    written.exposures,
                    _bytes_of(under_way) + _BLOCK_BYTES,
                    is_marked=False,
                )
                number = 1 + max((number for number, _ in self._numbered()), default=0)
                _write_about(under_way, number, kept)
                under_way.rename(self._folder / kept.name)
        except (BadInputError, OSError) as error:
            raise self._refused(error) from error
        finally:
            shutil.rmtree(under_way, ignore_errors=True)
        return kept

    def _remove_unfinished(self) -> None:
        """Remove what nobody writes any more; another daemon may be writing here."""
        for left in self._folder.glob(f"{_UNDER_WAY}*"):
            with suppress(OSError), _locked(left):
                shutil.rmtree(left, ignore_errors=True)

    def _make_room(self, max_bytes: int) -> None:
        """Remove the oldest recordings that nobody marked until there is room."""
        there = list(self.recordings())
        free = shutil.disk_usage(self._folder).free - MIN_FREE_BYTES
        taken = sum(kept.bytes for kept in there)
        while taken + max_bytes > self._max_bytes or free < max_bytes:
            oldest = next((kept for kept in reversed(there) if not kept.is_marked), None)
            if oldest is None:
                held = f"recordings that are marked take {taken >> 20} MB of {self._max_bytes >> 20} MB"
                raise NotKeptError("the disk is nearly full" if free < max_bytes else held)
            shutil.rmtree(self._folder / oldest.name)
            there.remove(oldest)
            taken -= oldest.bytes
            free += oldest.bytes

    def _new_name(self, why: str, start: datetime | None) -> str:
        day = "unknown-time" if start is None else f"{start:%Y%m%dT%H%M%SZ}"
        base = f"{day}-{re.sub('[^0-9A-Za-z_]+', '-', why)}"[:100]
        names = (base, *(f"{base}-{number}" for number in range(2, _MAX_SAME_NAME)))
        for name in names:
            if not (self._folder / name).exists():
                return name
        raise NotKeptError(f"there are {_MAX_SAME_NAME} recordings of the name {base}")

    def _numbered(self) -> list[tuple[int, KeptRecording]]:
        """What there is, each with its number."""
        found = (self._read(path) for path in self._folder.iterdir() if _NAME.fullmatch(path.name))
        return [each for each in found if each is not None]

    def _read(self, path: Path) -> tuple[int, KeptRecording] | None:
        """Number and facts of a recording; 0 of one that was kept before there were numbers."""
        try:
            about = parse_json(read_file(path / _ABOUT_FILE, _MAX_ABOUT_BYTES))
            if not isinstance(about, dict):
                return None
            kept = KeptRecording(
                path.name,
                str(about["why"]),
                str(about["start"] or ""),
                float(about["seconds"]),
                int(about["exposures"]),
                int(about["bytes"]),
                about["marked"] is True,
            )
            return int(about.get("number", 0)), kept
        except (BadInputError, OSError, KeyError, TypeError, ValueError, OverflowError):
            return None

    def _refused(self, error: BadInputError | OSError) -> NotKeptError:
        why = f"{self._folder}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
        return NotKeptError(why)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a folder's lock; raises OSError, BlockingIOError while another holds it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        yield
    finally:
        os.close(descriptor)


def _write_about(path: Path, number: int, kept: KeptRecording) -> None:
    about = {**kept.as_object(), "number": number}
    replace_file(path / _ABOUT_FILE, (json.dumps(about) + "\n").encode())


def _bytes_of(folder: Path) -> int:
    """What a folder takes on the disk, in whole blocks: some file systems count them only later."""
    sizes = [path.stat().st_size for path in folder.rglob("*")]
    return sum(_BLOCK_BYTES * -(-size // _BLOCK_BYTES) for size in sizes)
