"""An xy stage behind a Grbl 1.1 controller on a serial port.

A report just after a line's ``ok`` may still be ``Idle`` at the old position. A movement is therefore over
when two reports in a row are ``Idle`` at its target. Grbl has no checksum: a number changed by noise is
detected by the final position of the stage, and the line is sent again; targets are absolute, so that is
harmless.
"""

from __future__ import annotations

import math
import time

from altd.devices.grbl import GrblStageSettings
from altd.devices.grbl.controller import MAX_TRIES, STUCK_TIMEOUT_S, GrblController
from altd.devices.grbl.protocol import Point
from altd.ports import (
    StageAlarmError,
    StageError,
    StageLostError,
    StageRefusedError,
    StageStoppedError,
    StageTimeoutError,
)

_POSITION_TOLERANCE_MM = 0.02
"""Maximum distance from the target at rest: a coarse table's step. The reported position is recorded, not the
target."""


class GrblStage:
    """See ``altd.ports.Stage``. ``controller`` is the client of its controller."""

    def __init__(self, settings: GrblStageSettings) -> None:
        self._settings = settings
        self.controller = GrblController(settings)

    def open(self) -> None:
        """Open the port, let a movement finish and reset the controller, which keeps its position."""
        self.controller.open()

    def home(self) -> None:
        """Home with ``$H``; with ``start = "unlock"``, unlock and keep the position."""
        controller = self.controller
        if self._settings.start == "home":
            controller.home()
        elif controller.status().state == "Alarm":
            controller.command("$X")
        if controller.status().state == "Alarm":
            raise StageAlarmError("the stage's controller stays locked")
        controller.position_mm()

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Move in a straight line at ``feed_mm_per_min``; returns when the stage is at rest at the target."""
        settings = self._settings
        target = (
            settings.sign_x * x_mm + settings.offset_x_mm,
            settings.sign_y * y_mm + settings.offset_y_mm,
        )
        whose = "G53 " if settings.coordinates == "machine" else ""
        line = f"{whose}G21 G90 G94 G1 X{target[0]:.3f} Y{target[1]:.3f} F{settings.feed_mm_per_min:g}"
        try:
            for _ in range(MAX_TRIES):
                self.controller.command(line)
                if self._arrives(target):
                    return
        except (StageAlarmError, StageLostError, StageStoppedError):
            raise
        except StageError:
            self.controller.halt()
            raise
        stands = self.controller.position_mm()
        raise StageRefusedError(
            f"the stage stops at {stands[0]:.3f}, {stands[1]:.3f} instead of {target[0]:.3f}, "
            f"{target[1]:.3f} mm of its own coordinates"
        )

    def position(self) -> tuple[float, float]:
        """Position reported by the controller, in the unit frame, mm."""
        x_mm, y_mm = self.controller.position_mm()
        settings = self._settings
        return (
            settings.sign_x * (x_mm - settings.offset_x_mm) + 0.0,  # avoids -0.0 in displays
            settings.sign_y * (y_mm - settings.offset_y_mm) + 0.0,
        )

    def stop(self) -> None:
        """Request the end of the movement by a feed hold, which loses no steps, and a reset."""
        self.controller.stop()

    def close(self) -> None:
        """Close the port."""
        self.controller.close()

    def _arrives(self, target: Point) -> bool:
        """Wait until the stage is at rest; return whether it is at the target."""
        last: tuple[str, Point] | None = None
        same, since = 1, time.monotonic()
        while True:
            status = self.controller.status()
            if status.state == "Alarm":
                raise StageAlarmError("the stage's controller is locked: it must be homed")
            now = status.state, self.controller.position_mm(status)
            same = same + 1 if now == last else 1
            if now != last:
                last, since = now, time.monotonic()
            if status.state == "Idle":
                if math.dist(now[1], target) <= _POSITION_TOLERANCE_MM:
                    if same >= 2:
                        return True
                elif same > MAX_TRIES:
                    return False
            elif time.monotonic() - since > STUCK_TIMEOUT_S:
                raise StageTimeoutError(f"the stage is in state {status.state} and does not move")
            self.controller.pause()
