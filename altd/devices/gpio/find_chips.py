"""GPIO chips of this computer and their lines."""

from __future__ import annotations

import errno
import grp
from dataclasses import dataclass
from pathlib import Path

import gpiod

from altd.ports import LampsError


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
