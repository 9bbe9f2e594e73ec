"""Rules of the instruments: switched targets of a beam, a row of them, and a plate."""

from __future__ import annotations

from collections.abc import Iterator, Set

from altd.config.draft import Draft
from altd.config.drivers import WITH_OUTPUTS
from altd.config.interfaces import TelegramPortSettings
from altd.config.places import Keys
from altd.config.unit import Installation
from altd.config.wording import Fault
from altd.devices.camera_lamps import CameraLampsSettings, CameraSwitchesSettings
from altd.devices.gpio import GpiodSwitchesSettings
from altd.devices.playback import RecordingCameraSettings
from altd.errors import did_you_mean
from altd.files.table import shown
from altd.records import counted

_MAX_ROW_TARGETS = 16
_KIND: Keys = ("unit", "instrument")


def beam(draft: Draft) -> Iterator[Fault]:
    """Check that each switched target of a beam has a target behind it, and a switch."""
    if draft.unit is None or draft.unit.instrument != "beam":
        return
    if draft.switched:
        yield from _switches(draft)
    elif draft.switches is not None and None not in draft.targets:
        text = "no target has switched = true; possible: with one, or no table"
        yield Fault(("switches",), text, "key", about=(("targets",),))
    if draft.targets and (last := draft.targets[-1]) is not None and last.switched:
        text = "true, and no target is behind it; possible: false"
        yield Fault(("targets", len(draft.targets) - 1, "switched"), text)


def machine(draft: Draft) -> Iterator[Fault]:
    """Check that the machine's points have names of their own, and only one roll."""
    if draft.machine is None:
        return
    names = [point.name for point in draft.machine.points]
    for number, name in enumerate(names):
        if name in names[:number]:
            text = f"{shown(name)} is already the name of a point; choose another"
            yield Fault(("machine", "points", number, "name"), text)
    if draft.machine.roll_deg is not None and draft.inclinometer is not None:
        text = "roll is already measured by the inclinometer; possible: without roll_deg"
        yield Fault(("machine", "roll_deg"), text, about=(("inclinometer",),))


def row(draft: Draft) -> Iterator[Fault]:
    """Check that a row has at most 16 targets, only existing stable ones, and a switch for each glass."""
    if not draft.is_row:
        if draft.unit is not None and draft.chain is not None:
            text = 'is for instrument = "chain"; possible: with it, or no table'
            yield Fault(("chain",), text, "key", about=(_KIND,))
        return
    if len(draft.targets) > _MAX_ROW_TARGETS:
        text = f"{len(draft.targets)} targets are too many for a row; possible: up to {_MAX_ROW_TARGETS}"
        yield Fault(("targets", _MAX_ROW_TARGETS), text, "key", about=(_KIND,))
    names = [target.name for target in draft.targets if target is not None]
    stable = () if draft.chain is None else draft.chain.stable
    for number, name in enumerate(stable):
        keys: Keys = ("chain", "stable", number)
        if name in stable[:number]:
            yield Fault(keys, f"{shown(name)} is in the list twice; possible: each target once")
        elif name not in names and None not in draft.targets:
            text = f"there is no target {shown(name)}{did_you_mean(name, names)}"
            yield Fault(keys, f"{text}; possible: {', '.join(map(shown, names))}", about=(("targets",),))
    for key in sorted(
        {"settle_s", "exposures"} & (draft.switches.model_fields_set if draft.switches else set())
    ):
        text = "is for a beam with a switched target; possible: the same key in [chain]"
        yield Fault(("switches", key), text, "key", about=(_KIND,))
    yield from _switches(draft)
    yield from _no_part_of_a_beam(draft, ("installation", "machine", "lamps", "inclinometer"))


