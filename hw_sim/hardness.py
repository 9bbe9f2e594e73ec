"""Effects of a real unit that the ordinary simulated one leaves out, each by its own setting."""

from dataclasses import dataclass

from hw_sim.beam import BeamFlaws
from hw_sim.optics import WAVELENGTH_NM


@dataclass(frozen=True, slots=True)
class Hardness:
    """Settings of the effects; with its defaults, each is off.

    - ``speckle_contrast``, ``speckle_mm``: speckle of the laser's own, see ``LaserSpeckle``.
    - ``jitter_mm``, ``bleed_mm``: the dots of a digital print, see ``PrintFlaws``.
    - ``filter_nm``: full width at half maximum of the cameras' band-pass filters; 0 for none.
    - ``laser_nm``, ``filter_centre_nm``: wavelengths of the laser, and of the filters' centre.
    - ``filter_tilt_mrad``: tilt of the filters against the lens axis, towards the picture's right.
    - ``glare_share``: the share of a spot's light that the lens spreads over a wide kernel.
    - ``instants``: instants of an exposure; the picture of a moving spot is their mean.
    - ``beam``: flaws of the beam, in place of those of ``UnitConfig.laser``.
    - ``front_blur_px``: blur of the front lens (1 sigma), None for that of the rear one.
    """

    speckle_contrast: float = 0.0
    speckle_mm: float = 0.5
    jitter_mm: float = 0.0
    bleed_mm: float = 0.0
    filter_nm: float = 0.0
    laser_nm: float = WAVELENGTH_NM
    filter_centre_nm: float = WAVELENGTH_NM
    filter_tilt_mrad: float = 0.0
    glare_share: float = 0.0
    instants: int = 1
    beam: BeamFlaws | None = None
    front_blur_px: float | None = None


HARD = Hardness(
    speckle_contrast=0.12,
    jitter_mm=0.006,
    bleed_mm=0.006,
    filter_nm=25.0,
    glare_share=0.03,
    instants=8,
    beam=BeamFlaws(skew=0.075, aperture=1.7, halo_share=0.02),
    front_blur_px=0.4,
)
"""All effects, as large as another renderer's figures need (docs/decisions/0005-simulator.md)."""
