"""GPIO chips of this computer and their lines; checks of those that a config names."""

from __future__ import annotations

import errno
import grp
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import gpiod

from altd.devices.gpio import GpiodTable, places
from altd.devices.nodes import check_node, existing
from altd.devices.settings import details
from altd.ports import LampsError
from altd.process.machine import Finding, Machine
from altd.records import counted


@dataclass(frozen=True, slots=True)
class GpioLine:
    """One line: its number on the chip, its name ("" when it has none) and its consumer (None: free)."""

    offset: int
    name: str
    used_by: str | None


@dataclass(frozen=True, slots=True)
class GpioChip:
    """One chip. The kernel renumbers names and paths when chips are added or removed; the label stays."""

    path: Path
    name: str
    label: str
    lines: tuple[GpioLine, ...]

    def __str__(self) -> str:
        """Chip for messages: label and path."""
        return f"GPIO chip {self.label!r} ({self.path})"


def chip_paths() -> list[Path]:
    """Device paths of the chips. A link, as udev creates it for an old name, is not a further chip."""
    nodes = [path for path in Path("/dev").glob("gpiochip*") if not path.is_symlink()]
    return sorted(nodes, key=lambda path: (len(path.name), path.name))


def read_chip(path: Path) -> GpioChip:
    """Read the current state of the chip behind a device; raises LampsError that names the device."""
    try:
        with gpiod.Chip(str(path)) as chip:
            about = chip.get_info()
            infos = [chip.get_line_info(offset) for offset in range(about.num_lines)]
    except OSError as error:
        raise LampsError(_opening_failure(path, error)) from error
    lines = tuple(
        GpioLine(info.offset, info.name or "", (info.consumer or "the kernel") if info.used else None)
        for info in infos
    )
    return GpioChip(path, about.name, about.label, lines)


def find_chip(wanted: str) -> GpioChip:
    """Return the chip with that label, name or path; raises LampsError that lists the available chips."""
    if wanted.startswith("/"):
        return read_chip(Path(wanted))
    found: list[GpioChip] = []
    closed: list[str] = []
    for path in chip_paths():
        try:
            found.append(read_chip(path))
        except LampsError as error:
            closed.append(str(error))
    fitting = [chip for chip in found if wanted in (chip.label, chip.name)]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        paths = ", ".join(str(chip.path) for chip in fitting)
        raise LampsError(f"{len(fitting)} GPIO chips have the name {wanted!r}: give the path, one of {paths}")
    there = ", ".join(f"{chip.label!r} ({chip.name})" for chip in found) or "none"
    raise LampsError("; ".join([f"no GPIO chip {wanted!r}, those that can be opened: {there}", *closed]))


def find_line(chip: GpioChip, wanted: str) -> GpioLine:
    """Return the line by name or, because many chips name none, by number; raises LampsError."""
    fitting = [line for line in chip.lines if line.name == wanted]
    if len(fitting) > 1:
        numbers = ", ".join(str(line.offset) for line in fitting)
        raise LampsError(f"{chip} has {len(fitting)} lines {wanted!r}: give the number, one of {numbers}")
    if not fitting and wanted.isdecimal():
        fitting = [line for line in chip.lines if line.offset == int(wanted)]
    if not fitting:
        names = ", ".join(repr(line.name) for line in chip.lines if line.name)
        there = names or f"{len(chip.lines)} without names, give the number, from 0"
        raise LampsError(f"{chip} has no line {wanted!r}, its lines: {there}")
    return fitting[0]


def _opening_failure(path: Path, error: OSError) -> str:
    match error.errno:
        case errno.EACCES:
            return f"no permission to open {path}, which is for {_group_of(path)}"
        case errno.EPERM:
            return f"no permission to open {path}: the service may not (DeviceAllow=char-gpiochip)"
        case errno.ENOENT:
            return f"there is no {path}"
        case errno.ENODEV | errno.ENOTTY:
            return f"{path} is not a GPIO chip"
    return f"{path}: {error.strerror or error}"


def _group_of(path: Path) -> str:
    """Group that may open the device, for messages."""
    try:
        status = path.stat()
    except OSError:
        return "others"
    if not status.st_mode & 0o060 or status.st_gid == 0:
        return "root only: see docs/selfcheck.md"
    try:
        return f"group {grp.getgrgid(status.st_gid).gr_name}"
    except KeyError:
        return f"group {status.st_gid}"


def lines() -> Iterator[str]:
    """Yield the chips and their lines for ``altd devices``."""
    for path in chip_paths():
        try:
            chip = read_chip(path)
        except LampsError as error:
            yield f"  {error}"
            continue
        yield f'  chip = "{chip.label}"'
        yield from details(f"{chip.path}, {counted(len(chip.lines), 'line')}")
        names = [
            f'"{line.name or line.offset}"' + (f" (used by {line.used_by})" if line.used_by else "")
            for line in chip.lines
        ]
        yield from details(f"lines: {', '.join(names)}")


def check(tables: Mapping[str, GpiodTable], machine: Machine) -> Iterator[Finding]:
    """Check the chips and the lines of the tables."""
    yield from _check_chips(dict.fromkeys(table.chip for table in tables.values()), machine)
    yield from check_lines(tables)


def _check_chips(chips: Iterable[str], machine: Machine) -> Iterator[Finding]:
    for chip in chips:
        subject, path = f"gpio {chip}", _gpio_chip(chip, machine)
        if path is not None:
            yield from check_node(subject, Path(path), ("/dev/gpiochip*",), machine)
        else:
            there = existing(("/dev/gpiochip*",), machine)
            yield Finding.error(subject, f"no accessible chip has this name; {there}", "sudo gpiodetect")


def check_lines(tables: Mapping[str, GpiodTable]) -> Iterator[Finding]:
    """Check the lines, of chips that may be opened: each must exist and be used only once."""
    named = [
        (key if keys[0] == "lines" else f"{key}.{keys[0]}", table.chip, line)
        for key, table in tables.items()
        for keys, line in places(table).items()
    ]
    first: dict[tuple[Path, int], str] = {}
    for key, wanted, name in named:
        try:
            chip = find_chip(wanted)
        except LampsError:
            continue  # the finding of the chip itself reports it
        subject, remedy = f"gpio {wanted} {name}", "altd devices   # use one of these names in the settings"
        try:
            line = find_line(chip, name)
        except LampsError as error:
            yield Finding.error(subject, f"{key}: {error}", remedy)
            continue
        if (other := first.setdefault((chip.path, line.offset), key)) != key:
            yield Finding.error(
                subject, f"{key} is the same line as {other}, {line.offset} of {chip}", remedy
            )


def _gpio_chip(chip: str, machine: Machine) -> str | None:
    """Device of a chip by its label, name or path. Reading a label requires permission to open the chip."""
    for path in machine.paths("/dev/gpiochip*"):
        if chip in (path, Path(path).name) or chip == _label(str(machine.at(path))):
            return path
    return None


def _label(path: str) -> str:
    try:
        with gpiod.Chip(path) as chip:
            return chip.get_info().label
    except OSError:
        return ""
