"""Rules between the tables of a config: each yields the conflicts.

These are faults of the file itself, independent of the computer: what the daemon would refuse at its start,
retry indefinitely, or do without any effect. ``altd.doctor`` checks what depends on the computer.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from altd.config.draft import Draft
from altd.config.drivers import WITH_OUTPUTS
from altd.config.instrument_rules import beam, machine, planar, row
from altd.config.places import Keys
from altd.config.wording import Fault
from altd.devices.camera_lamps import CameraLampsSettings
from altd.devices.gpio import GpiodTable
from altd.devices.gpio import places as places_on_chip
from altd.devices.playback import RecordingCameraSettings
from altd.errors import did_you_mean
from altd.files.table import shown
from altd.process.addresses import overlap
from altd.records import counted

_MIN_TARGETS = 2
_MIN_READINGS = 3
"""Minimum readings of the inclinometer while a value is valid, and before it counts as frozen."""
_ROUNDING_S = 1e-9

Rule = Callable[[Draft], Iterator[Fault]]


def _targets(draft: Draft) -> Iterator[Fault]:
    """Check that a beam has at least two targets in beam order, each with its own name, camera, place."""
    if len(draft.targets) < _MIN_TARGETS and not draft.is_planar:
        text = f"{counted(len(draft.targets), 'table')} [[targets]]; possible: {_MIN_TARGETS} or more"
        yield Fault(("targets",), text, "table")
    there = [(number, target) for number, target in enumerate(draft.targets) if target is not None]
    for key in ("name", "camera"):
        first: dict[str, int] = {}
        for number, target in there:
            value = getattr(target, key)
            if (other := first.setdefault(value, number)) != number:
                about: Keys = ("targets", other, key)
                text = f"{shown(value)} is already the {key} of targets.{other}; choose another"
                yield Fault(("targets", number, key), text, about=(about,))
    for (before, nearer), (number, target) in itertools.pairwise(there):
        if target.z_mm <= nearer.z_mm:
            text = f"{target.z_mm:g} must exceed z_mm of targets.{before}, {nearer.z_mm:g}"
            yield Fault(("targets", number, "z_mm"), text, about=(("targets", before, "z_mm"),))


def _cameras(draft: Draft) -> Iterator[Fault]:
    """Check that each target's camera has a table, and each table a target."""
    if not draft.cameras:
        yield Fault(
            ("cameras",), "there is no table [cameras.NAME]; possible: one for each target's camera", "table"
        )
        return
    named = {target.camera for target in draft.targets if target is not None}
    for number, target in enumerate(draft.targets):
        if target is not None and target.camera not in draft.cameras:
            suggestion = did_you_mean(target.camera, draft.cameras)
            possible = ", ".join(map(shown, draft.cameras))
            text = f"there is no table [cameras.{target.camera}]; possible: {possible}{suggestion}"
            yield Fault(("targets", number, "camera"), text, about=(("cameras",),))
    if len(named) == len(draft.targets) and named <= draft.cameras.keys() and not draft.is_planar:
        for name in draft.cameras.keys() - named:
            text = "no target has this camera: it is never opened; possible: a target for it, or no table"
            yield Fault(("cameras", name), text, "key", about=(("targets",),))


def _cameras_of_one_kind(draft: Draft) -> Iterator[Fault]:
    """Check that all cameras play one recording in step, or that all are live and paired by time."""
    live = draft.live()
    measuring = draft.measuring
    playing = [
        (name, table) for name, table in draft.cameras.items() if isinstance(table, RecordingCameraSettings)
    ]
    for name, recording in playing:
        if live:
            other = next(iter(live))
            text = f'"recording" does not go with the live camera {shown(other)}; possible: all or none'
            yield Fault(("cameras", name, "driver"), text, about=(("cameras", other, "driver"),))
        first, leader = playing[0]
        for key in ("path", "pace", "repeat"):
            mine, its = getattr(recording, key), getattr(leader, key)
            if mine != its:
                value = "true" if its is True else "false" if its is False else shown(str(its))
                text = f"differs from that of camera {shown(first)}, and they play as one; possible: {value}"
                yield Fault(("cameras", name, key), text, about=(("cameras", first, key),))
    if live and not playing and measuring is not None and measuring.pair_by == "sequence":
        text = (
            '"sequence" is for recordings; possible: "time", for live cameras count each from its own start'
        )
        yield Fault(("measuring", "pair_by"), text, about=tuple(("cameras", name, "driver") for name in live))


