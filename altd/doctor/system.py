"""Checks of the computer itself: libraries, clock, disk, and the calibration."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from altd.config import Config
from altd.config.drivers import DRIVERS
from altd.devices.playback import RecordingCameraSettings
from altd.errors import BadInputError
from altd.process.machine import Finding, Machine
from altd.vision import kernel

STATE = "/var/lib/altd"
MIN_FREE_BYTES = 500_000_000
MIN_YEAR = 2026
"""Minimum year of the clock: this release is no older, so an earlier year means that it was never set."""

_UNSYNCHRONISED = 0x40
_MAX_PRESSURE = 0.25
"""Maximum share of a minute in which programs may wait for a processor: altd alone causes some per cent."""
_MAX_OF_HOST = 0.05
"""Maximum share of the processors that the host of a virtual machine may take away."""
_SHOWN_PROGRAMS = 3


def libraries(config: Config | None) -> Iterator[Finding]:
    """Check the libraries of the drivers that the config names; without a config, of all drivers."""
    used = DRIVERS if config is None else config.tables_by_driver()
    if kernel.is_compiled():
        yield Finding.good("spot fit", "compiled")
    else:
        remedy = "sudo apt-get install gcc   # and install the release again (docs/install.md)"
        yield Finding.warning("spot fit", f"{kernel.description}; it takes more CPU", remedy)
    yield from (driver.library(config is not None) for driver in used if driver.library)


def clock(now: datetime, synchronised: bool | None) -> Iterator[Finding]:
    """Check the clock: UTC is in every output. ``synchronised`` is the kernel's report; None: unknown."""
    subject, remedy = "clock", "sudo timedatectl set-ntp true   # or set up chrony"
    if now.year < MIN_YEAR:
        yield Finding.error(
            subject, f"shows {now:%Y-%m-%d %H:%M}, which is in the past: it was never set", remedy
        )
    elif synchronised:
        yield Finding.good(subject, f"{now:%Y-%m-%d %H:%M} UTC, synchronised with a time server")
    elif synchronised is None:
        yield Finding.warning(
            subject, f"{now:%Y-%m-%d %H:%M} UTC; it is not known whether it is synchronised", "timedatectl"
        )
    else:
        yield Finding.error(subject, f"{now:%Y-%m-%d %H:%M} UTC, not synchronised with a time server", remedy)


def processors(machine: Machine, sleep: Callable[[float], None]) -> Iterator[Finding]:
    """Check whether other programs, or the host of a virtual machine, leave processors for altd.

    The kernel's pressure is the share of the last minute in which a program waited for a processor (PSI); the
    host's share and the programs are those of the second that the check takes.
    """
    before, host_before = _cpu_ticks(machine), _host_ticks(machine)
    sleep(1.0)
    ticks, host_ticks = os.sysconf("SC_CLK_TCK"), _host_ticks(machine) - host_before
    shares = {name: (used - before.get(name, used)) / ticks for name, used in _cpu_ticks(machine).items()}
    names = [f"{name[1]} ({share:.0%})" for name, share in sorted(shares.items(), key=lambda one: -one[1])]
    host = host_ticks / ticks / max(os.cpu_count() or 1, 1)
    found = re.search(r"some avg10=\S+ avg60=(\S+)", machine.text("/proc/pressure/cpu"))
    pressure = float(found[1]) / 100 if found else None
    waited = "" if pressure is None else f"programs waited {pressure:.0%} of the last minute for a processor"
    subject, most = "processors", f"busiest now: {', '.join(names[:_SHOWN_PROGRAMS]) or 'none'}"
    if host > _MAX_OF_HOST:
        text = f"the host of this virtual machine takes {host:.0%} of them away"
        yield Finding.warning(subject, text, "# give this virtual machine processors of its own")
    elif pressure is None:
        yield Finding.skipped(subject, f"the kernel does not report its pressure; {most}")
    elif pressure > _MAX_PRESSURE:
        remedy = "ps -eo pid,user,pcpu,args --sort=-pcpu | head   # end programs that the unit does not need"
        yield Finding.warning(subject, f"{waited}; {most}", remedy)
    else:
        yield Finding.good(subject, waited)


