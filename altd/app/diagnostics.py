"""Parts of a unit's diagnostics that an interface cannot provide: its settings and its software versions.

``diagnose`` makes the archive without an interface, from a running daemon or from the files of a stopped one,
then with the log of the service and the findings of ``altd doctor``.

The settings are included as read, not as the file, so its comments stay on the unit. The settings contain
no secrets, only the paths of files that do (``tests/unit/app/test_diagnostics.py``).
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from functools import partial
from http import HTTPStatus
from importlib.metadata import distributions
from pathlib import Path

from altd import __version__
from altd.app.keeping import FILE_NAME, history_to_read
from altd.app.operating_time import file_in
from altd.app.parts import check_files
from altd.app.settings import SERVICE_SOCKET, load_settings, service_folder, socket_to_ask
from altd.config import Config
from altd.errors import BadInputError
from altd.history.history import History
from altd.local_socket import NoAnswerError, ask_content
from altd.publish.http.diagnostics import (
    JOURNAL,
    Part,
    archive_name,
    archive_of,
    history_parts,
    part_of,
)
from altd.status.unit import DiagnosticPart

_PATH = "/api/v1/diagnostics"
_TIMEOUT_S = 60.0
_FIRST_TIMEOUT_S = 3.0
"""Time for a first, small answer, s: a daemon that hangs must not delay the archive."""
_JOURNAL = ("journalctl", "--unit=altd", "--lines=5000", "--no-pager", "--quiet", "--output=short-iso")
_JOURNAL_TIMEOUT_S = 3.0
_MAX_ARCHIVE_BYTES = 1 << 27


def diagnostic_parts(config: Config | None) -> tuple[DiagnosticPart, ...]:
    """Return the parts that the daemon with this config adds to its diagnostics; None: it cannot be used."""
    versions = DiagnosticPart("versions.txt", "altd, Python, the libraries and the kernel", _versions)
    if config is None:
        return (versions,)
    settings = partial(_settings, config)
    return (
        DiagnosticPart("settings.json", "the settings as they were read, with their defaults", settings),
        versions,
    )


def diagnose(
    place: Path | None,
    own_socket: Path | None = None,
    further: Iterable[DiagnosticPart] = (),
    progress: Callable[[str], object] = lambda line: None,
    *,
    with_journal: bool = True,
) -> tuple[str, bytes, str]:
    """Return name and content of the archive for the settings at ``place``, and why no daemon made it.

    ``further`` parts are those that only an archive without a daemon has; ``progress`` receives a line per
    step. Unusable settings are reported in the archive: they may be the reason for requesting it.
    """
    config, why = None, ""
    socket, history = SERVICE_SOCKET, Path("/var/lib/altd", FILE_NAME)
    if place is not None:
        try:
            config = load_settings(place)
            socket, history = socket_to_ask(config, place), history_to_read(config, place)
        except BadInputError as error:
            why = "; ".join(error.lines)
    socket = own_socket or socket
    now = datetime.now(UTC)
    serial = "" if config is None else config.unit.serial
    try:
        ask_content(socket, "/api/v1/status", _FIRST_TIMEOUT_S)
        progress(f"the daemon at {socket} makes the archive")
        status, content = ask_content(socket, _PATH, _TIMEOUT_S, max_bytes=_MAX_ARCHIVE_BYTES)
        if status == HTTPStatus.OK and len(content) < _MAX_ARCHIVE_BYTES:
            return archive_name(serial, now), content, ""
        said = f"the daemon at {socket} has no {_PATH}: it answers {status}"
    except NoAnswerError as error:
        said = str(error)
    why = "; ".join(filter(None, (why, said)))
    progress(f"{why}: only its files are in the archive")
    made = [*diagnostic_parts(config), *further]
    if config is not None and place is not None:
        meaning = "file, SHA-256 and date of the calibration"
        made.append(DiagnosticPart("calibration.txt", meaning, partial(_calibration, config)))
        operated = file_in(service_folder(place), serial)
        made.append(DiagnosticPart("operating-time.json", "operating time of the unit", operated.read_bytes))
    if with_journal:
        progress("the log of altd is in the archive; to leave it out: --no-journal")
        made.append(DiagnosticPart(JOURNAL, "the newest lines of the service's log", _journal))
    past = History(history, serial=serial or None)
    parts = [part_of("daemon.txt", "why the daemon made no archive", f"{why}\n".encode)]
    parts += [Part(part.name, part.meaning, partial(_content, _outcome(part, progress))) for part in made]
    return archive_name(serial, now), asyncio.run(_archive(parts, past, serial, now)), why


async def _archive(parts: Iterable[Part], past: History, serial: str, now: datetime) -> bytes:
    try:
        return await archive_of([*parts, *history_parts(past, now)], serial, now)
    finally:
        await past.end()


def _outcome(part: DiagnosticPart, progress: Callable[[str], object]) -> bytes | Exception:
    """Make a part in the main thread: C++ in another one would abort the program that Ctrl-C ends."""
    try:
        content = part.make()
    except Exception as error:  # any error while making a part costs this part only
        return error
    progress(f"{part.name}: {len(content)} bytes")
    return content


async def _content(outcome: bytes | Exception) -> bytes:
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


def _journal() -> bytes:
    done = subprocess.run(_JOURNAL, capture_output=True, timeout=_JOURNAL_TIMEOUT_S, check=False)  # noqa: S603  fixed
    if done.returncode or not done.stdout:
        raise LookupError(done.stderr.decode(errors="replace").strip() or "the log has no line of altd")
    return done.stdout


def _calibration(config: Config) -> bytes:
    path = config.unit.calibration
    content = path.read_bytes()
    lines = [f"file: {path}, {len(content)} bytes", f"SHA-256: {hashlib.sha256(content).hexdigest()}"]
    calibration, errors = check_files(config)
    if calibration is not None:
        origin = ", from SIMULATED frames" if calibration.simulated else ""
        lines.append(f"made: {calibration.created:%Y-%m-%d}{origin}")
    return "".join(f"{line}\n" for line in [*lines, *errors]).encode()


def _settings(config: Config) -> bytes:
    return (json.dumps(config.model_dump(mode="json"), indent=1) + "\n").encode()


def _versions() -> bytes:
    system = os.uname()
    libraries = sorted({f"{each.name} {each.version}" for each in distributions()}, key=str.casefold)
    lines = [
        f"altd {__version__}",
        f"{platform.python_implementation()} {platform.python_version()}",
        f"{system.sysname} {system.release} {system.version} {system.machine}",
        f"processors: {os.cpu_count()}",
        *libraries,
    ]
    return ("\n".join(lines) + "\n").encode()
