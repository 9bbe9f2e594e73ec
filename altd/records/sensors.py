"""Readings of sensors beside the cameras, each at its own time, and their usability."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Quality(StrEnum):
    """Usability of a sensor's value; all but the first two are reasons why there is none."""

    GOOD = "good"
    REDUCED = "reduced"
    """Outside the conditions of its best accuracy; sigma includes that."""
    STARTING = "starting"
    NO_PORT = "no_port"
    NO_ANSWER = "no_answer"
    BAD_ANSWER = "bad_answer"
    """Damaged, foreign or echoed bytes."""
    WRONG_SENSOR = "wrong_sensor"
    """Another sensor than in the config, or one with other settings."""
    INVALID_SETTING = "invalid_setting"
    """The sensor reports that it cannot measure with its settings."""
    OUT_OF_RANGE = "out_of_range"
    FROZEN = "frozen"
    NOISY = "noisy"
    OLD = "old"
    """The last reading is too old, and no newer one is known."""
    DEFECT = "defect"
    """A fault in the program; the log contains details."""


@dataclass(frozen=True, slots=True)
class SensorValue:
    """A sensor's value of a quantity with its sigma, or the reason why ``value`` is None.

    ``t_ns`` is the time of the reading, ``age_s`` its age when it was added to a measurement; after
    ``expires_ns`` it is no longer shown. ``rate`` is its change per second, 0 if it is not larger than noise.
    ``detail`` is the sentence for people.
    """

    quality: Quality
    detail: str = ""
    value: float | None = None
    sigma: float | None = None
    t_ns: int = 0
    age_s: float | None = None
    expires_ns: int = 0
    rate: float = 0.0

    def at(self, now_ns: int) -> SensorValue:
        """Return the value at that moment; ``OLD`` and without its number once that has expired."""
        if self.value is None or now_ns <= self.expires_ns:
            return self
        return SensorValue(Quality.OLD, f"the last reading is {(now_ns - self.t_ns) * 1e-9:.1f} s old")


def within_half_turn(angle_deg: float) -> float:
    """Return the same direction from -180° to below 180°."""
    return (angle_deg + 180.0) % 360.0 - 180.0
