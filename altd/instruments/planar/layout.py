"""Assignment of lights to the LEDs of a plate by its layout, in any pose, also when some are dark."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.instruments.planar.homography import apply_homography, fit_homography
from altd.records import FloatArray

Pairs = tuple[tuple[int, int], ...]
"""Pairs (LED, light), in the order of the LEDs."""

Pose = tuple[float, float, float]
"""Pose (a mm, b mm, φ °) of Eq. 2.59."""

_MAX_HYPOTHESES = 60_000
_MAX_STRETCH = 2.5
"""Maximum ratio of the two scales of an affine picture: a camera at 66° to the plate's normal."""
_AFFINE_SHARE = 0.25
"""Maximum deviation of a light from an affine picture, as a share of the LEDs' minimum distance."""
_FITTED_SHARE = 0.02
"""The same for the homography through all lights; it does not model the distortion of a lens."""
_MIN_LEDS_OF_HOMOGRAPHY = 5
"""Minimum number of LEDs, one more than a homography needs: four lights fit any four LEDs."""
_MIN_FITTING_SHARE = 0.75
"""Minimum share of the LEDs, or of the lights if these are fewer: five of seven lights fit by chance."""


def placed_mm(leds_mm: FloatArray, pose: Pose) -> FloatArray:
    """Positions (n, 2) of the plate's LEDs in the fixed frame, mm (Eq. 2.59)."""
    a_mm, b_mm, phi_deg = pose
    return leds_mm @ rotation(phi_deg).T + (a_mm, b_mm)


def rotation(phi_deg: float) -> FloatArray:
    """Rotation matrix (2, 2) of Eq. 2.59."""
    cosine, sine = math.cos(math.radians(phi_deg)), math.sin(math.radians(phi_deg))
    return np.array([[cosine, -sine], [sine, cosine]])


def wrapped_deg(phi_deg: float) -> float:
    """Wrap an angle to (−180°, 180°]."""
    return 180.0 - (180.0 - phi_deg) % 360.0


def rigid_pose(leds_mm: FloatArray, points_mm: FloatArray) -> Pose:
    """Pose that maps LEDs (n, 2) to points (n, 2) by least squares, n ≥ 2."""
    led, point = leds_mm.mean(axis=0), points_mm.mean(axis=0)
    a, b = leds_mm - led, points_mm - point
    phi = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    shift = point - rotation(math.degrees(phi)) @ led
    return float(shift[0]), float(shift[1]), wrapped_deg(math.degrees(phi))


@dataclass(frozen=True, slots=True)
class PlateMatch:
    """An assignment of lights to LEDs, and the pose that follows."""

    pairs: Pairs
    pose: Pose
    rms_mm: float


def rigid_matches(leds_mm: FloatArray, points_mm: FloatArray, tolerance_mm: FloatArray) -> list[PlateMatch]:
    """Find all assignments of two or more lights to LEDs of a rigid plate, the most lights first.

    ``points_mm`` (n, 2) are the lights in the fixed frame, ``tolerance_mm`` (n,) limits each one's deviation
    from its LED. An assignment that is part of another one is dropped.
    """
    found: dict[Pairs, PlateMatch] = {}
    for pose in _poses_by_pairs(leds_mm, points_mm, tolerance_mm):
        pairs: Pairs = ()
        for _ in range(3):  # two close lights determine the turn poorly: refine with all that fit
            lever = 1.0 if pairs else 4.0
            closer = nearest(placed_mm(leds_mm, pose), points_mm, lever * tolerance_mm)
            if len(closer) < 2 or closer == pairs:
                break
            pairs = closer
            pose = rigid_pose(leds_mm[[led for led, _ in pairs]], points_mm[[light for _, light in pairs]])
        if len(pairs) < 2 or pairs in found:
            continue
        led, light = (list(column) for column in zip(*pairs, strict=True))
        off_mm = np.linalg.norm(placed_mm(leds_mm[led], pose) - points_mm[light], axis=1)
        if np.all(off_mm <= tolerance_mm[light]):
            found[pairs] = PlateMatch(pairs, pose, float(np.sqrt(np.mean(off_mm**2))))
    ways = sorted(found.values(), key=lambda match: (-len(match.pairs), match.rms_mm))
    return [way for way in ways if not any(set(way.pairs) < set(other.pairs) for other in ways)]


def _poses_by_pairs(leds_mm: FloatArray, points_mm: FloatArray, tolerance_mm: FloatArray) -> list[Pose]:
    """Poses in which two lights have the distance of two LEDs."""
    leds = np.array(list(itertools.permutations(range(len(leds_mm)), 2)))
    lights = np.array(list(itertools.combinations(range(len(points_mm)), 2))).reshape(-1, 2)
    of_leds = np.linalg.norm(leds_mm[leds[:, 0]] - leds_mm[leds[:, 1]], axis=1)
    of_lights = np.linalg.norm(points_mm[lights[:, 0]] - points_mm[lights[:, 1]], axis=1)
    limit = tolerance_mm[lights].sum(axis=1)
    at_light, at_led = np.nonzero(np.abs(of_lights[:, None] - of_leds[None, :]) <= limit[:, None])
    return [
        rigid_pose(leds_mm[leds[led]], points_mm[lights[light]])
        for light, led in zip(at_light.tolist(), at_led.tolist(), strict=True)
    ]


