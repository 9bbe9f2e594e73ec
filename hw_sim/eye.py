"""One camera of the unit: its view, its chip, and the exposure and gain it is set to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.records import PixelArray
from hw_sim.beam import Footprint
from hw_sim.dust import Dust
from hw_sim.sensor import Image, Sensor
from hw_sim.view import View


@dataclass(frozen=True, slots=True)
class Settings:
    """What a camera driver sets: the signal goes with their product."""

    exposure_ms: float
    gain: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Backdrop:
    """All that an exposure shows without the beam, for one state of settings and lamps."""

    view: View
    settings: Settings
    sensor: Sensor
    electrons: Image
    counts: Image
    noise_counts: Image


class Eye:
    """A view through a chip; ``settings`` and ``sensor`` may be replaced at any time, from any thread."""

    def __init__(self, view: View, sensor: Sensor, settings: Settings, lux: float) -> None:
        self.view = view
        self.sensor = sensor
        self.settings = settings
        self._lux = lux
        self._clean = view
        self._backdrops: dict[bool, _Backdrop] = {}

    def lay(self, dust: Dust | None) -> None:
        """Let this dust, and no other, lie on what the view shows."""
        self.view = self._clean if dust is None else self._clean.behind(dust)

    def mean_e(
        self, spots: Sequence[Footprint], leds_on: bool, exposure_ms: float, even_mw_per_mm2: float = 0.0
    ) -> Image:
        """Mean electrons of an exposure, (rows, columns): the light, before any noise.

        ``even_mw_per_mm2`` lights the whole target, as a flat field wants it.
        """
        view = self.view
        electrons = view.background_e(exposure_ms, self._lux, leds_on)
        if even_mw_per_mm2 > 0.0:
            electrons += view.response * np.float32(even_mw_per_mm2 * exposure_ms)
        region, beam_e = view.beam_e(spots, exposure_ms)
        electrons[region] += beam_e
        return electrons

    def expose(
        self,
        spots: Sequence[Footprint],
        leds_on: bool,
        rng: np.random.Generator,
        even_mw_per_mm2: float = 0.0,
    ) -> PixelArray:
        """Grey values with every photon drawn for itself."""
        settings = self.settings
        mean_e = self.mean_e(spots, leds_on, settings.exposure_ms, even_mw_per_mm2)
        return self.sensor.expose(mean_e, settings.gain, rng)

    def sketch(self, spots: Sequence[Footprint], leds_on: bool, noise: Image) -> PixelArray:
        """Grey values with the same statistics, from standard normal ``noise`` and a kept backdrop."""
        backdrop = self._backdrop(leds_on)
        view, settings, sensor = backdrop.view, backdrop.settings, backdrop.sensor
        counts = backdrop.noise_counts * noise
        counts += backdrop.counts
        region, electrons = view.beam_e(spots, settings.exposure_ms)
        electrons += backdrop.electrons[region]
        spread = sensor.noise_counts(electrons, settings.gain) * noise[region]
        counts[region] = sensor.mean_counts(electrons, settings.gain) + spread
        return sensor.quantise(counts)

    def _backdrop(self, leds_on: bool) -> _Backdrop:
        view, settings, sensor = self.view, self.settings, self.sensor
        kept = self._backdrops.get(leds_on)
        if kept is None or (kept.view, kept.settings, kept.sensor) != (view, settings, sensor):
            electrons = view.background_e(settings.exposure_ms, self._lux, leds_on)
            kept = _Backdrop(
                view,
                settings,
                sensor,
                electrons,
                sensor.mean_counts(electrons, settings.gain),
                sensor.noise_counts(electrons, settings.gain),
            )
            self._backdrops[leds_on] = kept
        return kept
