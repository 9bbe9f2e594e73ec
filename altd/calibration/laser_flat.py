"""A flat made with the laser itself: its spot is moved over a target in steps smaller than the spot.

In exposure k, a pixel reads A_k · F · S(x − p_k) above its dark level. F is its response, to be estimated. S
is the irradiance of the spot on the target, the same in all exposures. x is the place that the pixel shows,
by a first map of the scan; p_k is the stage's position, and A_k the laser's power. S is the mean of all
exposures about p_k, which averages out print and texture: a table, so it may have any shape. F and A_k are
estimated in turn by least squares, like the gain of a detector from dithered exposures (D. J. Fixsen,
S. H. Moseley, R. G. Arendt, "Calibrating array detectors", ApJS 128, 2000).

A factor exp(a · x) in F and its inverse in S and A_k leave all exposures unchanged, so a slope of F cannot be
separated from an asymmetry of S. The first solution sets all A_k to 1, in favour of constant power. After
that, A_k is the deviation of an exposure from its neighbours (``true_excess``). A wrong slope displaces all
spots of one size equally, including those of the scan, and so does not affect a measurement.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.calibration.fitting import fit_nodes
from altd.calibration.laser_raster import Exposures, Shot, SpotSums, true_excess
from altd.calibration.result import Progress
from altd.calibration.scan_grid import weighted_nodes
from altd.calibration.scan_nodes import Job, first_of_nodes, locate_nodes
from altd.calibration.target_frames import TargetFrames
from altd.errors import BadInputError
from altd.mapping.camera_model import px2_per_mm2
from altd.mapping.grid import edge_lines
from altd.mapping.tensor_map import TensorMap
from altd.recording.reader import Recording
from altd.records import FloatArray, NoSpot
from altd.vision.flat import Flat
from altd.vision.image import SATURATED_FROM, Image
from altd.vision.localise import locate
from altd.vision.settings import SpotSettings

_DIAMETERS_OF_NODES = 50
_PASSES = 4
"""Number of passes: dark level and spot, a response, the power in each exposure, the final response."""
_NOISE_SHARE = 0.1
"""Share of the spot's peak at which read noise is about as large as shot noise."""
_POWER_PRIOR = 0.05
"""Weight of a power of 1, in exposures; decisive where the target is dark, such as beyond its print."""
_MIN_POWER, _MAX_POWER = 0.5, 2.0
_MAX_LOST_SHARE = 0.2
_MIN_LIGHT = 0.1
"""Minimum light on a pixel of the flat, in exposures by the middle of the spot."""
_MIN_LEVEL = 0.02
_MAX_CLIPPED_SHARE = 0.01
_MIN_HOT_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Response in counts at the spot's peak, and the light on each pixel, in exposures at the peak."""

    response: Image
    light: FloatArray


def laser_flat(recording: Recording, camera: str, scan: TargetFrames, progress: Progress) -> Flat:
    """Compute a target's flat from a recording with the stage's positions; ``scan`` gives the first map.

    Pixels that are hot, clipped or hardly lit by the spot are 0. Raises ValueError when the exposures omit a
    part of the scan's area, are too dark or too bright, or have no spot at the stage's position.
    """
    first_map, diameter_mm = _first_map(scan, progress)
    raster = Exposures(recording, camera, first_map, diameter_mm)
    total = recording.rows.count[camera]
    done, passes = 0, _PASSES

    def exposures() -> Iterator[tuple[Image, Shot | None]]:
        nonlocal done
        for exposure in raster:
            yield exposure
            done += 1
            progress(done, passes * total)

    dark, clipped, spot = _survey(raster, exposures())
    outside_mm = np.full(raster.shape, -np.inf)
    for nx, ny, offset in edge_lines(first_map.hull_mm):
        np.maximum(outside_mm, nx * raster.x_mm + ny * raster.y_mm - offset, out=outside_mm)
    measured = outside_mm <= 0
    if (share := float(clipped[measured].mean())) > _MAX_CLIPPED_SHARE:
        raise ValueError(f"too bright to be a flat: {share:.0%} of the pixels are saturated")
    first = _solved(raster, exposures(), dark, spot)
    powers = _powers(raster, exposures(), dark, spot, first)
    if not powers.all():  # the first response included exposures without light
        passes += 2
        first = _solved(raster, exposures(), dark, spot, (powers > 0).astype(np.float64))
        powers = _powers(raster, exposures(), dark, spot, first)
    found = _solved(raster, exposures(), dark, spot, powers)
    dimmest = np.unravel_index(int(np.where(measured, found.light, np.inf).argmin()), raster.shape)
    if found.light[dimmest] < _MIN_LIGHT:
        raise ValueError(
            f"no exposure lights x {raster.x_mm[dimmest]:.0f} y {raster.y_mm[dimmest]:.0f} mm: the spot has "
            f"{diameter_mm:.0f} mm, its steps must be half of that at most and cover the scan"
        )
    usable = ~clipped & (found.light >= _MIN_LIGHT)
    usable &= dark < np.median(dark) + _MIN_HOT_SHARE * raster.full_scale
    return Flat.from_response(
        np.where(usable, found.response, 0), "laser", recording.header.cameras[camera].origin
    )