def _rates(draft: Draft) -> Iterator[Fault]:
    """Check that all live cameras have one rate, which fits exposure, silence and stale time."""
    live = draft.live()
    if not live:
        return
    first, leader = next(iter(live.items()))
    rates: tuple[Keys, ...] = tuple(("cameras", name, "fps") for name in live)
    for name, camera in live.items():
        rate: Keys = ("cameras", name, "fps")
        if camera.fps != leader.fps:
            text = f"{camera.fps:g} is not the rate of camera {shown(first)}; possible: {leader.fps:g}"
            yield Fault(rate, text, about=(("cameras", first, "fps"),))
        period_ms, exposure = 1000 / camera.fps, camera.exposure
        if exposure.control == "fixed" and exposure.exposure_ms > period_ms:
            text = (
                f"{exposure.exposure_ms:g} is longer than from frame to frame; possible: up to {period_ms:g}"
            )
            yield Fault(("cameras", name, "exposure", "exposure_ms"), text, about=(rate,))
        if exposure.control == "auto" and exposure.shortest_ms > period_ms:
            text = (
                f"{exposure.shortest_ms:g} is longer than from frame to frame; possible: up to {period_ms:g}"
            )
            yield Fault(("cameras", name, "exposure", "shortest_ms"), text, about=(rate,))
    measuring, fps = draft.measuring, min(camera.fps for camera in live.values())
    if measuring is None:
        return
    triggered = [name for name, camera in live.items() if camera.software_triggered]
    if triggered and (others := live.keys() - set(triggered)):
        text = (
            f'"software" does not go with camera {shown(min(others))} at its own times; possible: all or none'
        )
        about = tuple(("cameras", name, "driver") for name in others)
        yield Fault(("cameras", triggered[0], "trigger"), text, about=about)
    longest_s = (1.5 if triggered else 1) / fps
    if measuring.silent_after_s <= longest_s:
        text = f"{measuring.silent_after_s:g} is shorter than a frame interval; possible: above {longest_s:g}"
        yield Fault(("measuring", "silent_after_s"), text, about=rates)
    next_s = (measuring.every - 1) / fps + longest_s
    if measuring.stale_after_s <= next_s:
        text = f"{measuring.stale_after_s:g} is shorter than a value interval; possible: above {next_s:g}"
        yield Fault(("measuring", "stale_after_s"), text, about=(("measuring", "every"), *rates))


MIN_WINDOW_OF_NOW = 8
"""Minimum window: half of it suffices for a measurement (``averaging``), and steady motion needs four
exposures."""


def _output(draft: Draft) -> Iterator[Fault]:
    """Check that the output `now` has a window long enough to determine the beam's motion."""
    measuring = draft.measuring
    if measuring is not None and measuring.output == "now" and measuring.window < MIN_WINDOW_OF_NOW:
        text = (
            f'{measuring.window} exposures are too few for output = "now"; possible: from {MIN_WINDOW_OF_NOW}'
        )
        yield Fault(("measuring", "window"), text, about=(("measuring", "output"),))


def _one_camera_twice(draft: Draft) -> Iterator[Fault]:
    """Check that no two tables use the same camera."""
    first: dict[tuple[str, str], str] = {}
    for name, camera in draft.live().items():
        device = os.path.normpath(camera.device) if isinstance(camera.device, Path) else camera.device
        for key, value in (("device", device), ("serial", camera.serial)):
            if value is not None and (other := first.setdefault((key, value), name)) != name:
                instead = "choose another camera"
                if key == "serial" and isinstance(camera.device, Path):
                    instead += ", or leave serial out of both: device below /dev/v4l/by-path is one port"
                text = f"{shown(value)} is already the {key} of camera {shown(other)}; {instead}"
                yield Fault(("cameras", name, key), text, about=(("cameras", other, key),))


