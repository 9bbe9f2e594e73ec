"""Recordings on the unit's disk, in limited space: the oldest are removed first, marked ones never."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from altd.errors import BadInputError, one_line
from altd.files.documents import parse_json
from altd.files.reading import read_file
from altd.files.writing import replace_file
from altd.recording.header import HEADER_FILE
from altd.records import utc_text
from altd.status.services import KeptRecording, NoExposureError, NotKeptError

_ABOUT_FILE = "kept.json"
_MAX_ABOUT_BYTES = 4096
_DAMAGED = f"unknown: {_ABOUT_FILE} is damaged"
_UNDER_WAY = ".under-way-"
_NAME = re.compile(r"[0-9A-Za-z_-]{1,120}")
MIN_FREE_BYTES = 200 << 20
"""Minimum free space on the disk, for the history and other files of the unit."""
_FILE = re.compile(r"(?:[0-9A-Za-z_-]{1,64}/)?[0-9A-Za-z_-][0-9A-Za-z_.-]{0,63}")
"""Path of a file of a recording; other files in its folder are ignored."""
_MAX_FILE_BYTES = 64 << 20
_MAX_WHY_CHARACTERS = 200
_MAX_SECONDS = 1e6
_MAX_NUMBER = 10**9
_MAX_SAME_NAME = 100
_BLOCK_BYTES = 4096
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""Errors of a file system without locks, where two daemons cannot detect each other."""


@dataclass(frozen=True, slots=True)
class Written:
    """Length of a written recording."""

    exposures: int
    seconds: float


class RecordingStore:
    """The recordings in ``folder``, with ``max_bytes`` in total. The calls block.

    A recording is written under a temporary name and renamed when complete. Until then its writer holds the
    lock of its folder (flock(2)), which ends with the process. Each recording has a number, which identifies
    the oldest: if the clock was not set, the newest recording has an old date in its name.

    The contents of the folder are not trusted. A recording is a folder with a ``kept.json``; if that file is
    not plausible, its contents are ignored and the recording is kept. The bytes of a recording are counted,
    and no link is followed.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def open(self) -> tuple[KeptRecording, ...]:
        """Create the folder, remove unfinished recordings of a killed daemon; return the recordings."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._remove_unfinished()
            return self.recordings()
        except OSError as error:
            raise self._refused(error) from error

    def recordings(self) -> tuple[KeptRecording, ...]:
        """Return the kept recordings, newest first; files that altd did not write are skipped."""
        newest_first = sorted(self._numbered(), key=lambda each: (each[0], each[1].name), reverse=True)
        return tuple(kept for _, kept in newest_first)

    def folder_of(self, name: str) -> Path:
        """Return the folder of a recording; raises NotKeptError for an unknown name."""
        path = self._folder / name
        if not _NAME.fullmatch(name) or path.is_symlink() or not os.path.lexists(path / _ABOUT_FILE):
            raise NotKeptError("there is no such recording")
        return path

    def files(self, name: str) -> list[str]:
        """Return the files of a recording as relative paths, the header last; raises NotKeptError."""
        folder = self.folder_of(name)
        found = (entry.path for entry in _entries(folder) if entry.is_file(follow_symlinks=False))
        names = (Path(path).relative_to(folder).as_posix() for path in found)
        return sorted(filter(_FILE.fullmatch, names), key=lambda name: (name == HEADER_FILE, name))

    def content(self, name: str, file: str) -> bytes | None:
        """Return the content of one of ``files``; None: it cannot be read."""
        path = Path(name, file)
        if not (_NAME.fullmatch(name) and _FILE.fullmatch(file)):
            return None
        try:
            with _entered(self._folder, path.parent) as folder:
                return read_file(Path(path.name), _MAX_FILE_BYTES, folder)
        except (BadInputError, OSError):
            return None

    def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """Mark or unmark a recording; raises NotKeptError."""
        path = self.folder_of(name)
        if (found := self._read(name)) is None:
            raise NotKeptError("the recording cannot be read")
        number, kept = found[0], found[1].model_copy(update={"marked": is_marked})
        try:
            _write_about(path, number, kept)
        except (BadInputError, OSError) as error:
            raise self._refused(error) from error
        return kept

    def remove(self, name: str) -> None:
        """Remove a recording; raises OSError."""
        left = self._under_way()  # after a power cut meanwhile, the next start removes the rest
        (self._folder / name).rename(left)
        shutil.rmtree(left)

    def add(
        self, why: str, start: datetime | None, max_bytes: int, write: Callable[[Path], Written]
    ) -> KeptRecording:
        """Make room for up to ``max_bytes`` and have ``write`` write a recording.

        Raises NotKeptError if there is no room or the disk refuses; then nothing of the recording remains.
        """
        under_way = self._under_way()
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
                    name=self._new_name(why, start),
                    why=one_line(why)[:_MAX_WHY_CHARACTERS],
                    start=None if start is None else utc_text(start),
                    seconds=round(written.seconds, 3),
                    exposures=written.exposures,
                    bytes=_bytes_of(under_way) + _BLOCK_BYTES,
                    marked=False,
                )
                newest = max((number for number, _ in self._numbered()), default=0)
                _write_about(under_way, min(newest + 1, _MAX_NUMBER), kept)
                under_way.rename(self._folder / kept.name)
        except (BadInputError, OSError) as error:
            raise self._refused(error) from error
        finally:
            shutil.rmtree(under_way, ignore_errors=True)
        return kept

    def _remove_unfinished(self) -> None:
        """Remove unfinished recordings without a writer; another daemon may be writing one."""
        for left in self._folder.glob(f"{_UNDER_WAY}*"):
            with suppress(OSError), _locked(left):
                shutil.rmtree(left, ignore_errors=True)

    def _make_room(self, max_bytes: int) -> None:
        """Remove the oldest unmarked recordings until there is room; remove none if that is not enough."""
        there = self.recordings()
        free = shutil.disk_usage(self._folder).free - MIN_FREE_BYTES
        lacking = max(sum(kept.bytes for kept in there) + max_bytes - self._max_bytes, max_bytes - free)
        going = []
        for oldest in (kept for kept in reversed(there) if not kept.marked):
            if lacking > 0:
                going.append(oldest.name)
                lacking -= oldest.bytes
        if lacking > 0:
            marked = sum(kept.bytes for kept in there if kept.marked)
            allowed = f"of {self._max_bytes >> 20} MB (kept_frames.disk_mb)"
            held = (
                f"marked recordings take {marked >> 20} {allowed}"
                if marked
                else f"that is more than all {allowed}"
            )
            needed = f"no space for up to {max_bytes >> 20} MB"
            raise NotKeptError("the disk is nearly full" if free < max_bytes else f"{needed}: {held}")
        for name in going:
            self.remove(name)

    def _under_way(self) -> Path:
        return self._folder / f"{_UNDER_WAY}{secrets.token_hex(8)}"

    def _new_name(self, why: str, start: datetime | None) -> str:
        day = "unknown-time" if start is None else f"{start:%Y%m%dT%H%M%SZ}"
        base = f"{day}-{re.sub('[^0-9A-Za-z_]+', '-', why)}"[:100]
        names = (base, *(f"{base}-{number}" for number in range(2, _MAX_SAME_NAME)))
        for name in names:
            if not os.path.lexists(self._folder / name):
                return name
        raise NotKeptError(f"there are {_MAX_SAME_NAME} recordings of the name {base}")

    def _numbered(self) -> list[tuple[int, KeptRecording]]:
        """Return the kept recordings, each with its number."""
        found = (self._read(path.name) for path in self._folder.iterdir() if _NAME.fullmatch(path.name))
        return [each for each in found if each is not None]

    def _read(self, name: str) -> tuple[int, KeptRecording] | None:
        """Return number (0 if the file has none) and facts of a recording; None: there is no recording."""
        about: object = None
        try:
            with _entered(self._folder, Path(name)) as folder:
                os.stat(_ABOUT_FILE, dir_fd=folder, follow_symlinks=False)
                with suppress(BadInputError, ValueError):
                    about = parse_json(read_file(Path(_ABOUT_FILE), _MAX_ABOUT_BYTES, folder))
            taken = _bytes_of(self._folder / name)
        except OSError:
            return None
        facts = about if isinstance(about, dict) else {}
        number, why, start, seconds, exposures = _believed(facts) or (0, _DAMAGED, "", 0.0, 0)
        kept = KeptRecording(
            name=name,
            why=why,
            start=start or None,
            seconds=round(seconds, 3),
            exposures=exposures,
            bytes=taken,
            marked=facts.get("marked") is True,
        )
        return number, kept

    def _refused(self, error: BadInputError | OSError) -> NotKeptError:
        why = f"{self._folder}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
        return NotKeptError(why)


