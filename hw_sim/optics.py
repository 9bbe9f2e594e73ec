"""The band-pass filter before a camera's lens, and the veiling glare of that lens."""

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from hw_sim.image import Image
from hw_sim.lens import HEIGHT_PX, WIDTH_PX

WAVELENGTH_NM = 650.0
"""Usual wavelength of the laser, and of the filter's centre at normal incidence."""

EFFECTIVE_INDEX = 2.0
"""Effective index of an interference filter of metal oxides: 1.8 to 2.2."""

LAMP_NM = 25.0
"""Full width at half maximum of the red LEDs that light the targets."""

GLARE_SIGMA_PX = 60.0
GLARE_CELL_PX = 16


def transmission(
    tan_angle: npt.ArrayLike,
    width_nm: float,
    source_nm: float = 0.0,
    *,
    laser_nm: float = WAVELENGTH_NM,
    centre_nm: float = WAVELENGTH_NM,
) -> FloatArray:
    """Transmission of a filter relative to its centre at normal incidence, any shape.

    At angle θ its centre moves to λ₀·√(1 − sin²θ/n²) (thin-film interference with an effective index). The
    pass band is that of two cavities, 1/(1 + (2Δλ/width)⁴); ``width_nm`` is its full width at half maximum. A
    source of full width ``source_nm`` (a Gaussian) about ``laser_nm`` is averaged over its spectrum; the
    laser is a line.
    """
    tan2 = np.square(np.asarray(tan_angle, dtype=np.float64))
    sin2 = tan2 / (1.0 + tan2)
    shift_nm = centre_nm * (1.0 - np.sqrt(1.0 - sin2 / EFFECTIVE_INDEX**2))
    lines_nm = np.linspace(-1.5, 1.5, 31) * source_nm if source_nm else np.zeros(1)
    weights = np.exp(-4.0 * np.log(2.0) * np.square(lines_nm / source_nm)) if source_nm else np.ones(1)
    passed, straight = np.zeros_like(shift_nm), np.zeros(1)
    for line_nm, weight in zip(lines_nm, weights, strict=True):
        for total, off_nm in ((passed, line_nm + (laser_nm - centre_nm) + shift_nm), (straight, line_nm)):
            total += weight / (1.0 + np.square(np.square(off_nm * (2.0 / width_nm))))
    return np.asarray(passed / straight[0])


def with_glare(electrons: Image, region: tuple[slice, slice], share: float) -> Image:
    """Whole picture (rows, columns) of a spot in a region, with ``share`` of its light spread by the lens.

    Reflections between the surfaces of a lens spread it over a kernel far wider than a spot: a Gaussian here.
    Light that falls outside the sensor is lost.
    """
    picture = np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.float32)
    picture[region] = electrons
    size = (WIDTH_PX // GLARE_CELL_PX, HEIGHT_PX // GLARE_CELL_PX)
    coarse = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    veil = cv2.GaussianBlur(coarse, (0, 0), GLARE_SIGMA_PX / GLARE_CELL_PX, borderType=cv2.BORDER_CONSTANT)
    picture *= np.float32(1.0 - share)
    picture += np.float32(share) * cv2.resize(veil, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
    return picture
