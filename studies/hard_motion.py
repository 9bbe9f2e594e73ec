"""Motions of a machine for which a bound of its later position is difficult."""

import math
from collections.abc import Callable

from hw_sim.beam import BeamPose

Path = Callable[[int], BeamPose]
"""The beam at a time in ns."""


def line(x_mm: float) -> BeamPose:
    """The place of the beam after so much of a straight line; the angles change with it."""
    return BeamPose(-20.0 + 0.8 * x_mm, -15.0 + 0.6 * x_mm, 0.01 + 0.0005 * x_mm, -0.02 - 0.0005 * x_mm)


def steps(speed_mm_per_s: float, on_s: float, off_s: float) -> Path:
    """Forth with this speed for ``on_s``, rest for ``off_s``, back, rest."""

    def path(t_ns: int) -> BeamPose:
        step, since_s = divmod(t_ns * 1e-9, on_s + off_s)
        gone_s = min(since_s, on_s)
        return line(speed_mm_per_s * (on_s - gone_s if step % 2 else gone_s))

    return path


def sway(amplitude_mm: float, frequency_hz: float) -> Path:
    """There and back as a sine."""
    return lambda t_ns: line(amplitude_mm * math.sin(2.0 * math.pi * frequency_hz * t_ns * 1e-9 + 0.3))


def start(at_s: float, speed_mm_per_s: float) -> Path:
    """At rest, then all at once with this speed."""
    return lambda t_ns: line(speed_mm_per_s * max(t_ns * 1e-9 - at_s, 0.0))


HARD: tuple[tuple[str, Path, int], ...] = (
    ("steps of 5 mm/s: 2 s on, 2 s off", steps(5.0, 2.0, 2.0), 1),
    ("steps of 5 mm/s: 0.5 s on, 3 s off", steps(5.0, 0.5, 3.0), 1),
    ("steps of 1 mm/s: 5 s on, 5 s off", steps(1.0, 5.0, 5.0), 1),
    ("sway of ±1 mm in 4 s", sway(1.0, 0.25), 1),
    ("sway of ±0.5 mm in 1 s", sway(0.5, 1.0), 1),
    ("2 Hz, ±0.3 mm", sway(0.3, 2.0), 1),
    ("5 Hz, ±0.3 mm", sway(0.3, 5.0), 1),
    ("20.5 Hz, ±0.3 mm", sway(0.3, 20.5), 1),
    ("30.7 Hz, ±0.3 mm", sway(0.3, 30.7), 1),
    ("2 mm/s back and forth, each third exposure lost", steps(2.0, 10.0, 0.0), 3),
)
"""The name, the path, and the exposures that are lost: each so many; 1: none."""