def _listeners(draft: Draft) -> Iterator[Fault]:
    """Check that no two interfaces listen on one port of one address; port 0 is any free one."""
    listeners = [
        (name, table, getattr(table, "port_or_default", table.port))
        for name, table in (("modbus_tcp", draft.modbus_tcp), ("http", draft.http), ("opcua", draft.opcua))
        if table is not None
    ]
    for (first, one, port), (second, other, same) in itertools.combinations(listeners, 2):
        if port and port == same and overlap(one.host, other.host):
            about: tuple[Keys, ...] = ((first, "port"), (first, "host"), (second, "host"))
            text = f"port {port} is already used by [{first}]; choose another"
            yield Fault((second, "port"), text, about=about)


def _certificates(draft: Draft) -> Iterator[Fault]:
    """Check that certificates have the key and authority they need, and commands over TLS a role."""
    pairs = [("certificate", "key"), ("key", "certificate")]
    of_modbus = [("certificate", "client_ca"), ("client_ca", "certificate"), ("certificate", "roles")]
    for name, table, more in (
        ("http", draft.http, []),
        ("mqtt", draft.mqtt, [("ca", "certificate")]),
        ("modbus_tcp", draft.modbus_tcp, of_modbus),
        ("opcua", draft.opcua, [("certificate", "credentials")]),
    ):
        for one, other in [*pairs, *more]:
            if table is not None and getattr(table, one) is None and getattr(table, other):
                text = f"is set without {one}; possible: both"
                yield Fault((name, other), text, about=((name, one),))
    if (modbus := draft.modbus_tcp) is not None and modbus.certificate is not None and not modbus.roles:
        for key in (key for key in ("allow_self_check", "allow_zero") if getattr(modbus, key)):
            text = "is set without roles; possible: both: over TLS a client needs a role"
            yield Fault(("modbus_tcp", key), text, about=(("modbus_tcp", "roles"),))


def _sparkplug(draft: Draft) -> Iterator[Fault]:
    """Check that Sparkplug is not combined with Home Assistant or the ingest, which read JSON topics."""
    if draft.mqtt is None or draft.mqtt.sparkplug is None:
        return
    for key in ("home_assistant", "store_and_forward"):
        if getattr(draft.mqtt, key):
            text = "does not go with [mqtt.sparkplug]; possible: one of the two"
            yield Fault(("mqtt", key), text, about=(("mqtt", "sparkplug"),))


def _outbox(draft: Draft) -> Iterator[Fault]:
    """Check that the history is enabled if there is an outbox, which is a table of its file."""
    is_kept = draft.history is None or draft.history.enabled
    if draft.mqtt is not None and draft.mqtt.store_and_forward and not is_kept:
        text = "needs the history; possible: enabled = true in [history]"
        yield Fault(("mqtt", "store_and_forward"), text, about=(("history", "enabled"),))


def _serial_ports(draft: Draft) -> Iterator[Fault]:
    """Check that each serial port is used only once."""
    first: dict[str, Keys] = {}
    places: list[tuple[Keys, str]] = [
        (("serial", number, "device"), os.path.normpath(port.device))
        for number, port in enumerate(draft.serial)
        if port is not None
    ]
    for name, table in (("inclinometer", draft.inclinometer), ("stage", draft.stage)):
        if table is not None:
            places.append(((name, "device"), os.path.normpath(table.device)))
    for keys, device in places:
        if (other := first.setdefault(device, keys)) != keys:
            text = f"{shown(device)} is already used by {'.'.join(map(str, other[:-1]))}; choose another port"
            yield Fault(keys, text, about=(other,))


def _inclinometer(draft: Draft) -> Iterator[Fault]:
    """Check that a roll value outlasts lost responses, and that frozen means several equal readings."""
    table = draft.inclinometer
    if table is None:
        return
    least_s = _MIN_READINGS * table.interval_s
    for key in ("max_age_s", "frozen_after_s"):
        if (value := getattr(table, key)) < least_s - _ROUNDING_S:
            text = f"{value:g} is too short for readings each {table.interval_s:g} s"
            about: tuple[Keys, ...] = (("inclinometer", "interval_s"),)
            yield Fault(("inclinometer", key), f"{text}; possible: from {least_s:g}", about=about)


