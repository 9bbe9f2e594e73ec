"""The units of the campaign: how each was calibrated, and in what circumstances it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hw_sim.beam import Laser
from hw_sim.motion import Vibration
from hw_sim.unit import EXPOSURES_MS, UnitConfig

RECORDED = "unit-a"
"""The recorded unit of ../shared/data; all others are simulated."""

_REFERENCE = Laser()


@dataclass(frozen=True, slots=True)
class UnitSpec:
    """A simulated unit: what it is, and how its measuring differs from its calibration.

    ``flat``: calibrated through a recorded flat. ``light`` is the laser's power when it measures, relative to
    the calibration's; ``lux_of`` the ambient light at ``t_s`` of an episode, where it changes.
    """

    name: str
    config: UnitConfig
    flat: bool = False
    light: float = 1.0
    lux: float = 200.0
    lux_of: Callable[[float], float] | None = None
    vibration: Vibration | None = None
    drives: bool = False
    dust: float = 0.0

    @property
    def exposure_ms(self) -> float:
        """Brings the laser's spot to three quarters of full scale."""
        return EXPOSURES_MS["front"] * _REFERENCE.peak_mw_per_mm2 / self.config.laser.peak_mw_per_mm2

    @property
    def measuring(self) -> UnitConfig:
        """The unit as it measures."""
        laser = replace(self.config.laser, power_mw=self.config.laser.power_mw * self.light)
        return replace(self.config, laser=laser, lux=self.lux, vibration=self.vibration, dust=self.dust)


def _switched(t_s: float) -> float:
    """Lights that go on and off between 0 and 1000 lx."""
    return 0.0 if t_s < 0.25 else 1000.0


SIMULATED: dict[str, UnitSpec] = {
    spec.name: spec
    for spec in (
        UnitSpec("plain", UnitConfig(seed=1)),
        UnitSpec("flat", UnitConfig(seed=2), flat=True),
        UnitSpec("round-6", UnitConfig(seed=3, laser=Laser(1.0, (6.0, 6.0)))),
        UnitSpec("super-15", UnitConfig(seed=4, laser=Laser(3.0, (15.0, 15.0), order=2.0)), flat=True),
        UnitSpec(
            "ellipse", UnitConfig(seed=5, laser=Laser(3.0, (14.0, 7.0), angle_rad=0.9), speckle_contrast=0.2)
        ),
        UnitSpec("bits-12", UnitConfig(seed=6, bits=12, speckle_contrast=0.12), flat=True),
        UnitSpec("dim", UnitConfig(seed=7), light=0.25, lux=600.0),
        UnitSpec("bright", UnitConfig(seed=8, laser=Laser(3.0, (9.0, 8.0), order=1.5)), light=1.5, lux=0.0),
        UnitSpec("shaking", UnitConfig(seed=9), vibration=Vibration()),
        UnitSpec(
            "driving", UnitConfig(seed=10), vibration=Vibration(rms_mm=0.02, rms_mrad=0.05), drives=True
        ),
        UnitSpec("dusty", UnitConfig(seed=11), dust=0.5),
        UnitSpec("lights", UnitConfig(seed=12, hot_pixels=200), lux_of=_switched, flat=True),
    )
}

NAMES = (*SIMULATED, RECORDED)
