"""One camera's fixed view of its target: the point of the target in every pixel, and its brightness.

Target and camera are fixed to each other, so everything independent of the beam is computed once: the point
of the target at each pixel's centre, the ink and lamps that the pixel's area covers after the lens has
blurred them, speckle, fall-off. An exposure then costs one exponential per pixel around the spot. The beam is
assumed even over a pixel (0.25 mm of a spot of several mm).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from altd.records import FloatArray
from hw_sim.beam import Footprint
from hw_sim.displacement import Displacement, carried
from hw_sim.dust import Dust
from hw_sim.frame_leds import ALL_LIT, Shines, Stray, led_coverage, stray_coverage
from hw_sim.hardness import Hardness
from hw_sim.image import Image
from hw_sim.laser_speckle import LaserSpeckle, make_laser_speckle
from hw_sim.lens import HEIGHT_PX, PIXEL_MM, WIDTH_PX, Lens
from hw_sim.optics import LAMP_NM, transmission, with_glare
from hw_sim.sensor import FULL_WELL_E
from hw_sim.targets import DotPrint, speckle

SUBSAMPLES = 4
"""Cells per pixel and axis; with soft edges the share of ink is correct to about 1 %."""

PSF_SIGMA_PX = 0.74
"""Blur of the lens. With a surface texture of 0.16 a bright spot then looks as in the frames of the recorded
unit (../shared/data/unit-a, rear): contrast 0.06, neighbouring pixels share half of it, blocks of 4 × 4
pixels scatter by 0.11 / 4."""

F_NUMBER = 4.0
LENS_AND_FILTER_TRANSMISSION = 0.6
QUANTUM_EFFICIENCY = 0.5
PHOTONS_PER_MJ = 650e-9 / (6.62607015e-34 * 2.99792458e8) * 1e-3
"""Photons per mJ (mW·s) at 650 nm."""

ELECTRONS_PER_EXPOSURE = (
    LENS_AND_FILTER_TRANSMISSION
    / (4.0 * F_NUMBER**2)
    * PIXEL_MM**2
    * PHOTONS_PER_MJ
    * QUANTUM_EFFICIENCY
    * 1e-3
)
"""Electrons per pixel for 1 mW/mm² on a white (Lambertian) target during 1 ms, on the lens axis."""

MAX_REACH_MM = 155.0
"""Limit of the reach of a spot's light: from any place on a target over all of the picture."""

MW_PER_MM2_PER_LUX = 1e-3 / (683.0 * 0.107)
"""Irradiance of 1 lux of 650 nm light, where the human eye's V(λ) is 0.107."""

PLATE_REFLECTANCE = 0.3
INK_REFLECTANCE = 0.5
LED_LEVEL_E_PER_MS = 0.5 * FULL_WELL_E