def _believed(facts: Mapping[str, object]) -> tuple[int, str, str, float, int] | None:
    """Return number, why, start, seconds and exposures of a ``kept.json``; None: one is not plausible."""
    number, why, start = facts.get("number", 0), facts.get("why"), facts.get("start") or ""
    seconds, exposures = facts.get("seconds"), facts.get("exposures")
    if not (isinstance(why, str) and len(why) <= _MAX_WHY_CHARACTERS and one_line(why) == why):
        return None
    if not (isinstance(start, str) and (not start or _is_utc(start))):
        return None
    if any(isinstance(each, bool) for each in (number, seconds, exposures)):
        return None
    if not (isinstance(number, int) and isinstance(exposures, int) and isinstance(seconds, int | float)):
        return None
    if not (0 <= number <= _MAX_NUMBER and 0 <= exposures <= _MAX_NUMBER and 0 <= seconds <= _MAX_SECONDS):
        return None  # also for NaN
    return number, why, start, float(seconds), exposures


def _is_utc(text: str) -> bool:
    """Whether ``text`` is a time as ``utc_text`` writes it."""
    try:
        return utc_text(datetime.fromisoformat(text)) == text
    except (ValueError, OverflowError):
        return False


@contextmanager
def _entered(folder: Path, below: Path) -> Iterator[int]:
    """Open a folder below ``folder``, yield its descriptor; raises OSError, also for a link on the path."""
    descriptor = os.open(folder, _FOLDER)
    try:
        for name in below.parts:
            inner = os.open(name, _FOLDER | os.O_NOFOLLOW, dir_fd=descriptor)
            os.close(descriptor)
            descriptor = inner
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a folder's lock; raises OSError, BlockingIOError while another process holds it."""
    descriptor = os.open(folder, _FOLDER | os.O_NOFOLLOW)
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
    """Return the size of a folder in whole blocks, bytes: some file systems report used blocks only later."""
    sizes = (entry.stat(follow_symlinks=False).st_size for entry in _entries(folder))
    return sum(_BLOCK_BYTES * -(-size // _BLOCK_BYTES) for size in sizes)


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    """Yield the entries of a folder and its subfolders; follow no link, skip unreadable folders."""
    folders = [str(folder)]
    while folders:
        with suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                yield entry
