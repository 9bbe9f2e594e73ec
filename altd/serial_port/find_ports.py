"""Which serial ports there are, by the names that stay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

_STABLE = (Path("/dev/serial/by-id"), Path("/dev/serial/by-path"))


@dataclass(frozen=True, slots=True)
class FoundPort:
    """One port: the path that survives re-plugging where there is one, the kernel's own, and what it is."""

    path: Path
    device: Path
    about: str


def has_hardware(device: Path, folder: Path = Path("/sys/class/tty")) -> bool:
    """Whether there is a port behind its name: of on-board ones the kernel names more than exist (type 0)."""
    try:
        return (folder / device.name / "type").read_text().strip() != "0"
    except OSError:
        return True


def find_ports() -> list[FoundPort]:
    """The serial ports of this machine by their devices' names; none is opened."""
    stable: dict[Path, Path] = {}
    for folder in _STABLE:
        for link in sorted(folder.glob("*")):
            stable.setdefault(link.resolve(), link)
    found = []
    for port in sorted(list_ports.comports()):
        device = Path(port.device)
        if not has_hardware(device):
            continue
        about = port.description if port.description not in ("n/a", port.name) else "serial port"
        found.append(FoundPort(stable.get(device.resolve(), device), device, about))
    return found