Coverage = Callable[[Image, Image, float], Image]
"""Coverage, or brightness, of a small cell at points (x, y)."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The fixed maps of one camera, all (rows, columns) float32."""

    lens: Lens
    x_mm: Image
    y_mm: Image
    response: Image
    """Electrons per mW/mm² and ms."""
    ambient: Image
    """Electrons per lux and ms."""
    lamps: Image
    """Electrons per ms with the frame LEDs on."""
    hot_e: Image
    """Electrons that leak into a pixel's storage at every read-out, whatever the exposure."""
    steady: Image | None = None
    """Electrons per ms of stray lights that always shine."""
    blinking: Image | None = None
    """Electrons per ms of blinking stray lights, while they shine."""
    laser_falloff: Image | None = None
    """Transmission of the filter for the laser; included in ``response``."""
    lamp_falloff: Image | None = None
    """Transmission of the filter for the light of LEDs."""
    speckle: LaserSpeckle | None = None
    """Speckle of the laser's coherent light."""
    glare_share: float = 0.0
    """Share of the spot's light that the lens spreads widely."""
    blur_px: float = PSF_SIGMA_PX
    """Blur of the lens, 1 sigma."""

    @property
    def even_response(self) -> Image:
        """Electrons per mW/mm² and ms of a lamp that lights the whole target."""
        if self.laser_falloff is None or self.lamp_falloff is None:
            return self.response
        return self.response / self.laser_falloff * self.lamp_falloff

    def with_dust(self, dust: Dust) -> View:
        """The view with dust on the target; lamps and sensor stay clean."""
        passed = _blurred(dust.at(self.x_mm, self.y_mm), self.blur_px)
        return replace(self, response=self.response * passed, ambient=self.ambient * passed)

    def with_lights(self, levels: tuple[float, ...] = ALL_LIT, strays: tuple[Stray, ...] = ()) -> View:
        """The view with frame LEDs of these levels, and with only these stray lights."""
        by_time = {when: tuple(stray for stray in strays if stray.shines is when) for when in Shines}

        def leds(x_mm: Image, y_mm: Image, softness_mm: float) -> Image:
            reflections = stray_coverage(x_mm, y_mm, softness_mm, by_time[Shines.WITH_LEDS])
            return led_coverage(x_mm, y_mm, softness_mm, levels) + reflections

        def shining(when: Shines) -> Image | None:
            of_these = partial(stray_coverage, strays=by_time[when])
            return self._light_e(of_these) if by_time[when] else None

        return replace(
            self,
            lamps=self._light_e(leds),
            steady=shining(Shines.ALWAYS),
            blinking=shining(Shines.BY_ITSELF),
        )

    def _light_e(self, coverage: Coverage) -> Image:
        """Electrons per ms of lights that cover parts of the target."""
        falloff = self.lens.relative_illumination(self.x_mm, self.y_mm).astype(np.float32)
        if self.lamp_falloff is not None:
            falloff *= self.lamp_falloff
        lit = _blurred(_mean_over_pixels(self.x_mm, self.y_mm, coverage), self.blur_px)
        return lit * falloff * np.float32(LED_LEVEL_E_PER_MS)

    def background_e(self, exposure_ms: float, lux: float, leds_on: bool, blink_on: bool = False) -> Image:
        """Mean electrons of an exposure without the beam."""
        electrons = self.ambient * np.float32(lux * exposure_ms) + self.hot_e
        if leds_on:
            electrons += self.lamps * np.float32(exposure_ms)
        for light, shines in ((self.steady, True), (self.blinking, blink_on)):
            if light is not None and shines:
                electrons += light * np.float32(exposure_ms)
        return electrons

    def beam_e(
        self, footprints: Sequence[Footprint], exposure_ms: float
    ) -> tuple[tuple[slice, slice], Image]:
        """Mean electrons of the spots, with the (rows, columns) of the picture that they cover."""
        region = self.region(footprints)
        electrons = np.zeros_like(self.response[region])
        for footprint in footprints:
            irradiance = footprint.irradiance(self.x_mm[region], self.y_mm[region])
            if self.speckle is not None:
                irradiance *= self.speckle.factor(region, footprint)
            electrons += irradiance
        electrons = electrons * self.response[region] * np.float32(exposure_ms)
        if self.glare_share and footprints:
            picture = with_glare(electrons, region, self.glare_share)
            return (slice(0, HEIGHT_PX), slice(0, WIDTH_PX)), picture
        return region, electrons

    def region(self, footprints: Sequence[Footprint]) -> tuple[slice, slice]:
        """Rows and columns that hold the spots; empty slices if none is in the picture."""
        if not footprints:
            return slice(0, 0), slice(0, 0)
        around = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
        circle = np.stack([np.cos(around), np.sin(around)], axis=1) * math.sqrt(2.0)  # encloses the box
        points = np.concatenate(
            [
                np.array([spot.x_mm, spot.y_mm]) + circle * np.minimum(spot.half_box_mm, MAX_REACH_MM)
                for spot in footprints
            ]
        )
        u, v = self.lens.project(points[:, 0], points[:, 1])
        return _within(v, HEIGHT_PX), _within(u, WIDTH_PX)


def make_view(  # noqa: PLR0913  a target, its camera, and changes to both
    lens: Lens,
    dots: DotPrint | None,
    contrast: float,
    hot_pixels: int,
    rng: np.random.Generator,
    displaced: Displacement | None = None,
    hard: Hardness | None = None,
) -> View:
    """Maps of a camera with a printed window in view, or a plain plate if ``dots`` is None.

    ``displaced``: the camera has moved relative to the same target. ``hard``: the effects to include.
    """
    before = lens
    if displaced is not None:
        lens = displaced.of(before)
    columns, rows = np.meshgrid(np.arange(WIDTH_PX, dtype=np.float64), np.arange(HEIGHT_PX, dtype=np.float64))
    x_mm, y_mm = lens.unproject(columns, rows)
    texture = speckle(rng, (HEIGHT_PX, WIDTH_PX), contrast)
    if displaced is not None:
        texture = carried(texture, before, lens)
    blur_px = PSF_SIGMA_PX
    if dots is not None and hard is not None and hard.front_blur_px is not None:
        blur_px = hard.front_blur_px
    reflectance, lit = _reflectance_and_lamps(
        x_mm.astype(np.float32), y_mm.astype(np.float32), dots, texture, blur_px
    )
    falloff = lens.relative_illumination(x_mm, y_mm).astype(np.float32)
    slope_u, slope_v = rng.uniform(-0.4, 0.4, size=2)
    gradient = 1.0 + slope_u * (2.0 * columns / WIDTH_PX - 1.0) + slope_v * (2.0 * rows / HEIGHT_PX - 1.0)
    ambient = PLATE_REFLECTANCE * MW_PER_MM2_PER_LUX * ELECTRONS_PER_EXPOSURE * gradient
    hot_e = np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.float32)
    where = rng.choice(hot_e.size, size=hot_pixels, replace=False)
    hot_e.flat[where] = rng.uniform(0.1, 1.0, size=hot_pixels) * FULL_WELL_E
    view = View(
        lens=lens,
        x_mm=x_mm.astype(np.float32),
        y_mm=y_mm.astype(np.float32),
        response=reflectance * falloff * np.float32(ELECTRONS_PER_EXPOSURE),
        ambient=ambient.astype(np.float32) * falloff,
        lamps=lit * falloff * np.float32(LED_LEVEL_E_PER_MS),
        hot_e=hot_e,
        blur_px=blur_px,
    )
    if hard is None:
        return view
    return _hardened(view, hard, reflectance / np.float32(INK_REFLECTANCE) if dots else None, rng)


