"""Where the local socket is: as the daemon makes it and as commands find it."""

from __future__ import annotations

from pathlib import Path

from altd.config import Config, LocalSettings
from altd.runtime.service_manager import runtime_folder

SERVICE_SOCKET = LocalSettings().socket
"""Where the service has it (docs/install.md)."""


def local_socket_of(config: Config) -> Path | None:
    """Where a daemon with this config serves its own computer; None: nowhere.

    Without ``[local]`` only in the folder that the service manager made: who tries a config by hand need not
    be able to write /run.
    """
    if config.local is not None:
        return config.local.socket
    folder = runtime_folder()
    return None if folder is None else folder / SERVICE_SOCKET.name


def socket_to_ask(config: Config) -> Path:
    """Where a command finds the daemon that runs with this config, as a service or by hand."""
    return SERVICE_SOCKET if config.local is None else config.local.socket
