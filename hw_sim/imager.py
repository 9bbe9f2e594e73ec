"""The imaging of one camera: its view, its sensor, and its exposure time and gain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.records import PixelArray
from hw_sim.beam import Footprint
from hw_sim.dust import Dust
from hw_sim.frame_leds import ALL_LIT, Stray
from hw_sim.image import Image
from hw_sim.sensor import Sensor
from hw_sim.view import View


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a camera driver; the signal is proportional to the product of both."""

    exposure_ms: float
    gain: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Background:
    """Image without the beam, for one state of settings and lamps."""

    view: View
    settings: Settings
    sensor: Sensor
    electrons: Image
    counts: Image
    noise_counts: Image


class Imager:
    """View and sensor of a camera; any thread may replace ``settings`` and ``sensor`` at any time."""

    def __init__(self, view: View, sensor: Sensor, settings: Settings, lux: float) -> None:
        self.view = view
        self.sensor = sensor
        self.settings = settings
        self._lux = lux
        self.blink_on = False
        """Whether blinking stray lights are lit in the next exposure."""
        self._clean_view = view
        self._dust: Dust | None = None
        self._levels: tuple[float, ...] = ALL_LIT
        self._strays: tuple[Stray, ...] = ()
        self._backgrounds: dict[tuple[bool, bool], _Background] = {}

    @property
    def blinks(self) -> bool:
        """Whether any stray light blinks."""
        return self.view.blinking is not None

    def set_view(self, view: View) -> None:
        """Replace the view of the target, with the current dust and lights."""
        self._clean_view = view
        if self._levels != ALL_LIT or self._strays:
            self._clean_view = view.with_lights(self._levels, self._strays)
        self.set_dust(self._dust)

    def set_lights(self, levels: tuple[float, ...], strays: tuple[Stray, ...]) -> None:
        """Set the brightness of the frame LEDs, and replace the stray lights."""
        self._levels, self._strays = levels, strays
        self._clean_view = self._clean_view.with_lights(levels, strays)
        self.set_dust(self._dust)

    def set_dust(self, dust: Dust | None) -> None:
        """Replace the dust on the viewed target."""
        self._dust = dust
        self.view = self._clean_view if dust is None else self._clean_view.with_dust(dust)

    def mean_e(
        self, spots: Sequence[Footprint], leds_on: bool, exposure_ms: float, even_mw_per_mm2: float = 0.0
    ) -> Image:
        """Mean electrons of a frame, (rows, columns): the light, before any noise.

        ``even_mw_per_mm2`` lights the whole target, as for a flat field.
        """
        view = self.view
        electrons = view.background_e(exposure_ms, self._lux, leds_on, self.blink_on)
        if even_mw_per_mm2 > 0.0:
            electrons += view.even_response * np.float32(even_mw_per_mm2 * exposure_ms)
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
        """Grey values with Poisson noise drawn for each pixel."""
        settings = self.settings
        mean_e = self.mean_e(spots, leds_on, settings.exposure_ms, even_mw_per_mm2)
        return self.sensor.expose(mean_e, settings.gain, rng)

    def expose_from_pool(self, spots: Sequence[Footprint], leds_on: bool, noise: Image) -> PixelArray:
        """Grey values with the same statistics, from standard normal ``noise`` and a cached background."""
        background = self._background(leds_on)
        view, settings, sensor = background.view, background.settings, background.sensor
        counts = background.noise_counts * noise
        counts += background.counts
        region, electrons = view.beam_e(spots, settings.exposure_ms)
        electrons += background.electrons[region]
        spread = sensor.noise_counts(electrons, settings.gain) * noise[region]
        counts[region] = sensor.mean_counts(electrons, settings.gain) + spread
        return sensor.quantise(counts)

    def _background(self, leds_on: bool) -> _Background:
        view, settings, sensor = self.view, self.settings, self.sensor
        blink_on = self.blink_on
        cached = self._backgrounds.get((leds_on, blink_on))
        if cached is None or (cached.view, cached.settings, cached.sensor) != (view, settings, sensor):
            electrons = view.background_e(settings.exposure_ms, self._lux, leds_on, blink_on)
            cached = _Background(
                view,
                settings,
                sensor,
                electrons,
                sensor.mean_counts(electrons, settings.gain),
                sensor.noise_counts(electrons, settings.gain),
            )
            self._backgrounds[leds_on, blink_on] = cached
        return cached