def _hardened(view: View, hard: Hardness, ink: Image | None, rng: np.random.Generator) -> View:
    """The view with the effects of filter and lens, and with the laser's speckle."""
    lens = view.lens
    if hard.filter_nm:
        tangent = lens.incidence_tangent(view.x_mm, view.y_mm, hard.filter_tilt_mrad * 1e-3)
        laser = transmission(
            tangent, hard.filter_nm, laser_nm=hard.laser_nm, centre_nm=hard.filter_centre_nm
        ).astype(np.float32)
        lamp = transmission(tangent, hard.filter_nm, LAMP_NM).astype(np.float32)
        view = replace(
            view,
            response=view.response * laser,
            lamps=view.lamps * lamp,
            laser_falloff=laser,
            lamp_falloff=lamp,
        )
    if hard.speckle_contrast:
        pupil_rad = lens.focal_mm / F_NUMBER / float(lens.translation_mm[2])
        speckle = make_laser_speckle(rng, hard.speckle_contrast, hard.speckle_mm, pupil_rad, ink)
        view = replace(view, speckle=speckle)
    return replace(view, glare_share=hard.glare_share)


def _reflectance_and_lamps(
    x_mm: Image, y_mm: Image, dots: DotPrint | None, texture: Image, blur_px: float
) -> tuple[Image, Image]:
    """Mean reflectance and share of lit LED over each pixel's area, after the lens's blur."""
    lit = _blurred(_mean_over_pixels(x_mm, y_mm, led_coverage), blur_px)
    if dots is None:
        return _blurred(texture, blur_px) * np.float32(PLATE_REFLECTANCE), lit
    ink = _summed_over_pixels(x_mm, y_mm, dots.cover)
    reflectance = _blurred(ink * texture / np.float32(SUBSAMPLES**2), blur_px) * np.float32(INK_REFLECTANCE)
    return reflectance, lit


def _mean_over_pixels(x_mm: Image, y_mm: Image, coverage: Coverage) -> Image:
    """Mean over each pixel's area of the coverage of small cells."""
    return _summed_over_pixels(x_mm, y_mm, coverage) / np.float32(SUBSAMPLES**2)


def _summed_over_pixels(x_mm: Image, y_mm: Image, coverage: Coverage) -> Image:
    """Sum of the coverage of a pixel's cells; there are SUBSAMPLES cells along each axis."""
    by_u = (np.gradient(x_mm, axis=1), np.gradient(y_mm, axis=1))
    by_v = (np.gradient(x_mm, axis=0), np.gradient(y_mm, axis=0))
    cell_mm = float(np.median(np.hypot(*by_u))) / SUBSAMPLES
    total = np.zeros_like(x_mm)
    offsets = (np.arange(SUBSAMPLES, dtype=np.float32) + np.float32(0.5)) / SUBSAMPLES - np.float32(0.5)
    for down in offsets:
        for right in offsets:
            x = x_mm + right * by_u[0] + down * by_v[0]
            y = y_mm + right * by_u[1] + down * by_v[1]
            total += coverage(x, y, cell_mm)
    return total


def _blurred(image: Image, blur_px: float) -> Image:
    return cv2.GaussianBlur(image, (0, 0), blur_px).astype(np.float32)


def _within(positions_px: FloatArray, size: int) -> slice:
    """Whole pixels between the smallest and the largest position, within the picture."""
    low = min(max(int(np.floor(positions_px.min())) - 1, 0), size)
    high = min(max(int(np.ceil(positions_px.max())) + 2, low), size)
    return slice(low, high)
