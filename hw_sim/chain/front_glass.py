"""A unit whose front target is an electro-active glass: its switch, and its frames while that switches."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from altd.records import Frame
from hw_sim.unit import CAMERAS, FRONT, Unit

MARGIN_S = 0.012
"""From the edge of a visit to the middle of an exposure that lies in it."""


class FrontGlass:
    """``altd.ports.Switches`` of a unit in real time."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit

    def open(self) -> None:
        """The glass is without voltage."""
        self.show("")

    def show(self, opaque: str) -> None:
        """Voltage on the glass unless the front target is to be opaque; empty: none."""
        assert self._unit.glass is not None  # noqa: S101  the unit has one
        self._unit.glass.switch(opaque in ("", FRONT), time.monotonic_ns() * 1e-9)

    def close(self) -> None:
        """The glass is without voltage."""
        self.show("")


def switched_frames(
    unit: Unit, frame_sets: int, chance: np.random.Generator, exposures: int = 5, settle_s: float = 0.5
) -> Iterator[Frame]:
    """Frames of both cameras while front and rear target are shown in turn, each round in an order by chance.

    A frame is marked with the opaque target once the glass has settled.
    """
    assert unit.glass is not None  # noqa: S101  the unit has one
    period_s = unit.config.period_ns * 1e-9
    sequence, begin_s = 0, 0.0
    while True:
        for target in chance.permutation(CAMERAS).tolist():
            unit.glass.switch(target == FRONT, begin_s)
            end_s = begin_s + settle_s * (1.0 + 0.5 * chance.random()) + (exposures + 1) * period_s
            while sequence * period_s < end_s:
                t_s = sequence * period_s
                is_settled = begin_s + settle_s + MARGIN_S <= t_s <= end_s - MARGIN_S
                for camera in CAMERAS:
                    frame = unit.expose(camera, sequence, sequence * unit.config.period_ns)
                    yield replace(frame, opaque=target if is_settled else "")
                sequence += 1
                if sequence >= frame_sets:
                    return
            begin_s = end_s