def _switches(draft: Draft) -> Iterator[Fault]:
    """Check that live cameras have switches for the glasses and that a recording has none."""
    switches, switched = draft.switches, draft.switched
    if switches is None:
        if draft.live():
            text = 'the glasses cannot be switched; possible: a table with driver "gpiod" or "camera"'
            yield Fault(("switches",), text, "table", about=(_KIND,))
        return
    for name, camera in draft.cameras.items():
        if isinstance(camera, RecordingCameraSettings):
            text = "glasses of a recording cannot be switched again; possible: no table"
            yield Fault(("switches",), text, "key", about=(("cameras", name, "driver"),))
    if isinstance(switches, CameraSwitchesSettings):
        yield from _outputs(draft, switches.line, {target.camera for target in switched})
    elif isinstance(switches, GpiodSwitchesSettings) and len(switches.lines) != len(switched):
        targets = counted(len(switched), "target" if draft.is_row else "switched target")
        text = f"{counted(len(switches.lines), 'line')} for {targets}; possible: one for each"
        yield Fault(("switches", "lines"), text, about=(("targets",),))


def _outputs(draft: Draft, line: str, names: Set[str]) -> Iterator[Fault]:
    """Check that the cameras of switched targets have an output that is not used otherwise."""
    place: Keys = ("switches", "line")
    for name in sorted(names & draft.cameras.keys()):
        camera, table = draft.cameras[name], ("cameras", name)
        if camera is None or isinstance(camera, RecordingCameraSettings):
            continue
        if not camera.has_outputs:
            possible = f'cameras with driver {WITH_OUTPUTS}, or driver "gpiod"'
            text = f"{shown(name)} has no output; possible: {possible}"
            yield Fault(("switches", "driver"), text, about=(table,))
        elif camera.trigger_input == line:
            text = f"{shown(line)} triggers camera {shown(name)}; possible: another line"
            yield Fault(place, text, about=((*table, "trigger_line"), (*table, "trigger")))
        elif isinstance(draft.lamps, CameraLampsSettings) and (line, name) in [
            (draft.lamps.line, of) for of in draft.lamps.cameras
        ]:
            text = f"{shown(line)} of camera {shown(name)} switches the frame LEDs; possible: another line"
            yield Fault(place, text, about=(("lamps", "line"),))


def planar(draft: Draft) -> Iterator[Fault]:
    """Check that a plate has one camera of fixed exposure, no targets, and no part of a beam."""
    if not draft.is_planar:
        if draft.plate is not None and draft.unit is not None:
            text = 'is for instrument = "planar"; possible: with it, or no table'
            yield Fault(("plate",), text, "key", about=(_KIND,))
        return
    if draft.targets:
        yield Fault(("targets",), "a plate has no targets; possible: no table", "key", about=(_KIND,))
    if len(draft.cameras) > 1:
        names = ", ".join(map(shown, draft.cameras))
        text = f"{names} are too many for a plate; possible: one"
        yield Fault(("cameras",), text, "key", about=(_KIND,))
    yield from _no_part_of_a_beam(
        draft, ("installation", "machine", "lamps", "switches", "inclinometer", "stage")
    )


def _no_part_of_a_beam(draft: Draft, tables: tuple[str, ...]) -> Iterator[Fault]:
    """Check for no automatic exposure, no output "now", no telegram of it, and none of these tables."""
    faults: list[tuple[Keys, str]] = [
        (("cameras", name, "exposure", "control"), '"auto" follows a spot; possible: "fixed", "camera"')
        for name, camera in draft.live().items()
        if camera.exposure.control == "auto"
    ]
    if draft.measuring is not None and draft.measuring.output == "now":
        faults.append((("measuring", "output"), '"now" is for a beam; possible: "mean"'))
    faults += [
        ((key,), "is for a beam; possible: no table")
        for key in tables
        if getattr(draft, key) not in (None, Installation())
    ]
    faults += [
        (("serial", number, "sigma_now"), "true is for a beam; possible: false")
        for number, port in enumerate(draft.serial)
        if isinstance(port, TelegramPortSettings) and port.sigma_now
    ]
    for keys, text in faults:
        yield Fault(keys, text, "key" if len(keys) == 1 else "value", about=(_KIND,))
