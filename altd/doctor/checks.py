"""All checks, in the reading order of a technician."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from altd.app.settings import load_settings
from altd.config import Config
from altd.doctor import devices, keeping, network, system
from altd.doctor.finding import Finding
from altd.doctor.machine import Machine

Check = Callable[[], Iterator[Finding]]


def examine(place: Path | None, machine: Machine | None = None) -> list[Finding]:
    """Return the findings for the config file, or in general; raises BadInputError for the file."""
    machine = machine or Machine()
    config = None if place is None else load_settings(place)
    findings: list[Finding] = []
    for name, check in _checks(config, place, machine).items():
        try:
            findings += check()
        except Exception as error:  # a check that fails on an unusual computer must not hide the others
            findings.append(Finding.warning(name, f"could not be checked: {type(error).__name__}: {error}"))
    return findings


def _checks(config: Config | None, place: Path | None, machine: Machine) -> dict[str, Check]:
    general: dict[str, Check] = {
        "libraries": lambda: system.libraries(config),
        "clock": lambda: system.clock(system.now(), system.clock_is_kept()),
        "disk": lambda: system.disk(machine),
    }
    if config is None or place is None:
        return general | {"devices": lambda: devices.found_devices(machine)}
    return general | {
        "calibration": lambda: system.calibration(config, place),
        "cameras": lambda: devices.video_cameras(config, machine),
        "network": lambda: network.gige_cameras(config, machine),
        "gpio": lambda: devices.gpio_chips(config, machine),
        "gpio lines": lambda: devices.gpio_lines(config),
        "serial": lambda: devices.serial_ports(config, machine),
        "listening": lambda: network.listening(config, machine),
        "broker": lambda: network.broker(config),
        "history": lambda: keeping.history(config, machine),
        "kept frames": lambda: keeping.recordings(config, machine),
        "local socket": lambda: keeping.local_socket(config, machine),
    }