def _lamps_on_cameras(draft: Draft) -> Iterator[Fault]:
    """Check that lamps are on outputs of GigE Vision cameras that measure."""
    if not isinstance(draft.lamps, CameraLampsSettings):
        return
    named = {target.camera for target in draft.targets if target is not None}
    for number, name in enumerate(draft.lamps.cameras):
        keys: Keys = ("lamps", "cameras", number)
        camera = draft.cameras.get(name)
        table: Keys = ("cameras", name)
        if name not in draft.cameras:
            suggestion = did_you_mean(name, draft.cameras)
            yield Fault(keys, f"there is no table [cameras.{name}]{suggestion}")
        elif camera is not None and not camera.has_outputs:
            text = f"{shown(name)} has no output; possible: a camera with driver {WITH_OUTPUTS}"
            yield Fault(keys, text, about=(table,))
        elif name not in named and None not in draft.targets and named <= draft.cameras.keys():
            yield Fault(keys, f"{shown(name)} has no target and is not opened; possible: a target's camera")
        elif name in draft.lamps.cameras[:number]:
            yield Fault(keys, f"{shown(name)} is in the list twice; possible: each camera once")
        elif camera is not None and camera.trigger_input == draft.lamps.line:
            text = f"{shown(draft.lamps.line)} triggers camera {shown(name)}; possible: another line"
            yield Fault(("lamps", "line"), text, about=((*table, "trigger_line"), (*table, "trigger")))


def _gpio_lines(draft: Draft) -> Iterator[Fault]:
    """Check that each GPIO line has only one lamp or glass."""
    places: list[tuple[Keys, str, str]] = []
    for key in ("lamps", "switches", "indicators"):
        if isinstance(table := getattr(draft, key), GpiodTable):
            places += [((key, *keys), table.chip, line) for keys, line in places_on_chip(table).items()]
    first: dict[tuple[str, str], Keys] = {}
    for keys, chip, line in places:
        if (other := first.setdefault((chip.removeprefix("/dev/"), line), keys)) != keys:
            where = ".".join(map(str, other))
            text = f"{shown(line)} is already the line of {where}; choose another"
            yield Fault(keys, text, about=(other, ("lamps", "chip"), ("indicators", "chip")))


def _thermometers(draft: Draft) -> Iterator[Fault]:
    """Check that thermometers have unique names, and that the upper limits exceed the lower ones."""
    first: dict[str, int] = {}
    for number, settings in enumerate(draft.thermometers):
        if settings is None:
            continue
        if (other := first.setdefault(settings.name, number)) != number:
            text = f"{shown(settings.name)} is already the name of thermometers.{other}; choose another"
            yield Fault(("thermometers", number, "name"), text, about=(("thermometers", other, "name"),))
        yield from _celsius((settings.min_celsius, settings.max_celsius), ("thermometers", number))
    of_frame = None if draft.installation is None else draft.installation.thermometer
    if of_frame is not None and of_frame not in first and None not in draft.thermometers:
        text = f"{shown(of_frame)} is not the name of a thermometer{did_you_mean(of_frame, first)}"
        yield Fault(("installation", "thermometer"), text, about=(("thermometers",),))
    for name, camera in draft.cameras.items():
        if camera is not None and camera.celsius_limits is not None:
            yield from _celsius(camera.celsius_limits, ("cameras", name))


def _celsius(limits: tuple[float, float], table: Keys) -> Iterator[Fault]:
    lowest, highest = limits
    if highest <= lowest:
        text = f"{highest:g} is not warmer; possible: above {lowest:g}"
        yield Fault((*table, "max_celsius"), text, about=((*table, "min_celsius"),))


RULES: tuple[Rule, ...] = (
    beam,
    machine,
    row,
    planar,
    _targets,
    _cameras,
    _cameras_of_one_kind,
    _rates,
    _output,
    _one_camera_twice,
    _listeners,
    _certificates,
    _sparkplug,
    _outbox,
    _serial_ports,
    _inclinometer,
    _lamps_on_cameras,
    _gpio_lines,
    _thermometers,
)
