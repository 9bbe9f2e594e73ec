"""Controls of a camera by name, such as ``gain`` or ``trigger_mode``."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from altd.devices.v4l2 import abi
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
