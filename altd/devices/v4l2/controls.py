"""Controls of a camera by name, such as ``gain`` or ``trigger_mode``."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

from altd.devices.v4l2 import V4l2CameraSettings, abi
from altd.devices.v4l2.node import VideoNode, text
from altd.ports import CameraRefusedError

_KINDS = {
    abi.V4L2_CTRL_TYPE_INTEGER: "integer",
    abi.V4L2_CTRL_TYPE_BOOLEAN: "boolean",
    abi.V4L2_CTRL_TYPE_MENU: "menu",
    abi.V4L2_CTRL_TYPE_INTEGER_MENU: "menu",
    abi.V4L2_CTRL_TYPE_BITMASK: "bits",
    abi.V4L2_CTRL_TYPE_BUTTON: "button",
}
"""Control types whose value is one 32-bit number, by their names here."""


MANUAL_EXPOSURE = 1
_OFF_OF_EXPOSURE = {
    abi.V4L2_CID_EXPOSURE_AUTO: MANUAL_EXPOSURE,
    abi.V4L2_CID_EXPOSURE_AUTO_PRIORITY: 0,
    abi.V4L2_CID_AUTOGAIN: 0,
}
_OFF = _OFF_OF_EXPOSURE | {abi.V4L2_CID_AUTO_WHITE_BALANCE: 0, abi.V4L2_CID_FOCUS_AUTO: 0}
"""Automatic modes, with the value that switches each off ("Camera Control Reference" of the kernel)."""


@dataclass(frozen=True, slots=True)
class Control:
    """One control as the driver describes it; a menu has the values from ``minimum`` to ``maximum``."""

    number: int
    name: str
    kind: str
    minimum: int
    maximum: int
    step: int
    default: int
    reads: bool
    writes: bool

    def value(self, node: VideoNode) -> int:
        """Current value; raises OSError."""
        return int(node.call(abi.VIDIOC_G_CTRL, abi.v4l2_control(self.number)).value)

    def set(self, node: VideoNode, value: int) -> None:
        """Set exactly this value; raises CameraRefusedError when the camera rejects it, or OSError."""
        beyond = self.kind != "button" and not self.minimum <= value <= self.maximum
        if beyond or not self.writes:  # the kernel would take the nearest
            raise CameraRefusedError(f"control {self.name} does not take {value}: {self}")
        try:
            taken = int(node.call(abi.VIDIOC_S_CTRL, abi.v4l2_control(self.number, value)).value)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ERANGE, errno.EACCES):
                raise CameraRefusedError(f"control {self.name} does not take {value}: {self}") from error
            if error.errno == errno.EBUSY:
                raise CameraRefusedError(f"control {self.name} cannot be set now") from error
            raise
        if self.reads and taken != value:
            raise CameraRefusedError(f"control {self.name} makes {taken} of {value}: {self}")

    def __str__(self) -> str:
        if not self.writes:
            return "it can only be read"
        step = f" in steps of {self.step}" if self.step > 1 else ""
        return f"it takes {self.minimum} to {self.maximum}{step}"


def controls_of(node: VideoNode) -> dict[str, Control]:
    """Controls of the camera by name, in its own order; those without a simple numeric value are left out."""
    return {control.name: control for control in _controls(node)}


def set_controls(node: VideoNode, wanted: Mapping[str, int]) -> None:
    """Set controls one after the other; raises CameraRefusedError that names the control, or OSError."""
    if not wanted:
        return
    controls = controls_of(node)
    for name, value in wanted.items():
        if name not in controls:
            raise CameraRefusedError(f"has no control {name}; it has {', '.join(controls) or 'none'}")
        controls[name].set(node, value)


def automatic_modes(node: VideoNode, settings: V4l2CameraSettings) -> Iterator[Control]:
    """Yield automatic modes that are on although the config does not ask for them; raises OSError."""
    accepted = _OFF_OF_EXPOSURE if settings.exposure.control == "camera" else {}
    for control in _controls(node):
        off = _OFF.get(control.number)
        if off is None or control.number in accepted or control.name in settings.controls:
            continue
        with suppress(OSError):  # a mode that cannot be read is not known to be on
            if control.value(node) != off:
                yield control


def switch_off(node: VideoNode, mode: Control) -> None:
    """Switch an automatic mode off, where the camera accepts that."""
    with suppress(OSError, CameraRefusedError):
        mode.set(node, _OFF[mode.number])


def _controls(node: VideoNode) -> Iterator[Control]:
    query = abi.v4l2_query_ext_ctrl(id=abi.V4L2_CTRL_FLAG_NEXT_CTRL)
    while True:
        try:
            node.call(abi.VIDIOC_QUERY_EXT_CTRL, query)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):  # no further control, or none at all
                return
            raise
        if query.type in _KINDS and not query.flags & abi.V4L2_CTRL_FLAG_DISABLED:
            button = query.type == abi.V4L2_CTRL_TYPE_BUTTON
            yield Control(
                number=query.id,
                name=_as_one_word(text(query.name)),
                kind=_KINDS[query.type],
                minimum=query.minimum,
                maximum=query.maximum,
                step=query.step,
                default=query.default_value,
                reads=not button and not query.flags & abi.V4L2_CTRL_FLAG_WRITE_ONLY,
                writes=not query.flags & abi.V4L2_CTRL_FLAG_READ_ONLY,
            )
        query.id |= abi.V4L2_CTRL_FLAG_NEXT_CTRL


def _as_one_word(name: str) -> str:
    """Name from the driver as one word, formed as by ``v4l2-ctl``."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
