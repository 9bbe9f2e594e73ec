"""The parts of a unit's diagnostics that an interface cannot see: its settings, and what it runs on.

The settings are those that were read, not the file: its comments stay on the unit. The
settings themselves hold no secret, only the paths of files that do (``tests/unit/app/test_diagnostics.py``).
"""

from __future__ import annotations

import json
import os
import platform
from functools import partial
from importlib.metadata import distributions

from altd import __version__
from altd.config import Config
from altd.status.health import DiagnosticPart


def diagnostic_parts(config: Config) -> tuple[DiagnosticPart, ...]:
    """Additions of the daemon of this config to its diagnostics."""
    return (
        DiagnosticPart(
            "settings.json", "the settings as they were read, with their defaults", partial(_settings, config)
        ),
        DiagnosticPart("versions.txt", "altd, Python, the libraries and the kernel", _versions),
    )


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