def _first_map(scan: TargetFrames, progress: Progress) -> tuple[TensorMap, float]:
    """Fit a map to the scan without a flat, good to 1 % of a spot; return it and the 1/e² diameter, mm."""
    job = Job(scan, SpotSettings(), None)
    nodes = locate_nodes(job, progress).usable
    first = first_of_nodes(job)
    try:
        if not nodes:
            raise ValueError("no node has a spot")
        fitted = fit_nodes(weighted_nodes(nodes, scan.image_size), scan.image_size, 0).fit.map
    except ValueError as error:
        raise BadInputError(scan.place, f"{scan.name}: {error}") from error
    diameters_mm = []
    for frame_row in first[:: 1 + len(first) // _DIAMETERS_OF_NODES]:
        spot = locate(frame_row.frame(), job.localiser)
        if not isinstance(spot, NoSpot):
            scale = px2_per_mm2(fitted.to_px, np.array([frame_row.row.position_mm]))[0]
            diameters_mm.append(spot.diameter_px / np.sqrt(scale))
    if not diameters_mm:
        raise BadInputError(scan.place, f"{scan.name}: the border of the picture cuts the spots of all nodes")
    return fitted, float(np.median(diameters_mm))


def _survey(
    raster: Exposures, exposures: Iterator[tuple[Image, Shot | None]]
) -> tuple[Image, npt.NDArray[np.bool_], Image]:
    """Return the dark level, the clipped pixels and a first spot.

    A pixel's dark level is its mean over all exposures with the spot elsewhere. The spot is the mean light at
    each offset from the stage's position, which averages out print and texture. Raises ValueError if the spot
    does not move, is beside the scan, or is too dark.
    """
    total, count = np.zeros(raster.shape), np.zeros(raster.shape)
    clipped = np.zeros(raster.shape, bool)
    sums = SpotSums()
    for pixels, shot in exposures:
        total += pixels
        count += 1
        if shot is not None:
            total[shot.window] -= shot.pixels
            count[shot.window] -= 1
            clipped[shot.window] |= shot.pixels >= SATURATED_FROM * raster.full_scale
            sums.add(shot)
    if not count.any() or not sums.pixels.any():
        raise ValueError("is not a laser flat: its spot is at one place, or outside the scan")
    dark = total / np.maximum(count, 1)
    dark[count == 0] = np.median(dark[count > 0])
    spot, peak = sums.spot
    if peak < _MIN_LEVEL * raster.full_scale:
        raise ValueError(f"too dark to be a flat: its spots have {peak:.1f} counts of {raster.full_scale}")
    return dark.astype(np.float32), clipped, spot


def _solved(
    raster: Exposures,
    exposures: Iterator[tuple[Image, Shot | None]],
    dark: Image,
    spot: Image,
    powers: FloatArray | None = None,
) -> _Solution:
    """Solve for the response by weighted least squares; ``powers`` (n,) of the exposures, None: all 1."""
    light, weight = np.zeros(raster.shape), np.zeros(raster.shape)
    for number, shot in enumerate(shot for _, shot in exposures if shot is not None):
        expected = shot.irradiance(spot)
        weights = _weights(expected)
        if powers is not None:
            expected *= np.float32(powers[number])
        weights *= expected
        light[shot.window] += weights * (shot.pixels - dark[shot.window])
        weight[shot.window] += weights * expected
    response = (light / np.maximum(weight, 1e-9)).astype(np.float32)
    return _Solution(response, weight * (1 + _NOISE_SHARE))


def _powers(
    raster: Exposures,
    exposures: Iterator[tuple[Image, Shot | None]],
    dark: Image,
    spot: Image,
    first: _Solution,
) -> FloatArray:
    """Estimate the laser's power in each exposure, (n,): usually 1, 0 for one without a spot.

    Raises ValueError if too many exposures have no spot at the stage's position.
    """
    positions, seen, noise, is_whole = array("d"), array("d"), array("d"), array("b")
    level = float(first.response[first.light >= _MIN_LIGHT].mean())
    for shot in (shot for _, shot in exposures if shot is not None):
        expected = shot.irradiance(spot)
        weights = _weights(expected)
        lit = expected * first.response[shot.window]
        excess = shot.pixels - dark[shot.window]
        prior = _POWER_PRIOR * level**2 * float((weights * expected * expected).sum())
        information = max(float((weights * lit * lit).sum()) + prior, 1e-9)
        seen.append((float((weights * lit * excess).sum()) + prior) / information)
        scatter = weights * lit * (excess - np.float32(seen[-1]) * lit)
        positions.extend(shot.position_mm)
        noise.append(float(np.linalg.norm(scatter)) / information)
        is_whole.append(shot.is_whole)
    power = np.array(seen)
    shows = (power >= _MIN_POWER) & (power <= _MAX_POWER)
    whole = np.array(is_whole, bool)
    lost, count = np.count_nonzero(whole & ~shows), np.count_nonzero(whole)
    if lost > _MAX_LOST_SHARE * count:
        raise ValueError(
            f"{lost} of {count} exposures have no spot of the usual light at the stage's position"
        )
    powers = np.zeros(len(power))
    powers[shows] = 1 + true_excess(
        np.array(positions).reshape(-1, 2)[shows],
        power[shows] - 1,
        np.array(noise)[shows],
        _weights(spot) * spot * spot,
        raster.diameter_mm,
    )
    return np.maximum(powers, 0)


def _weights(expected: Image) -> Image:
    """Weights of pixels: read noise is constant, shot noise grows with the light."""
    weights: Image = np.float32(1) / (expected + np.float32(_NOISE_SHARE))
    return weights
