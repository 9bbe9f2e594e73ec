"""An electro-active glass: clear with voltage, milky without; it switches exponentially."""

from __future__ import annotations

import math
from dataclasses import dataclass

TRANSMISSION = 0.73
"""Of the beam through a clear glass, as for SGG PrivaLite."""
MILKY_TRANSMISSION = 0.004
"""Of the collimated beam through a milky glass: nearly all light is scattered."""
HAZE = 0.05
"""Light that a clear glass scatters to its camera, as a share of a milky one's."""
TO_CLEAR_S, TO_MILKY_S = 0.010, 0.060
"""Time constants; vendors state some 10 ms to clear and 100 ms to cloud."""


@dataclass(frozen=True, slots=True)
class GlassConfig:
    """A glass and its faults.

    ``wedge_rad`` (x, y) is the angle by which it deflects the beam, ``shift_mm`` (x, y) by how much a tilted
    plate displaces it, on all planes behind. ``stuck`` is ``opaque`` or ``clear``: it does not switch
    from ``fault_s`` on. ``slow`` multiplies its time constants.
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
        """Take the voltage off (opaque) or apply it, at ``t_s``."""
        self._milky = self.milky(t_s)
        self._t_s, self._goal = t_s, float(opaque)

    def milky(self, t_s: float) -> float:
        """The state at ``t_s``, from 0 (clear) to 1 (milky); before the last switching, that at it."""
        t_s = max(t_s, self._t_s)
        if self.config.stuck and t_s >= self.config.fault_s:
            return float(self.config.stuck == "opaque")
        constant_s = self.config.slow * (TO_MILKY_S if self._goal > self._milky else TO_CLEAR_S)
        return self._goal + (self._milky - self._goal) * math.exp(-(t_s - self._t_s) / constant_s)

    def transmission(self, t_s: float) -> float:
        """Share of the collimated beam behind it: log-linear in the scatterers that are turned."""
        milky = self.milky(t_s)
        share: float = self.config.transmission ** (1.0 - milky) * MILKY_TRANSMISSION**milky
        return share

    def brightness(self, t_s: float) -> float:
        """Light that its camera gets of the beam, as a share of a milky glass's."""
        return self.config.haze + (1.0 - self.config.haze) * self.milky(t_s)
