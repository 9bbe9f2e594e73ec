"""Photographs of real beams against ISO 11146 as laserbeamsize computes it."""

from pathlib import Path

import cv2
import laserbeamsize
import numpy as np
import pytest

from altd.records import Frame, Spot
from altd.vision.localise import locate, locate_ellipse


def iso_centroid_and_diameter(image: np.ndarray, spot: Spot) -> tuple[float, float, float]:
    """First moment on the region around the beam, a plane background through the region's rim taken off."""
    half = 1.25 * spot.diameter_px
    left, top = max(int(spot.u_px - half), 0), max(int(spot.v_px - half), 0)
    region = image[top : int(spot.v_px + half) + 1, left : int(spot.u_px + half) + 1].astype(float)
    v, u = np.mgrid[: region.shape[0], : region.shape[1]]
    rim = np.ones(region.shape, bool)
    width = max(4, len(region) // 20)
    rim[width:-width, width:-width] = False
    design = np.column_stack([np.ones(rim.sum()), u[rim], v[rim]])
    plane = np.linalg.lstsq(design, region[rim], rcond=None)[0]
    region -= plane[0] + plane[1] * u + plane[2] * v
    x, y, major, minor, _ = laserbeamsize.beam_size(region)
    return left + x, top + y, (major + minor) / 2


@pytest.mark.parametrize("name", ["TEM00_200mm.pgm", "k-500mm.png", "t-348mm.pgm", "t-hene.pgm"])
def test_a_real_beam_is_found_within_3_percent_of_its_diameter(name: str, shared_data: Path) -> None:
    image = cv2.imread(str(shared_data / "beams" / name), cv2.IMREAD_UNCHANGED)
    frame = Frame("photograph", 0, 0, image, 8 * image.dtype.itemsize)
    spot = locate(frame)
    assert isinstance(spot, Spot), spot
    x, y, diameter = iso_centroid_and_diameter(image, spot)
    assert np.hypot(spot.u_px - x, spot.v_px - y) < 0.03 * diameter
    second = locate_ellipse(frame)
    assert second is not None
    assert np.hypot(second.u_px - x, second.v_px - y) < 0.04 * diameter
