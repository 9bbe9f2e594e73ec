"""Calibrate targets from recordings of an LED plate (thesis 3.3.2, 3.3.4): discs, grid, maps.

The plate gives the places of the LEDs, without stage and beam. docs/calibration.md describes the effects of
a laser spot that LEDs cannot show; ``LASER_SPOT_SIGMA_MM`` accounts for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, count

import numpy as np

from altd.calibration.camera_fingerprint import hot_pixels_of
from altd.calibration.fitting import TargetFit, fit_nodes
from altd.calibration.result import Progress, TargetEvidence, TargetsResult, residual_distances_mm
from altd.calibration.target_frames import FrameRow, LitRows, TargetFrames, lit_rows
from altd.errors import BadInputError
from altd.mapping.camera_model import (
    ToPx,
    disc_moment_mm2,
    light_centre_shift_px,
    px2_per_mm2,
    spot_moment_mm2,
)
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import TargetCalibration
from altd.recording.header import PlateHeader
from altd.records import FloatArray, Frame
from altd.vision.image import Image
from altd.vision.led_discs import Disc, disc_centres_px, find_discs
from altd.vision.led_grid import match_grid
from altd.vision.settings import UNKNOWN_SPOT, SpotSettings

LASER_SPOT_SIGMA_MM = 0.015
"""Scatter of a laser spot about a map from LEDs, per axis: 0.009 mm by print and speckle, as at the nodes
of scans (0.04 px on unit-a and on simulated units), and 0.012 mm by the fall-off of the lens, which draws
the centre of light of a 12 mm spot towards the middle."""
_CENTRE_OVER_FIT = 2.0
"""Scatter of the centre of light by speckle over that of a fitted profile, which the texture within a spot
predicts: 1.2 to 2.1 on simulated cameras, grey and colour, with gamma 1 and 2.2. Texture coarser than that
raises it to 2.4, and to 3.5 without speckle, where ``LASER_SPOT_SIGMA_MM`` is enough."""

_MAX_MISSING_SHARE = 0.2
_AREA_RATIO_LIMITS = 0.5, 2.0
_DIAMETER_RATIO_LIMITS = 0.75, 1.35
_MAX_DARK_RATIO = 0.98
"""Maximum mean of a dark frame over a lit one: in a lit room, the small LEDs add little to the mean."""
_ITERATIONS = 3
_LOCALISER = SpotSettings(method="moment")
"""Localiser of laser spots on these targets: the shift of the moment on a bent map is known."""


@dataclass(frozen=True, slots=True)
class _Leds:
    """The LEDs found on one target, in grid order, the faults of the others, and lights that are no LED.

    ``nodes_mm`` (n, 2) are their places.
    """

    nodes_mm: FloatArray
    discs: tuple[Disc, ...]
    missing: Mapping[tuple[int, int], str]
    lights: tuple[str, ...]

    @property
    def centres_px(self) -> FloatArray:
        """Centres (n, 2) of area of the discs."""
        return np.array([(disc.u_px, disc.v_px) for disc in self.discs])

    @property
    def areas_px(self) -> FloatArray:
        """Areas (n,) of the discs."""
        return np.array([disc.area_px for disc in self.discs])


def calibrate_plates(targets: Sequence[TargetFrames], progress: Progress) -> TargetsResult:
    """Fit the maps of targets from plates at the targets' places.

    Raises BadInputError when too few LEDs shine or the LEDs cannot be identified.
    """
    if not targets:
        return TargetsResult()
    calibrated, evidence, refused = [], [], []
    plates = [frames.parts[0] for frames in targets]
    rows = [lit_rows(of.recording, of.target.camera, _MAX_DARK_RATIO, progress) for of in plates]
    done, total = count(1), sum(2 * sum(of.lit) + sum(of.dark) for of in rows)

    def frame(of: FrameRow) -> Frame:
        progress(next(done), total)
        return of.frame()

    for frames, of_frames in zip(targets, rows, strict=True):
        target, of_target, lights = _target(frames, of_frames, frame)
        calibrated.append(target)
        evidence.append(of_target)
        refused += [f"{frames.name} LED {_place(node)}: {why}" for node, why in of_target.excluded]
        refused += [f"{frames.name}: {light}" for light in lights]
    remark = f"a plate shows no laser spot: its pattern and fall-off are taken as {LASER_SPOT_SIGMA_MM} mm"
    return TargetsResult(tuple(calibrated), tuple(refused), tuple(evidence), remarks=(remark,))


def spots_of_plate(
    seen: TargetFrames, fitted: TensorMap, progress: Progress
) -> tuple[FloatArray, FloatArray]:
    """Return the places (n, 2) mm of a plate's LEDs, and the px (n, 2) at which laser spots there are seen.

    A disc and a spot differ by the map's bend. Raises BadInputError as ``calibrate_plates`` does.
    """
    of = seen.parts[0]
    rows = lit_rows(of.recording, of.target.camera, _MAX_DARK_RATIO, progress)
    dark, lit = (_mean(row.frame() for row in compress(seen, flags)) for flags in (rows.dark, rows.lit))
    try:
        leds = _leds(seen, dark, lit)
        areas_mm2 = leds.areas_px / px2_per_mm2(fitted.to_px, leds.nodes_mm)
        shift_px = _spot_shift_px(seen.plate, fitted.to_px, leds.nodes_mm, float(np.median(areas_mm2)))
    except ValueError as error:
        raise BadInputError(seen.place, f"{seen.name}: {error}") from error
    return leds.nodes_mm, leds.centres_px + shift_px


def _leds(seen: TargetFrames, dark: Image | None, lit: Image | None) -> _Leds:
    """Find a target's LEDs in mean pictures; raises ValueError if they cannot be used."""
    plate = seen.plate
    if dark is None or lit is None:
        raise ValueError("its frames are alike: the plate's LEDs must be off in some and on in others")
    leds = _find(lit - dark, plate, seen.is_mirrored)
    if len(leds.missing) > _max_missing(plate):
        first = next(iter(leds.missing.items()))
        raise ValueError(
            f"{len(leds.missing)} of {plate.columns * plate.rows} LEDs cannot be used, "
            f"{_max_missing(plate)} at most: the first at {_place(_at(plate, first[0]))} is {first[1]}"
        )
    return leds


