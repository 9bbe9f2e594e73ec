"""Checks of the devices that a config names: existence, permissions, use by another program."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from altd.config import Config, V4l2CameraSettings
from altd.doctor.finding import Finding
from altd.doctor.machine import Account, Machine, group_name, user_name
from altd.serial_port.opening import has_hardware

_SERIAL_NODES = ("/dev/ttyUSB*", "/dev/ttyACM*", "/dev/ttyAMA*", "/dev/ttyS[0-9]*")
SERIAL_NAMES = ("/dev/serial/by-id/*", "/dev/serial/by-path/*", *_SERIAL_NODES)
CAMERA_NAMES = ("/dev/v4l/by-path/*", "/dev/v4l/by-id/*", "/dev/video*")
_MAX_NAMES_SHOWN = 4
_MAX_USB_SHARE = 0.6
"""Share of a USB's speed that is left for pictures: 80 % of the time, less its own frames and gaps."""


def serial_ports(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the ports of ``[[serial]]``, ``[inclinometer]`` and ``[stage]``."""
    ports = [port.device for port in config.serial]
    ports += [table.device for table in (config.inclinometer, config.stage) if table is not None]
    for device in ports:
        yield from _device(f"serial {device}", device, SERIAL_NAMES, machine)
    yield from _duplicates("serial", {str(device): device for device in ports}, machine)


def video_cameras(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the V4L2 cameras, and the USB buses that they are connected to."""
    needs_mbit_s: dict[str, float] = {}
    speeds: dict[str, int] = {}
    cameras = {
        name: camera for name, camera in config.cameras.items() if isinstance(camera, V4l2CameraSettings)
    }
    for name, camera in cameras.items():
        yield from _device(f"camera {name} {camera.device}", camera.device, CAMERA_NAMES, machine)
        bus = _usb_bus(camera.device, machine)
        if bus is not None:
            number, speeds[bus[0]] = bus
            bytes_px = 1 if camera.pixel_format == "GREY" else 2
            needed = camera.width * camera.height * bytes_px * camera.fps * 8e-6
            needs_mbit_s[number] = needs_mbit_s.get(number, 0.0) + needed
    yield from _duplicates("camera", {name: camera.device for name, camera in cameras.items()}, machine)
    for number, needed in needs_mbit_s.items():
        subject, speed = f"USB bus {number}", speeds[number]
        text = f"its cameras need {needed:.0f} Mbit/s of {speed}"
        if needed <= _MAX_USB_SHARE * speed:
            yield Finding.good(subject, text)
        else:
            remedy = "lsusb -t   # plug a camera into a faster socket of the computer, on a bus of its own"
            yield Finding.error(subject, f"{text}: too much", remedy)


def gpio_chips(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the chips of ``[lamps]`` and ``[indicators]``."""
    tables = [table for table in (config.lamps, config.indicators) if table is not None]
    for chip in dict.fromkeys(table.chip for table in tables if table.driver == "gpiod"):
        subject, path = f"gpio {chip}", _gpio_chip(chip, machine)
        if path is not None:
            yield from _device(subject, Path(path), ("/dev/gpiochip*",), machine)
        else:
            there = _alternatives(("/dev/gpiochip*",), machine)
            yield Finding.error(subject, f"no accessible chip has this name; {there}", "sudo gpiodetect")


def gpio_lines(config: Config) -> Iterator[Finding]:
    """Check the lines for lamps, of chips that may be opened: each must exist and be used only once."""
    from altd.devices.gpio.find_chips import find_chip, find_line
    from altd.ports import LampsError

    named: list[tuple[str, str, str]] = []
    if config.lamps is not None and config.lamps.driver == "gpiod":
        named += [("lamps", config.lamps.chip, line) for line in config.lamps.lines]
    if (indicators := config.indicators) is not None:
        named += [(f"indicators.{lamp}", indicators.chip, line) for lamp, line in indicators.lines.items()]
    first: dict[tuple[Path, int], str] = {}
    for key, wanted, name in named:
        try:
            chip = find_chip(wanted)
        except LampsError:
            continue  # the finding of the chip itself reports it
        subject, remedy = f"gpio {wanted} {name}", "altd devices   # use one of these names in altd.toml"
        try:
            line = find_line(chip, name)
        except LampsError as error:
            yield Finding.error(subject, f"{key}: {error}", remedy)
            continue
        if (other := first.setdefault((chip.path, line.offset), key)) != key:
            yield Finding.error(
                subject, f"{key} is the same line as {other}, {line.offset} of {chip}", remedy
            )


def found_devices(machine: Machine) -> Iterator[Finding]:
    """Check without a config whether the existing devices may be opened."""
    for patterns, what in (
        (_SERIAL_NODES, "serial"),
        (("/dev/video*",), "camera"),
        (("/dev/gpiochip*",), "gpio"),
    ):
        paths = [path for pattern in patterns for path in _paths(pattern, machine)]
        for path in paths:
            yield from _permission(f"{what} {path}", path, machine)
        if not paths:
            yield Finding.skipped(what, "none present")


def _device(subject: str, device: Path, names: tuple[str, ...], machine: Machine) -> Iterator[Finding]:
    status = machine.status(device)
    if status is None:
        remedy = f"plug it in, or use one of these names in altd.toml: ls -l {names[0]}"
        yield Finding.error(subject, f"does not exist; {_alternatives(names, machine)}", remedy)
    elif not stat.S_ISCHR(status.st_mode):
        yield Finding.error(
            subject, "is not a device", f"ls -l {names[0]}   # use one of these names in altd.toml"
        )
    else:
        yield from _permission(subject, str(device), machine)
        yield from _other_users(subject, machine.at(device).resolve().name, status, machine)


def _duplicates(what: str, devices: Mapping[str, Path], machine: Machine) -> Iterator[Finding]:
    """Find names of the same device: udev gives each several, and only one program can use it."""
    first: dict[int, str] = {}
    for name, device in devices.items():
        status = machine.status(device)
        if status is None or not stat.S_ISCHR(status.st_mode):
            continue
        if (other := first.setdefault(status.st_rdev, name)) != name:
            node = machine.at(device).resolve().name
            remedy = f"ls -l /dev | grep {node}   # use another device for one of them in altd.toml"
            yield Finding.error(f"{what} {name}", f"is the same device as {other}, {node}", remedy)


def _permission(subject: str, device: str, machine: Machine) -> Iterator[Finding]:
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


def _alternatives(names: tuple[str, ...], machine: Machine) -> str:
    """Devices that exist instead: the matches of the first pattern that has any."""
    for pattern in names:
        found = _paths(pattern, machine)
        if found:
            more = f" and {len(found) - _MAX_NAMES_SHOWN} more" if len(found) > _MAX_NAMES_SHOWN else ""
            return f"existing: {', '.join(found[:_MAX_NAMES_SHOWN])}{more}"
    return "no other exists"


def _paths(pattern: str, machine: Machine) -> list[str]:
    """Devices that match a pattern, without serial ports that have no hardware."""
    return [path for path in machine.paths(pattern) if has_hardware(Path(path), machine.at("/sys/class/tty"))]


def _usb_bus(device: Path, machine: Machine) -> tuple[str, int] | None:
    """Number of the USB bus of a camera and its speed in Mbit/s; None: it is not a USB camera."""
    status = machine.status(device)
    if status is None:
        return None
    number = f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    folder = machine.at(f"/sys/dev/char/{number}/device").resolve()
    for place in (folder, *folder.parents):
        if (place / "busnum").exists():
            try:
                return (place / "busnum").read_text().strip(), int(float((place / "speed").read_text()))
            except (OSError, ValueError):
                return None
    return None


def _gpio_chip(chip: str, machine: Machine) -> str | None:
    """Device of a chip by its label, name or path. Reading a label requires permission to open the chip."""
    for path in machine.paths("/dev/gpiochip*"):
        if chip in (path, Path(path).name) or chip == _label(str(machine.at(path))):
            return path
    return None


def _label(path: str) -> str:
    import gpiod

    try:
        with gpiod.Chip(path) as chip:
            return chip.get_info().label
    except OSError:
        return ""
