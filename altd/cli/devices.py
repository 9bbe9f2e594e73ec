"""``altd devices``: lists the devices connected to this computer, in the notation of ``altd.toml``.

Devices that another program uses are left alone, and no setting is changed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from textwrap import wrap

from altd.process.standard_streams import print_lines

SUMMARY = "list the connected cameras, GPIO lines and serial ports as settings name them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command takes no arguments."""


def run(_options: argparse.Namespace) -> int:
    """Print what is connected."""
    for line in lines():
        print_lines(line)
    return 0


_WIDTH = 110
_INDENT = " " * 6


def lines() -> Iterator[str]:
    """Yield all devices for a person, by section; a section without devices reports that, or why."""
    yield 'Cameras: [cameras.NAME], driver = "v4l2"'
    yield from _or_none(_video_cameras())
    yield ""
    yield 'Cameras: [cameras.NAME], driver = "aravis"'
    yield from _or_none(_gige_cameras())
    yield ""
    yield "GPIO chips: [lamps], [indicators]"
    yield from _or_none(_gpio_chips())
    yield ""
    yield "Serial ports: [[serial]], [inclinometer], [stage]"
    yield from _or_none(_serial_ports())


def _or_none(entries: Iterator[str]) -> Iterator[str]:
    empty = True
    for line in entries:
        empty = False
        yield line
    if empty:
        yield "  none"


def _video_cameras() -> Iterator[str]:
    from altd.devices.v4l2.find_cameras import UnreadableCamera, find_cameras

    for found in find_cameras():
        yield f'  device = "{found.path}"'
        if isinstance(found, UnreadableCamera):
            yield from _detail_lines(f"cannot be read: {found.why}")
            continue
        yield from _detail_lines(f"{found.card}, kernel driver {found.driver}")
        if found.serial is not None:
            yield f'  serial = "{found.serial}"'
        for pixel_format, sizes in found.formats.items():
            yield from _detail_lines(f'pixel_format = "{pixel_format}": {", ".join(map(str, sizes))}')
        if not found.formats:
            yield from _detail_lines("sends no grey picture that altd can use")
        settable = [f"{c.name} {c.minimum} to {c.maximum}" for c in found.controls if c.writes]
        if settable:
            yield from _detail_lines(f"controls: {', '.join(settable)}")


def _gige_cameras() -> Iterator[str]:
    try:
        from altd.devices.aravis.open_camera import find_cameras
    except ImportError as error:
        yield f"  search failed: {error}"
        return
    for found in find_cameras():
        yield f'  device = "{found.serial or found.address}"'
        yield from _detail_lines(f"{found.vendor} {found.model} at {found.address}; as an id {found.id!r}")
        if found.in_use:
            yield from _detail_lines("another program controls it now: its features were not read")
        elif found.formats:
            yield from _detail_lines("pixel_format = " + " or ".join(f'"{name}"' for name in found.formats))
        else:
            yield from _detail_lines("sends no grey picture that altd can use, or did not answer")


def _gpio_chips() -> Iterator[str]:
    from altd.devices.gpio.find_chips import chip_paths, read_chip
    from altd.ports import LampsError
    from altd.records import counted

    for path in chip_paths():
        try:
            chip = read_chip(path)
        except LampsError as error:
            yield f"  {error}"
            continue
        yield f'  chip = "{chip.label}"'
        yield from _detail_lines(f"{chip.path}, {counted(len(chip.lines), 'line')}")
        names = [
            f'"{line.name or line.offset}"' + (f" (used by {line.used_by})" if line.used_by else "")
            for line in chip.lines
        ]
        yield from _detail_lines(f"lines: {', '.join(names)}")


def _serial_ports() -> Iterator[str]:
    from altd.serial_port.opening import find_ports

    for found in find_ports():
        yield f'  device = "{found.path}"'
        now = "" if found.path == found.device else f", now {found.device}"
        yield from _detail_lines(f"{found.about}{now}")


def _detail_lines(text: str) -> Iterator[str]:
    """Yield a text below an entry, in as many lines as it needs."""
    for number, line in enumerate(wrap(text, _WIDTH - len(_INDENT) - 2, break_on_hyphens=False)):
        yield f"{_INDENT}{line}" if number == 0 else f"{_INDENT}  {line}"