def nearest(leds: FloatArray, lights: FloatArray, tolerance: FloatArray) -> Pairs:
    """Pairs of LEDs and lights that are each other's nearest, within the light's tolerance."""
    distance = np.linalg.norm(leds[:, None, :] - lights[None, :, :], axis=2)
    of_led, of_light = distance.argmin(axis=1), distance.argmin(axis=0)
    return tuple(
        (led, light)
        for led, light in enumerate(of_led.tolist())
        if of_light[light] == led and distance[led, light] <= tolerance[light]
    )


def min_distance_mm(leds_mm: FloatArray) -> float:
    """Distance of the two closest LEDs, mm."""
    return min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(leds_mm, 2))


def check_layout(leds_mm: FloatArray) -> None:
    """Raise ValueError for a layout on a line, or one that a turn maps to itself."""
    if np.linalg.svd(leds_mm - leds_mm.mean(axis=0), compute_uv=False)[1] < 1e-3 * np.ptp(leds_mm):
        raise ValueError("the LEDs lie on a line")
    tolerance = np.full(len(leds_mm), 0.05 * min_distance_mm(leds_mm))
    for match in rigid_matches(leds_mm, leds_mm, tolerance):
        if len(match.pairs) == len(leds_mm) and any(led != light for led, light in match.pairs):
            raise ValueError(f"the LEDs look the same when the plate is turned by {abs(match.pose[2]):.0f}°")


def projective_match(leds_mm: FloatArray, lights_px: FloatArray) -> Pairs:
    """Find the lights that are LEDs by layout alone, for any camera and pose, but not mirrored.

    Affine pictures of three LEDs give candidates, and a homography is fitted to each. Raises ValueError when
    fewer than five LEDs or three quarters of them fit, or another assignment fits as well.
    """
    ways: dict[Pairs, float] = {}
    most = min(len(leds_mm), len(lights_px))
    needed = max(_MIN_LEDS_OF_HOMOGRAPHY, math.ceil(_MIN_FITTING_SHARE * most))
    for led_px, distance_px in _affine_pictures(leds_mm, lights_px):
        pairs = nearest(led_px, lights_px, np.full(len(lights_px), _AFFINE_SHARE * distance_px))
        if len(pairs) >= needed and pairs not in ways:
            ways[pairs] = _misfit(leds_mm, lights_px, pairs) / distance_px
    fitting = sorted((-len(pairs), share, pairs) for pairs, share in ways.items() if share < _FITTED_SHARE)
    if not fitting:
        raise ValueError(f"{len(lights_px)} lights are seen, and no {needed} fit the layout")
    count_of_best, share, pairs = fitting[0]
    for count, other_share, other in fitting[1:]:
        if count == count_of_best and not set(other) & set(pairs) and other_share < 3.0 * share:
            raise ValueError("the lights fit the layout in two ways")
    return pairs


def _misfit(leds_mm: FloatArray, lights_px: FloatArray, pairs: Pairs) -> float:
    """Rms residual of a homography through LEDs and lights, px, corrected for the degrees of freedom."""
    led, light = (list(column) for column in zip(*pairs, strict=True))
    try:
        homography = fit_homography(leds_mm[led], lights_px[light])
    except ValueError:
        return math.inf
    off = apply_homography(homography, leds_mm[led]) - lights_px[light]
    return math.sqrt(float(np.square(off).sum()) / max(2 * len(pairs) - 8, 1))


def _affine_pictures(leds_mm: FloatArray, lights_px: FloatArray) -> Sequence[tuple[FloatArray, float]]:
    """All LEDs in the affine pictures that map three of them to three lights; their minimum distance there.

    The largest triangles are used, because their three lights determine most. v points down, so a picture
    that is not mirrored has a negative determinant.
    """
    triples = list(itertools.combinations(range(len(leds_mm)), 3))
    lights = np.array(list(itertools.permutations(range(len(lights_px)), 3))).reshape(-1, 3)
    triples.sort(key=lambda triple: -abs(_area(leds_mm[list(triple)])))
    pictures = []
    for triple in triples[: max(_MAX_HYPOTHESES // max(len(lights), 1), 8)]:
        corner, *others = leds_mm[list(triple)]
        to_unit = np.linalg.inv(np.stack([other - corner for other in others], axis=1))
        at = lights_px[lights]
        sides = np.stack([at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]], axis=-1) @ to_unit
        scales = np.linalg.svd(sides, compute_uv=False)
        good = (np.linalg.det(sides) < 0) & (scales[:, 0] < _MAX_STRETCH * scales[:, 1])
        for side, start, scale in zip(sides[good], at[good, 0], scales[good, 1], strict=True):
            pictures.append(((leds_mm - corner) @ side.T + start, float(scale) * min_distance_mm(leds_mm)))
    return pictures


def _area(corners: FloatArray) -> float:
    (x1, y1), (x2, y2) = corners[1] - corners[0], corners[2] - corners[0]
    return float(x1 * y2 - x2 * y1)
