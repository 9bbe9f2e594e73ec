"""Parts of a unit's diagnostics that an interface cannot provide: its settings and its software versions.

``diagnose`` makes the archive without an interface, from a running daemon or from the files of a stopped one.

The settings are included as read, not as the file, so its comments stay on the unit. The settings contain
no secrets, only the paths of files that do (``tests/unit/app/test_diagnostics.py``).
"""

from __future__ import annotations

import asyncio
import json
import os
import platform
from collections.abc import Iterable
from datetime import UTC, datetime
from functools import partial
from http import HTTPStatus
from importlib.metadata import distributions
from pathlib import Path

from altd import __version__
from altd.app.keeping import FILE_NAME, history_to_read
from altd.app.settings import SERVICE_SOCKET, load_settings, socket_to_ask
from altd.config import Config
from altd.errors import BadInputError
from altd.history.history import History
from altd.local_socket import NoAnswerError, ask_content
from altd.publish.http.diagnostics import Part, archive_name, archive_of, further_part, history_parts, part_of
from altd.runtime.threads import SingleCall
from altd.status.unit import DiagnosticPart

_PATH = "/api/v1/diagnostics"
_TIMEOUT_S = 60.0
_MAX_ARCHIVE_BYTES = 1 << 27


def diagnostic_parts(config: Config) -> tuple[DiagnosticPart, ...]:
    """Return the parts that the daemon with this config adds to its diagnostics."""
    return (
        DiagnosticPart(
            "settings.json", "the settings as they were read, with their defaults", partial(_settings, config)
        ),
        DiagnosticPart("versions.txt", "altd, Python, the libraries and the kernel", _versions),
    )


def diagnose(place: Path | None) -> tuple[str, bytes, str]:
    """Return name and content of the archive for the settings at ``place``, and why no daemon made it.

    Unusable settings are reported in the archive: they may be the reason for requesting it.
    """
    config, why = None, ""
    socket, history = SERVICE_SOCKET, Path("/var/lib/altd", FILE_NAME)
    if place is not None:
        try:
            config = load_settings(place)
            socket, history = socket_to_ask(config, place), history_to_read(config, place)
        except BadInputError as error:
            why = "; ".join(error.lines)
    now = datetime.now(UTC)
    serial = "" if config is None else config.unit.serial
    try:
        status, content = ask_content(socket, _PATH, _TIMEOUT_S, max_bytes=_MAX_ARCHIVE_BYTES)
        if status == HTTPStatus.OK and len(content) < _MAX_ARCHIVE_BYTES:
            return archive_name(serial, now), content, ""
        said = f"the daemon at {socket} has no {_PATH}: it answers {status}"
    except NoAnswerError as error:
        said = str(error)
    why = "; ".join(filter(None, (why, said)))
    parts = [part_of("daemon.txt", "why the daemon made no archive", f"{why}\n".encode)]
    calls = SingleCall("diagnostics")
    parts += [further_part(part, calls) for part in (() if config is None else diagnostic_parts(config))]
    past = History(history, serial=serial or None)
    return archive_name(serial, now), asyncio.run(_archive(parts, past, serial, now)), why


async def _archive(parts: Iterable[Part], past: History, serial: str, now: datetime) -> bytes:
    try:
        return await archive_of([*parts, *history_parts(past, now)], serial, now)
    finally:
        await past.end()


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
