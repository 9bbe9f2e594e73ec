"""Reads ``altd.toml`` for the daemon, and determines the daemon's local socket and folders."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

from altd.app.calibration_summary import why_unusable
from altd.config import Config, LocalSettings, TelegramPortSettings
from altd.config.draft import Draft
from altd.config.loading import config_of, read_config
from altd.config.wording import Fault
from altd.errors import BadInputError
from altd.files.table import shown
from altd.publish.serial.plate_and_row import sentences_of
from altd.publish.serial.telegram import SENTENCES, longest_bytes
from altd.runtime.service_manager import runtime_folder, state_folder
from altd.serial_port.port import seconds_on_line

SERVICE_CONFIG = Path("/etc/altd/altd.toml")
"""Settings file of the service (docs/install.md)."""

SERVICE_SOCKET = LocalSettings().socket
"""Local socket of the service (docs/install.md)."""


def local_socket_of(config: Config) -> Path | None:
    """Return the socket on which a daemon with this config serves its own computer; None: none.

    Without ``[local]`` there is a socket only in the folder created by the service manager: a user who tests
    a config by hand needs no write access to /run.
    """
    if config.local is not None:
        return config.local.socket
    folder = runtime_folder()
    return None if folder is None else folder / SERVICE_SOCKET.name


def restore_marker(place: Path) -> Path:
    """Return the file that exists while a restore replaces files of the unit with these settings."""
    return place.parent / f".{place.name}.restoring"


def check_restored(place: Path) -> None:
    """Raise BadInputError if a restore was interrupted: files of two states of the unit are mixed."""
    if os.path.lexists(restore_marker(place)):
        raise BadInputError(place, "altd restore was interrupted: repeat it")


def service_name(place: Path) -> str:
    """Return the name of the service's folder in /run and /var/lib, for the settings at ``place``.

    ``altd``, or ``altd-NAME`` for /etc/altd/NAME.toml, the settings of the service altd@NAME
    (``altd@.service``).
    """
    place = place.absolute()
    is_instance = place.parent == SERVICE_CONFIG.parent and place.name != SERVICE_CONFIG.name
    return f"altd-{place.stem}" if is_instance else "altd"


def service_folder(place: Path) -> Path:
    """Return the service's data folder (``StateDirectory=``): of this process if it is a service."""
    return state_folder() or Path("/var/lib", service_name(place))


def socket_to_ask(config: Config, place: Path) -> Path:
    """Return the socket of a daemon with this config, run as a service or by hand."""
    if config.local is not None:
        return config.local.socket
    return Path("/run", service_name(place), SERVICE_SOCKET.name)


def load_settings(path: Path) -> Config:
    """Read and check a config file; raises BadInputError that names the file and the key of each fault."""
    return settings_of(read_config(path), path)


def settings_of(content: bytes, path: Path) -> Config:
    """Return the settings in the content of a config file; raises BadInputError like ``load_settings``."""
    return config_of(content, path, (telegrams_fit_their_lines, targets_have_usable_names))


def load_beam_settings(path: Path) -> Config:
    """Like ``load_settings``, for commands that need targets; raises BadInputError if there are none."""
    config = load_settings(path)
    if not config.targets:
        raise BadInputError(path, f'unit.instrument: "{config.unit.instrument}" has no targets')
    return config


def targets_have_usable_names(draft: Draft) -> Iterator[Fault]:
    """Yield a fault for each target whose name collides with another key of the same output."""
    for number, target in enumerate(draft.targets):
        if target is not None and (why := why_unusable(target.name)):
            yield Fault(("targets", number, "name"), f"{shown(target.name)} {why}; possible: another name")


def telegrams_fit_their_lines(draft: Draft) -> Iterator[Fault]:
    """Yield a fault for each port whose longest telegram takes longer than the interval of telegrams."""
    for number, port in enumerate(draft.serial):
        if not isinstance(port, TelegramPortSettings):
            continue
        sentences = sentences_of("beam" if draft.unit is None else draft.unit.instrument, len(draft.targets))
        if (takes_s := telegram_s(port, sentences)) > port.interval_s:
            least_s = math.ceil(takes_s * 100) / 100
            text = f"{port.interval_s:g} is too short at {port.baud} baud; possible: from {least_s:g}"
            keys = ("baud", "parity", "stop_bits", "rs485", "checked", "identify_every_s")
            about = tuple(("serial", number, key) for key in keys)
            yield Fault(("serial", number, "interval_s"), text, about=about)


def telegram_s(port: TelegramPortSettings, sentences: int = len(SENTENCES)) -> float:
    """Return the duration of a port's longest telegram on its line, s; a shorter interval is refused.

    ``sentences`` is the number of those of the measurement.
    """
    takes_s = seconds_on_line(port, longest_bytes(port, sentences))
    if port.rs485 is not None:
        takes_s += (port.rs485.delay_before_ms + port.rs485.delay_after_ms) * 1e-3
    return takes_s
