"""``altd.toml`` as the daemon reads it, and where its local socket is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from altd.app.calibration_summary import why_unusable
from altd.config import Config, LocalSettings, TelegramPortSettings
from altd.config.draft import Draft
from altd.config.loading import config_of, read_config
from altd.config.table import shown
from altd.config.wording import Fault
from altd.errors import BadInputError
from altd.publish.serial.telegram import longest_bytes
from altd.runtime.service_manager import runtime_folder, state_folder
from altd.serial_port.port import seconds_on_line

SERVICE_CONFIG = Path("/etc/altd/altd.toml")
"""The settings file of the service (docs/install.md)."""

SERVICE_SOCKET = LocalSettings().socket
"""Its place for the service (docs/install.md)."""


def local_socket_of(config: Config) -> Path | None:
    """The socket on which a daemon with this config serves its own computer; None: none.

    Without ``[local]`` only in the folder that the service manager made: who tries a config by hand need not
    be able to write /run.
    """
    if config.local is not None:
        return config.local.socket
    folder = runtime_folder()
    return None if folder is None else folder / SERVICE_SOCKET.name


def service_name(place: Path) -> str:
    """The folder in /run and /var/lib of the service with the settings at ``place``.

    ``altd``, or ``altd-NAME`` for /etc/altd/NAME.toml: that of the service altd@NAME (``altd@.service``).
    """
    place = place.absolute()
    is_instance = place.parent == SERVICE_CONFIG.parent and place.name != SERVICE_CONFIG.name
    return f"altd-{place.stem}" if is_instance else "altd"


def service_folder(place: Path) -> Path:
    """The folder of the service's data (``StateDirectory=``); of this process where it is that service."""
    return state_folder() or Path("/var/lib", service_name(place))


def socket_to_ask(config: Config, place: Path) -> Path:
    """The socket of the daemon that runs with this config, as a service or by hand."""
    if config.local is not None:
        return config.local.socket
    return Path("/run", service_name(place), SERVICE_SOCKET.name)


def load_settings(path: Path) -> Config:
    """Read and check a config file; raises BadInputError that names the file and each fault's place."""
    return settings_of(read_config(path), path)


def settings_of(content: bytes, path: Path) -> Config:
    """The settings in the content of a config file; raises BadInputError as ``load_settings`` does."""
    return config_of(content, path, (telegrams_fit_their_lines, targets_can_be_told))


def load_beam_settings(path: Path) -> Config:
    """The same for a command that only a unit with targets has."""
    config = load_settings(path)
    if not config.targets:
        raise BadInputError(path, f'unit.instrument: "{config.unit.instrument}" has no targets')
    return config


def targets_can_be_told(draft: Draft) -> Iterator[Fault]:
    """No target has the name of another key of the same output."""
    for number, target in enumerate(draft.targets):
        if target is not None and (why := why_unusable(target.name)):
            yield Fault(("targets", number, "name"), f"{shown(target.name)} {why}; possible: another name")


def telegrams_fit_their_lines(draft: Draft) -> Iterator[Fault]:
    """The longest telegram is through before the next one is due."""
    for number, port in enumerate(draft.serial):
        if not isinstance(port, TelegramPortSettings):
            continue
        if (takes_s := telegram_s(port)) > port.interval_s:
            least_s = math.ceil(takes_s * 100) / 100
            text = f"{port.interval_s:g} is too short at {port.baud} baud; possible: from {least_s:g}"
            keys = ("baud", "parity", "stop_bits", "rs485", "checked", "identify_every_s")
            about = tuple(("serial", number, key) for key in keys)
            yield Fault(("serial", number, "interval_s"), text, about=about)


def telegram_s(port: TelegramPortSettings) -> float:
    """Duration of a port's longest telegram on its line; a shorter interval is refused."""
    takes_s = seconds_on_line(port, longest_bytes(port))
    if port.rs485 is not None:
        takes_s += (port.rs485.delay_before_ms + port.rs485.delay_after_ms) * 1e-3
    return takes_s
