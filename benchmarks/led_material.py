"""The material of a unit at rest whose cameras see the frame LEDs as their line was switched."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from altd.records import Frame
from benchmarks.material import CAMERAS, SEED, Material
from benchmarks.selfcheck_units import calibrated
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose


class LedLine:
    """See ``altd.ports.Lamps``; with the times at which it was switched."""

    def __init__(self) -> None:
        self._switched: list[tuple[int, bool]] = [(0, False)]

    def forget(self) -> None:
        """Dark, and nothing is known of before."""
        self._switched = [(0, False)]

    def open(self) -> None:
        """Dark."""
        self.switch(False)

    def switch(self, on: bool) -> None:
        """From now on the LEDs are so."""
        if on is not self._switched[-1][1]:
            self._switched.append((time.monotonic_ns(), on))

    def close(self) -> None:
        """Dark."""
        self.switch(False)

    def level_at(self, t_ns: int) -> bool:
        """Whether they shone at a time."""
        return next(on for since_ns, on in reversed(self._switched) if since_ns <= t_ns)

    @property
    def lit_s(self) -> list[float]:
        """For how long each time."""
        edges = self._switched[1:]
        return [
            (off_ns - on_ns) * 1e-9 for (on_ns, _), (off_ns, _) in zip(edges[::2], edges[1::2], strict=False)
        ]


@dataclass(frozen=True, slots=True)
class LedMaterial(Material):
    """Pairs of a beam at rest with the LEDs dark and, as many, ``lit_pairs``."""

    lit_pairs: tuple[tuple[Frame, Frame], ...]
    line: LedLine

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        """Frame set number ``sequence`` of an endless run, exposed at ``t_ns``: the pairs again and again.

        Each time is a playthrough of its own: its pictures come again by intent.
        """
        turn, number = divmod(sequence, len(self.pairs))
        front, rear = (self.lit_pairs if self.line.level_at(t_ns) else self.pairs)[number]
        return (
            replace(front, sequence=sequence, t_ns=t_ns, playthrough=turn),
            replace(rear, sequence=sequence, t_ns=t_ns, playthrough=turn),
        )


def make_led_material(pairs: int) -> tuple[LedMaterial, LedLine]:
    """Render the pairs and calibrate their unit by a scan of its own."""
    unit, line, calibration = simulated.Unit(simulated.UnitConfig(seed=SEED)), LedLine(), calibrated(SEED)
    unit.place(BeamPose(4.0, -3.0, 0.02, -0.03))

    def render(on: bool, first: int) -> tuple[tuple[Frame, Frame], ...]:
        unit.leds_on = on
        made = []
        for sequence in range(first, first + pairs):
            t_ns = sequence * unit.config.period_ns
            front, rear = (unit.expose(camera, sequence, t_ns) for camera in CAMERAS)
            made.append((replace(front, leds_on=False), replace(rear, leds_on=False)))
        return tuple(made)

    dark, lit = render(False, 0), render(True, pairs)
    return LedMaterial(dark, calibration, calibration, lit, line), line
