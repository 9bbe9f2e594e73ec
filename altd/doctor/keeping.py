"""Checks of stored data and of the local interface: history, recordings of frames, the local socket."""

from __future__ import annotations

import shutil
import socket
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from altd.acquisition.kept_frames.store import MIN_FREE_BYTES
from altd.app.keeping import FILE_NAME, RECORDINGS
from altd.app.settings import SERVICE_SOCKET
from altd.config import Config
from altd.doctor.system import STATE
from altd.history.opening import check_pages, open_to_read
from altd.history.schema import NewerFileError, UnusableFileError
from altd.process.machine import Finding, Machine

_CONNECT_TIMEOUT_S = 1.0
_MB = 10**6


def history(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the folder and the free space of the history, and whether its file is intact."""
    settings, subject = config.history, "history"
    if not settings.enabled:
        yield Finding.skipped(subject, "off: disabled in [history]")
        return
    path = settings.file or Path(STATE, FILE_NAME)
    if settings.file is None and machine.service() is None:
        yield _nowhere(subject, "[history] file = PATH in the config", config)
        return
    if (refused := _folder(subject, path.parent, machine)) is not None:
        yield refused
        return
    try:
        taken_bytes = machine.at(path).stat().st_size
    except FileNotFoundError:
        taken_bytes = 0
    except OSError as error:
        yield Finding.warning(subject, f"{path} cannot be read: {error.strerror}", "sudo altd doctor")
        return
    yield _room(subject, path.parent, settings.max_mb * _MB - taken_bytes, "[history] max_mb", machine)
    if taken_bytes:
        yield _file(path, machine)


def recordings(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the folder and the free space of recordings of the last seconds."""
    settings, subject = config.kept_frames, "kept frames"
    if not settings.memory_mb:
        yield Finding.skipped(subject, "off: [kept_frames] memory_mb is 0")
        return
    folder = settings.folder or Path(STATE, RECORDINGS)
    if settings.folder is None and machine.service() is None:
        yield _nowhere(subject, "[kept_frames] folder = PATH in the config", config)
        return
    if (refused := _folder(subject, folder, machine, made_by_altd=True)) is not None:
        yield refused
        return
    taken_bytes = sum(_size_of(path) for path in machine.at(folder).glob("*/**/*"))
    wanted_bytes = (settings.disk_mb << 20) + MIN_FREE_BYTES - taken_bytes
    yield _room(subject, folder, wanted_bytes, "[kept_frames] disk_mb", machine)


def local_socket(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the socket of ``altd status``, ``altd watch`` and ``altd selfcheck``."""
    if config.local is None and machine.service() is None:
        yield _nowhere("local socket", "[local] socket = PATH in the config", config)
        return
    path = SERVICE_SOCKET if config.local is None else config.local.socket
    subject = f"local socket {path}"
    try:
        mode = machine.at(path).lstat().st_mode
    except FileNotFoundError:
        yield _folder(subject, path.parent, machine) or Finding.good(
            subject, "the daemon creates it at its start"
        )
        return
    except OSError as error:
        yield Finding.warning(subject, f"cannot be read: {error.strerror}", "sudo altd doctor")
        return
    if not stat.S_ISSOCK(mode):
        yield Finding.error(
            subject, "the file is not a socket", f"sudo rm {path}   # or another [local] socket"
        )
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.settimeout(_CONNECT_TIMEOUT_S)
        try:
            trial.connect(str(machine.at(path)))
        except ConnectionRefusedError:
            yield Finding.good(subject, "left by a killed daemon; the next one replaces it")
        except PermissionError:
            remedy = "sudo altd status   # or Group= of the service, docs/console.md"
            yield Finding.warning(subject, f"{machine.account.name} may not open it", remedy)
        else:
            yield Finding.good(subject, "the daemon answers")


def _nowhere(subject: str, remedy: str, config: Config) -> Finding:
    """Return the finding for data without a place: only a machine's unit must have one."""
    why = "none configured, and no service is installed"
    if config.unit.kind == "desk":
        return Finding.skipped(subject, f"{why}: not required of a desk unit; possible: {remedy}")
    return Finding.warning(subject, why, remedy)


def _folder(subject: str, folder: Path, machine: Machine, *, made_by_altd: bool = False) -> Finding | None:
    """Reason why the daemon may not write to a folder; None: it may. An installed service is the writer."""
    service = machine.service()
    if service is not None:
        if service.may_write(folder):
            return None
        remedy = f"sudo systemctl edit altd   # [Service] ReadWritePaths={folder}; or a folder below {STATE}"
        return Finding.error(subject, f"the service may not write to {folder}", remedy)
    there = folder
    while made_by_altd and not machine.at(there).exists() and there != there.parent:
        there = there.parent
    status = machine.status(there)
    if status is None or not stat.S_ISDIR(status.st_mode):
        return Finding.error(subject, f"there is no folder {folder}", f"mkdir -p {folder}")
    if not machine.account.may_use(status):
        return Finding.error(subject, f"{machine.account.name} may not write to {there}", f"ls -ld {there}")
    return None


def _room(subject: str, folder: Path, wanted_bytes: int, setting: str, machine: Machine) -> Finding:
    there = machine.at(folder)
    while not there.is_dir():
        there = there.parent
    free_bytes = shutil.disk_usage(there).free
    text = f"{folder}: {free_bytes / _MB:.0f} MB free"
    if wanted_bytes <= free_bytes:
        return Finding.good(subject, text)
    remedy = f"sudo du -xhd1 {folder} | sort -h   # largest folders; or a smaller {setting}"
    return Finding.warning(subject, f"{text}, and it may grow by {wanted_bytes / _MB:.0f} MB", remedy)


def _file(path: Path, machine: Machine) -> Finding:
    subject = f"history {path}"
    try:
        with closing(open_to_read(machine.at(path))) as connection:
            check_pages(connection)
    except NewerFileError as error:
        return Finding.error(subject, str(error), f"sudo mv {path} {path}.newer   # or the newer release")
    except (UnusableFileError, sqlite3.Error) as error:
        remedy = "the daemon moves a damaged file aside at its start and creates a new one"
        return Finding.warning(subject, str(error), remedy)
    except OSError as error:
        return Finding.warning(subject, f"cannot be read: {error.strerror}", "sudo altd doctor")
    return Finding.good(subject, "the file is intact")


def _size_of(path: Path) -> int:
    try:
        return path.lstat().st_size
    except OSError:
        return 0