def _host_ticks(machine: Machine) -> int:
    """Return the time that the host took away from all processors (proc(5), stat, steal), clock ticks."""
    words = machine.text("/proc/stat").partition("\n")[0].split()
    return int(words[8]) if len(words) > 8 else 0


def _cpu_ticks(machine: Machine) -> dict[tuple[str, str], int]:
    """Return the processor time of each program by its number and name, clock ticks (proc(5), pid/stat)."""
    used = {}
    for path in machine.paths("/proc/[0-9]*/stat"):
        head, _, tail = machine.text(path).rpartition(") ")
        number, _, name = head.partition(" (")
        if len(words := tail.split()) > 12:
            used[number, name] = int(words[11]) + int(words[12])
    return used


def disk(machine: Machine) -> Iterator[Finding]:
    """Check the disk for recordings."""
    folder = machine.at(STATE)
    while not folder.is_dir() and folder != machine.root:
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    subject, text = f"disk of {STATE}", f"{free / 1e9:.1f} GB free"
    if free >= MIN_FREE_BYTES:
        yield Finding.good(subject, text)
    else:
        yield Finding.error(subject, text, f"sudo du -xhd1 {STATE} /var | sort -h   # largest folders")


def calibration(config: Config, place: Path) -> Iterator[Finding]:
    """Check the recordings that are played, the calibration file, and whether it is that of this unit."""
    from altd.app.parts import calibration_of, cameras_of

    path = config.unit.calibration
    played = all(isinstance(camera, RecordingCameraSettings) for camera in config.cameras.values())
    try:
        cameras = cameras_of(config, place) if played and config.cameras else {}
    except BadInputError as error:
        yield Finding.error("recording", str(error), f"correct path in {place}, or copy the recording there")
        cameras = {}
    try:
        found = calibration_of(config, cameras)
    except BadInputError as error:
        remedy = f"altd calibrate SCAN -o {path}   # or copy the unit's own there, or correct {place}"
        yield Finding.error("calibration", str(error), remedy)
    else:
        text = f"{path} fits {config.unit.serial}, made on {found.created:%Y-%m-%d}"
        if found.simulated:
            remedy = f"altd calibrate SCAN -o {path}   # with a scan of the unit itself, made by altd scan"
            yield Finding.warning("calibration", f"{text}, of SIMULATED frames: for trials only", remedy)
        else:
            yield Finding.good("calibration", text)


def desk(config: Config) -> Iterator[Finding]:
    """Name the parts that a desk unit does without; those that it has are checked as any unit's."""
    parts = {
        "frame LEDs and self-check": config.lamps,
        "lamps on the housing": config.indicators,
        "inclinometer": config.inclinometer,
        "thermometers": config.thermometers,
    }
    lacking = [name for name, table in parts.items() if not table]
    if config.unit.kind == "desk" and lacking:
        yield Finding.skipped("desk unit", f"does not apply: {', '.join(lacking)}")


def now() -> datetime:
    """The computer's UTC."""
    return datetime.fromtimestamp(time.time(), UTC)


def clock_is_kept() -> bool | None:
    """Whether the kernel reports a synchronised clock (adjtimex(2), as timedatectl reads it)."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        timex = (ctypes.c_long * 64)()  # longer than struct timex; modes = 0 only reads
        if libc.adjtimex(ctypes.byref(timex)) < 0:
            return None
    except (OSError, AttributeError):
        return None
    status = ctypes.c_int.from_buffer(
        timex, 5 * ctypes.sizeof(ctypes.c_long)
    ).value  # after five fields of a word each
    return not status & _UNSYNCHRONISED
