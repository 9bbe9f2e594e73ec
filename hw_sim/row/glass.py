"""An electro-active glass: clear with voltage, milky without; it switches exponentially."""

import math
from dataclasses import dataclass

TRANSMISSION = 0.73
"""Share of the beam that passes a clear glass, as for SGG PrivaLite."""
MILKY_TRANSMISSION = 0.004
"""Share of the collimated beam that passes a milky glass: nearly all light is scattered."""
HAZE = 0.05
"""Light that a clear glass scatters to its camera, as a share of a milky glass."""
TO_CLEAR_S, TO_MILKY_S = 0.010, 0.060
"""Time constants of switching; vendors state some 10 ms to clear and 100 ms to cloud."""


@dataclass(frozen=True, slots=True)
class GlassConfig:
    """A glass and its faults.

    ``wedge_rad`` (x, y) is the angle by which it deflects the beam, ``shift_mm`` (x, y) the displacement of
    the beam by the tilted plate, on all planes behind it. ``stuck`` is ``opaque`` or ``clear``: the glass
    does not switch from ``fault_s`` on. ``slow`` multiplies its time constants.
    """

    transmission: float = TRANSMISSION
    haze: float = HAZE
    wedge_rad: tuple[float, float] = (0.0, 0.0)
    shift_mm: tuple[float, float] = (0.0, 0.0)
    stuck: str = ""
    slow: float = 1.0
    fault_s: float = 0.0


class Glass:
    """A glass whose state follows its switch."""

    def __init__(self, config: GlassConfig) -> None:
        self.config = config
        self._goal = self._milky = 0.0
        self._t_s = 0.0

    def switch(self, opaque: bool, t_s: float) -> None:
        """Remove the voltage (opaque) or apply it, at ``t_s``."""
        self._milky = self.milky(t_s)
        self._t_s, self._goal = t_s, float(opaque)

    def milky(self, t_s: float) -> float:
        """State at ``t_s``, 0 (clear) to 1 (milky); before the last switching, the state at switching."""
        t_s = max(t_s, self._t_s)
        if self.config.stuck and t_s >= self.config.fault_s:
            return float(self.config.stuck == "opaque")
        constant_s = self.config.slow * (TO_MILKY_S if self._goal > self._milky else TO_CLEAR_S)
        return self._goal + (self._milky - self._goal) * math.exp(-(t_s - self._t_s) / constant_s)

    def transmission(self, t_s: float) -> float:
        """Share of the collimated beam behind the glass: log-linear in the share of scattering particles."""
        milky = self.milky(t_s)
        share: float = self.config.transmission ** (1.0 - milky) * MILKY_TRANSMISSION**milky
        return share

    def brightness(self, t_s: float) -> float:
        """Light of the beam that the camera receives, as a share of a milky glass."""
        return self.config.haze + (1.0 - self.config.haze) * self.milky(t_s)