def _max_missing(plate: PlateHeader) -> int:
    return int(_MAX_MISSING_SHARE * plate.columns * plate.rows)


def _target(
    seen: TargetFrames, rows: LitRows, frame: Callable[[FrameRow], Frame]
) -> tuple[TargetCalibration, TargetEvidence, tuple[str, ...]]:
    """Fit one target's map; return it with its evidence and the lights that are no LED."""
    plate, name = seen.plate, seen.name
    width, height = seen.image_size

    def frames(leds_on: bool) -> Iterator[Frame]:
        return (frame(of) for of in compress(seen, rows.lit if leds_on else rows.dark))

    dark, lit = _mean(frames(False)), _mean(frames(True))
    try:
        leds = _leds(seen, dark, lit)
        nodes_mm, max_dropped = leds.nodes_mm, _max_missing(plate) - len(leds.missing)
        fitted, kept, complaints = _fit(
            plate, nodes_mm, leds.centres_px, leds.areas_px, (width, height), max_dropped
        )
    except ValueError as error:
        raise BadInputError(seen.place, f"{name}: {error}") from error
    assert dark is not None  # noqa: S101  checked by _leds
    fit = fitted.fit
    scatter_px, exposures = _scatter_px(frames(True), dark, tuple(leds.discs[row] for row in kept))
    distance_mm = residual_distances_mm(fit, nodes_mm[kept])
    scale = np.sqrt(px2_per_mm2(fit.map.to_px, nodes_mm[kept]))
    pattern_px = LASER_SPOT_SIGMA_MM * float(np.median(scale))
    target = TargetCalibration(
        name=name,
        z_mm=seen.z_mm,
        glass=seen.glass,
        width=width,
        height=height,
        localiser=_LOCALISER,
        flat=None,
        map=replace(fit.map, noise_px=float(np.hypot(fit.map.noise_px, pattern_px))),
        cross_check=fitted.cross_check,
        leave_one_out_px=fit.leave_one_out_px,
        residual_mean_mm=float(distance_mm.mean()),
        residual_std_mm=float(distance_mm.std(ddof=1)),
        residual_max_mm=float(distance_mm.max()),
        repeatability_px=_pooled(scatter_px),
        leds_px=np.empty((0, 2)),
        camera=seen.camera,
        origin=seen.origin,
        fingerprint=hot_pixels_of(seen),
        spot=replace(UNKNOWN_SPOT, pattern_px=pattern_px / _CENTRE_OVER_FIT, noise_px=pattern_px),
    )
    missing = [(_at(plate, cell), why) for cell, why in leds.missing.items()]
    evidence = TargetEvidence(
        name=name,
        nodes_mm=nodes_mm[kept],
        nodes_px=fit.map.to_px(nodes_mm[kept]) + fit.residuals_px,
        residuals_px=fit.residuals_px,
        leave_one_out_residuals_px=fit.leave_one_out_residuals_px,
        relative_sigma=fit.relative_sigma,
        scatter_px=scatter_px,
        exposures=exposures,
        excluded=tuple(missing + [(tuple(nodes_mm[row].tolist()), why) for row, why in complaints.items()]),
        leds_dropped=(),
        candidates=fitted.candidates,
    )
    return target, evidence, leds.lights


