"""A unit with an electro-active glass as front target: its switch, and its frames during switching."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from altd.records import Frame
from hw_sim.unit import CAMERAS, FRONT, Unit

_EXPOSURES, _SETTLE_S = 5, 0.5
"""Exposures of a visit, and the time in which the glass settles."""
MARGIN_S = 0.012
"""Minimum time between either end of a visit and the middle of an exposure that counts for it."""


class FrontGlass:
    """Switch of a unit in real time, see ``altd.ports.Switches``."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit

    def open(self) -> None:
        """Remove the voltage from the glass."""
        self.show("")

    def show(self, opaque: str) -> None:
        """Apply voltage to the glass unless the front target is to be opaque or ``opaque`` is empty."""
        assert self._unit.glass is not None  # noqa: S101  the unit has one
        self._unit.glass.switch(opaque in ("", FRONT), time.monotonic_ns() * 1e-9)

    def close(self) -> None:
        """Remove the voltage from the glass."""
        self.show("")


def switched_frames(unit: Unit, frame_sets: int, chance: np.random.Generator) -> Iterator[Frame]:
    """Frames of both cameras while front and rear target are shown in turn, in random order in each round.

    A frame is marked with the opaque target once the glass has settled.
    """
    assert unit.glass is not None  # noqa: S101  the unit has one
    period_s = unit.config.period_ns * 1e-9
    sequence, begin_s = 0, 0.0
    while True:
        for target in chance.permutation(CAMERAS).tolist():
            unit.glass.switch(target == FRONT, begin_s)
            end_s = begin_s + _SETTLE_S * (1.0 + 0.5 * chance.random()) + (_EXPOSURES + 1) * period_s
            while sequence * period_s < end_s:
                t_s = sequence * period_s
                is_settled = begin_s + _SETTLE_S + MARGIN_S <= t_s <= end_s - MARGIN_S
                for camera in CAMERAS:
                    frame = unit.expose(camera, sequence, sequence * unit.config.period_ns)
                    yield replace(frame, opaque=target if is_settled else "")
                sequence += 1
                if sequence >= frame_sets:
                    return
            begin_s = end_s
