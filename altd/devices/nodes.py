"""Checks of the devices that a config names: existence, permissions, use by another program."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from altd.devices.settings import SERIAL, details
from altd.process.machine import Account, Finding, Machine, group_name, user_name
from altd.serial_line.opening import find_ports, has_hardware

_MAX_NAMES_SHOWN = 4


def check_node(subject: str, device: Path, names: tuple[str, ...], machine: Machine) -> Iterator[Finding]:
    """Check a device of the config; ``names`` are patterns of the names that it may have."""
    status = machine.status(device)
    if status is None:
        remedy = f"plug it in, or use one of these names in the settings: ls -l {names[0]}"
        yield Finding.error(subject, f"does not exist; {existing(names, machine)}", remedy)
    elif not stat.S_ISCHR(status.st_mode):
        yield Finding.error(
            subject, "is not a device", f"ls -l {names[0]}   # use one of these names in the settings"
        )
    else:
        yield from check_permission(subject, str(device), machine)
        yield from _other_users(subject, machine.at(device).resolve().name, status, machine)


def check_duplicates(what: str, devices: Mapping[str, Path], machine: Machine) -> Iterator[Finding]:
    """Find names of the same device: udev gives each several, and only one program can use it."""
    first: dict[int, str] = {}
    for name, device in devices.items():
        status = machine.status(device)
        if status is None or not stat.S_ISCHR(status.st_mode):
            continue
        if (other := first.setdefault(status.st_rdev, name)) != name:
            node = machine.at(device).resolve().name
            remedy = f"ls -l /dev | grep {node}   # use another device for one of them in the settings"
            yield Finding.error(f"{what} {name}", f"is the same device as {other}, {node}", remedy)


def check_permission(subject: str, device: str, machine: Machine) -> Iterator[Finding]:
    """Check whether this user and the service may open a device."""
    status = machine.status(device)
    if status is None:
        return
    owner, group = user_name(status.st_uid), group_name(status.st_gid)
    rights = f"{stat.filemode(status.st_mode)} {owner} {group}"
    service = machine.service()
    accounts: list[Account] = [machine.account, *([service.account] if service else [])]
    refused = [account for account in accounts if not account.may_use(status)]
    for account in refused:
        if not status.st_mode & stat.S_IRGRP or not status.st_mode & stat.S_IWGRP or status.st_gid == 0:
            remedy = (
                f"udevadm info {device}   # a rule in /etc/udev/rules.d must give it a group, such as dialout"
            )
        elif account is machine.account:
            remedy = f"sudo usermod -aG {group} {account.name}   # and log in again"
        else:
            remedy = f"sudo systemctl edit altd   # [Service] SupplementaryGroups={group}"
        yield Finding.error(subject, f"{account.name} may not open it ({rights})", remedy)
    drivers = machine.drivers(status)
    if service is not None and not service.allows(device, drivers):
        names = " or ".join(sorted(drivers)) or "?"
        remedy = f"sudo systemctl edit altd   # [Service] DeviceAllow=char-{names} rw"
        yield Finding.error(subject, f"the service's unit does not list its kind, {names}", remedy)
    elif not refused:
        whom = " and ".join(account.name for account in accounts)
        yield Finding.good(subject, f"{whom} may open it ({rights})")


def _other_users(subject: str, node: str, status: os.stat_result, machine: Machine) -> Iterator[Finding]:
    for number, name in dict.fromkeys(machine.holders(status)):
        if number == os.getpid():
            continue
        if name == "altd":
            yield Finding.good(subject, f"in use by altd (process {number})")
        else:
            remedies = {
                "agetty": f"sudo systemctl disable --now serial-getty@{node}",
                "ModemManager": "sudo systemctl disable --now ModemManager",
            }
            yield Finding.error(
                subject, f"in use by {name} (process {number})", remedies.get(name, f"sudo kill {number}")
            )


def existing(names: tuple[str, ...], machine: Machine) -> str:
    """Devices that exist instead: the matches of the first pattern that has any."""
    for pattern in names:
        found = node_paths(pattern, machine)
        if found:
            more = f" and {len(found) - _MAX_NAMES_SHOWN} more" if len(found) > _MAX_NAMES_SHOWN else ""
            return f"existing: {', '.join(found[:_MAX_NAMES_SHOWN])}{more}"
    return "no other exists"


def node_paths(pattern: str, machine: Machine) -> list[str]:
    """Devices that match a pattern, without serial ports that have no hardware."""
    return [path for path in machine.paths(pattern) if has_hardware(Path(path), machine.at("/sys/class/tty"))]


def lines() -> Iterator[str]:
    """Yield the serial ports for ``altd devices``."""
    for found in find_ports():
        yield f'  device = "{found.path}"'
        now = "" if found.path == found.device else f", now {found.device}"
        yield from details(f"{found.about}{now}")


def check(tables: Mapping[str, Any], machine: Machine) -> Iterator[Finding]:
    """Check the serial ports of a config."""
    ports = [table.device for table in tables.values()]
    names = ("/dev/serial/by-id/*", "/dev/serial/by-path/*", *SERIAL.nodes[1:])
    for device in ports:
        yield from check_node(f"serial {device}", device, names, machine)
    yield from check_duplicates("serial", {str(device): device for device in ports}, machine)