def _mean(frames: Iterable[Frame]) -> Image | None:
    """Mean of the frames, counts; None without frames."""
    total, number = np.zeros(()), 0
    for frame in frames:
        total, number = total + frame.pixels, number + 1
    return np.asarray(total / number, dtype=np.float32) if number else None


def _find(difference: Image, plate: PlateHeader, mirrored: bool) -> _Leds:
    """Find the plate's LEDs in a picture, lit minus dark; raises ValueError if they cannot be identified."""
    seen = find_discs(difference)
    if not seen.found:
        detail = f": {seen.rejected[0]}" if seen.rejected else ""
        raise ValueError(f"no LED of the plate is seen{detail}")
    points_px = np.array([(disc.u_px, disc.v_px) for disc in seen.found])
    match = match_grid(points_px, plate.columns, plate.rows, mirrored)
    cells, discs, missing = [], [], {}
    for (j, i), row in np.ndenumerate(match.rows_of):
        if row < 0:
            missing[i, j] = "dark"
        elif seen.found[row].is_cut:
            missing[i, j] = "cut by the edge of the picture"
        else:
            cells.append((i, j))
            discs.append(seen.found[row])
    lights = [
        f"a light at ({seen.found[row].u_px:.0f}, {seen.found[row].v_px:.0f}) px is not on the grid"
        for row in match.extra
    ]
    nodes_mm = np.array([_at(plate, cell) for cell in cells])
    return _Leds(nodes_mm, tuple(discs), missing, (*lights, *seen.rejected))


def _fit(
    plate: PlateHeader,
    nodes_mm: FloatArray,
    centres_px: FloatArray,
    areas_px: FloatArray,
    image_size: tuple[int, int],
    max_dropped: int,
) -> tuple[TargetFit, list[int], dict[int, str]]:
    """Fit the map of a laser spot's centre of light; return it, the rows used, and the faults of others.

    A disc's centre of area differs from the picture of its middle; the centre of light of a wider laser spot
    differs more. Both shifts follow from the map, so the fit is repeated with them.
    """
    kept = list(range(len(nodes_mm)))
    complaints: dict[int, str] = {}
    shift_px = np.zeros_like(centres_px)
    for _ in range(_ITERATIONS):
        nodes_px = centres_px + shift_px
        fitted = fit_nodes(
            Nodes.ordinary(nodes_mm[kept], nodes_px[kept]), image_size, max_dropped - len(complaints)
        )
        fit = fitted.fit
        for row in (kept[at] for at in fitted.dropped):
            off_px = float(np.linalg.norm(nodes_px[row] - fit.map.to_px(nodes_mm[row : row + 1])[0]))
            complaints[row] = f"its disc lies {off_px:.1f} px from where the other LEDs put it"
        kept = [row for row in kept if row not in complaints]
        areas_mm2 = areas_px / px2_per_mm2(fit.map.to_px, nodes_mm)
        usual_mm2 = float(np.median(areas_mm2[kept]))
        odd = [
            row
            for row in kept
            if not _AREA_RATIO_LIMITS[0] < areas_mm2[row] / usual_mm2 < _AREA_RATIO_LIMITS[1]
        ]
        for row in odd[: max_dropped - len(complaints)]:
            complaints[row] = f"its disc has {areas_mm2[row] / usual_mm2:.1f} times the area of the others"
        kept = [row for row in kept if row not in complaints]
        shift_px = _spot_shift_px(plate, fit.map.to_px, nodes_mm, usual_mm2)
    fitted = fit_nodes(Nodes.ordinary(nodes_mm[kept], (centres_px + shift_px)[kept]), image_size, 0)
    return fitted, kept, complaints


def _spot_shift_px(plate: PlateHeader, to_px: ToPx, nodes_mm: FloatArray, disc_mm2: float) -> FloatArray:
    """Shift (n, 2) from the centre of area of discs to the centre of light of a laser spot; or ValueError."""
    spot_moment = spot_moment_mm2(plate.beam_mm, _LOCALISER.threshold, _LOCALISER.power)
    return light_centre_shift_px(to_px, nodes_mm, spot_moment - disc_moment_mm2(_disc_mm(plate, disc_mm2)))


def _disc_mm(plate: PlateHeader, area_mm2: float) -> float:
    """Diameter of the LEDs, mm: from the header, else from the pictures; ValueError if they contradict."""
    seen_mm = float(np.sqrt(4 * area_mm2 / np.pi))
    if plate.disc_mm is None:
        return seen_mm
    if not _DIAMETER_RATIO_LIMITS[0] < seen_mm / plate.disc_mm < _DIAMETER_RATIO_LIMITS[1]:
        raise ValueError(
            f"the LEDs look {seen_mm:.1f} mm wide with a pitch of {plate.pitch_mm:g} mm, but disc_mm is "
            f"{plate.disc_mm:g}: one of them is wrong"
        )
    return plate.disc_mm


def _scatter_px(
    lit: Iterable[Frame], dark: Image, discs: tuple[Disc, ...]
) -> tuple[FloatArray, tuple[int, ...]]:
    """Standard deviation (n, 2) of each LED's centre in single exposures, and the exposures that show it."""
    exposures = np.zeros((len(discs), 1), np.int64)
    total, squares = np.zeros((2, len(discs), 2))
    middle = np.array([(disc.u_px, disc.v_px) for disc in discs])  # as origin: small numbers keep digits
    for frame in lit:
        off_px = disc_centres_px(frame.pixels.astype(np.float32) - dark, discs) - middle
        found = np.isfinite(off_px[:, :1])
        exposures += found
        total += np.where(found, off_px, 0)
        squares += np.where(found, np.square(off_px), 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = (squares - np.square(total) / exposures) / (exposures - 1)
        scatter = np.where(exposures > 1, np.sqrt(np.maximum(variance, 0)), np.nan)
    return scatter, tuple(exposures[:, 0].tolist())


def _pooled(scatter_px: FloatArray) -> FloatArray:
    """Root mean square over the LEDs, u and v; 0 if there was only one exposure."""
    known = scatter_px[np.isfinite(scatter_px[:, 0])]
    return np.asarray(np.sqrt(np.mean(np.square(known), axis=0))) if len(known) else np.zeros(2)


def _at(plate: PlateHeader, cell: tuple[int, int]) -> tuple[float, float]:
    """Place of the LED at a cell (column, row), mm."""
    x, y = (origin + plate.pitch_mm * at for origin, at in zip(plate.origin_mm, cell, strict=True))
    return x, y


def _place(node_mm: tuple[float, float]) -> str:
    return f"x {node_mm[0]:g} y {node_mm[1]:g} mm"
