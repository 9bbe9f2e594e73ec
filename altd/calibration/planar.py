"""Calibrate the instrument ``planar`` from recordings of kind ``planar`` with known poses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from altd.calibration.calibrating import sha256_of_all
from altd.calibration.result import Progress
from altd.errors import BadInputError
from altd.instruments.planar.fitting import (
    MIN_POSES_FOR_SPREAD,
    PlaneFit,
    PlateView,
    fit_plane,
    radius_mm,
    scaled,
)
from altd.instruments.planar.homography import apply_homography, fit_homography
from altd.instruments.planar.instrument import MIN_LEDS, PlanarCalibration
from altd.instruments.planar.layout import (
    Pairs,
    Pose,
    check_layout,
    min_distance_mm,
    nearest,
    placed_mm,
    projective_match,
)
from altd.instruments.planar.leds import find_leds, led_image, rim_points_px
from altd.instruments.planar.plane import MODELS, Model, homography_camera
from altd.instruments.planar.pose import leave_one_out, solve_pose
from altd.mapping.grid import convex_hull_mm
from altd.recording.header import HEADER_FILE, LedPlateHeader
from altd.recording.reader import Recording
from altd.records import FloatArray, Frame, counted
from altd.vision.led_discs import Disc, disc_centres_px

_MAX_FRAMES = 100
"""Maximum number of frames of one pose; more are not needed."""
_MAX_TRIED = 5
"""Maximum number of poses tried for the first homography."""
_NEAR_SHARE = 0.25
"""Search radius about an LED's place by the known pose, as a share of the layout's minimum distance."""
_DIAMETER_RATIO_LIMITS = 0.75, 1.33
_OUTLIER_SIGMAS, _MIN_OUTLIER_PX = 8.0, 0.3
_MEDIAN_OF_RAYLEIGH = 1.1774
"""Median length of an error whose components have a standard deviation of 1."""
_MIN_LASTING_SHARE = 0.3
_UNSEEN_FACTOR = 3.0
"""Factor on sigma if the poses are too few to show the effect of the lens beyond them."""
_MIN_WRONG_MM, _WRONG_SIGMAS = 0.5, 10.0
"""A known pose is wrong if it deviates from the others' estimate by more than both limits, mm and sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class _Stay:
    """The plate at one known pose, from row ``place`` on: the discs of its mean frame, and their rims."""

    place: str
    pose: Pose
    discs: tuple[Disc, ...]
    rims_px: tuple[FloatArray, ...]
    variance_px2: float
    """Variance of a centre in one frame, px²; NaN if there was only one frame."""
    frames: int

    @property
    def centres_px(self) -> FloatArray:
        """Centres of the discs, (n, 2)."""
        return np.array([(disc.u_px, disc.v_px) for disc in self.discs]).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class PlanarResult:
    """A calibration, the parts of the recording that were left out, and its doubts."""

    calibration: PlanarCalibration
    refused: tuple[str, ...]
    doubts: tuple[str, ...]

    def lines(self) -> tuple[str, ...]:
        """Return the lines of a summary of the calibration."""
        of = self.calibration
        simulated = (
            "made from SIMULATED frames: every measurement with it is marked `simulated`",
        ) * of.simulated
        errors = (
            f"{model}: leave-one-out error a, b {mm:.4f} mm, phi {deg:.4f}° rms"
            for model, (mm, deg) in of.rms.items()
        )
        return (
            f"unit {of.unit_serial}, {of.recording_note}",
            *simulated,
            *errors,
            f"model: {of.fit.camera.model}; {counted(len(of.known_phi_deg), 'known pose')}; sigma of a "
            f"centre {of.fit.noise_px:.4f} px, in one frame {of.frame_noise_px:.4f} px, of an LED's place "
            f"{of.fit.sigma_led_mm:.4f} mm, of a known a or b {of.fit.sigma_pose_mm[0]:.4f} mm",
        )


def calibrate_planar(
    recordings: Sequence[Recording], progress: Progress = lambda done, total: None
) -> PlanarResult:
    """Fit the models to the known poses and keep the one with the smallest leave-one-out errors.

    Rows without a pose are left out. Raises BadInputError when no row has a pose, when the LEDs cannot be
    found or do not fit the layout, when a known pose contradicts the others, and for recordings of several
    plates or cameras.
    """
    plate = _plate_of_all(recordings)
    recording = recordings[0]
    place = recording.path / HEADER_FILE
    leds_mm = np.array(plate.leds_mm)
    try:
        check_layout(leds_mm)
    except ValueError as error:
        raise BadInputError(place, f"plate.leds_mm: {error}") from error
    stays = _stays(recordings, progress)
    (camera,) = recording.header.cameras.values()
    size = camera.width, camera.height
    homography = _first_homography(recording.path, stays, leds_mm)
    matched = [_matched(stay, leds_mm, homography) for stay in stays]
    refused = []
    for stay, pairs in zip(stays, matched, strict=True):
        if len(pairs) < min(MIN_LEDS, len(stay.discs)):
            raise BadInputError(
                stay.place,
                f"a_mm, b_mm, phi_deg are wrong: {len(pairs)} of {len(stay.discs)} lights are where an LED "
                f"would be",
            )
        if len(pairs) < MIN_LEDS:
            refused.append(f"{stay.place}: {counted(len(stay.discs), 'LED')} seen")
    kept = [(stay, pairs) for stay, pairs in zip(stays, matched, strict=True) if len(pairs) >= MIN_LEDS]
    stays = [stay for stay, _ in kept]
    views = [_plate_view(*each) for each in kept]
    seen_mm = np.concatenate([placed_mm(leds_mm[of.leds], of.pose) for of in views])
    areas_px = [stay.discs[light].area_px for stay, pairs in kept for _, light in pairs]
    per_mm = homography_camera(homography, seen_mm, size).px_per_mm(seen_mm)
    disc_mm = _disc_mm(place, plate, float(np.median(areas_px / np.abs(np.linalg.det(per_mm)))))
    numbered, outliers = _without_outliers(views, leds_mm, disc_mm, size)
    refused += [f"{stays[at].place}: {why}" for at, why in outliers]
    stays, views = [stays[at] for at, _ in numbered], [seen for _, seen in numbered]
    chosen, rms, factor = _chosen(size, stays, views, leds_mm, disc_mm)
    fit = fit_plane(chosen, leds_mm, views, disc_mm, size)
    frame_noise, lasting = _noise_px(stays, fit.noise_px)
    fit = scaled(replace(fit, noise_px=lasting), factor)
    calibration = PlanarCalibration(
        unit_serial=recording.header.unit.serial,
        created=datetime.now(UTC),
        recording_note=recording.header.note,
        recording_sha256=sha256_of_all([each.sha256() for each in recordings]),
        camera=camera.identity,
        origin=camera.origin,
        disc_mm=disc_mm,
        fit=fit,
        frame_noise_px=frame_noise,
        hull_mm=convex_hull_mm(seen_mm - seen_mm.mean(axis=0)) + seen_mm.mean(axis=0),
        known_phi_deg=tuple(of.pose[2] for of in views),
        rms=rms,
    )
    return PlanarResult(
        calibration, tuple(refused), _doubts(len(views), any(stay.frames > 1 for stay in stays))
    )


def _doubts(poses: int, has_scatter: bool) -> tuple[str, ...]:
    doubts = []
    if poses < MIN_POSES_FOR_SPREAD:
        doubts.append(
            f"{counted(poses, 'known pose')}: the lens's distortion and the error of the known poses are not "
            f"seen, so sigma lacks them; {MIN_POSES_FOR_SPREAD} or more are needed"
        )
    if not has_scatter:
        doubts.append("one frame a pose: the noise of a frame is taken from the fit")
    return tuple(doubts)


def _noise_px(stays: Sequence[_Stay], of_fit_px: float) -> tuple[float, float]:
    """Noise of a centre in one frame, and the part of the fit's noise that averaging does not reduce."""
    variances = [stay.variance_px2 for stay in stays if math.isfinite(stay.variance_px2)]
    if not variances:
        return of_fit_px, _MIN_LASTING_SHARE * of_fit_px
    of_frame = float(np.mean(variances))
    of_means = of_frame * float(np.mean([1.0 / stay.frames for stay in stays]))
    lasting = max(of_fit_px**2 - of_means, (_MIN_LASTING_SHARE * of_fit_px) ** 2)
    return math.sqrt(of_frame), math.sqrt(lasting)


def _plate_of_all(recordings: Sequence[Recording]) -> LedPlateHeader:
    """Return the plate of all recordings; raises BadInputError if plates, cameras or units differ."""
    first = recordings[0].header
    for recording in recordings:
        header = recording.header
        if header.kind != "planar" or not isinstance(header.plate, LedPlateHeader):
            raise BadInputError(recording.path, f"is of kind {header.kind!r}, not 'planar'")
        for key in ("unit", "cameras", "plate"):
            if getattr(header, key) != getattr(first, key):
                said = f"{key}: is not that of {recordings[0].path}"
                raise BadInputError(recording.path / HEADER_FILE, said)
    assert isinstance(first.plate, LedPlateHeader)  # noqa: S101  checked in the loop
    return first.plate


def _stays(recordings: Sequence[Recording], progress: Progress) -> list[_Stay]:
    """Return the known poses in the order of the rows; each pose is that of consecutive frames."""
    of_all = [[row for row in recording.rows if row.pose is not None] for recording in recordings]
    total = sum(map(len, of_all))
    if not total:
        raise BadInputError(
            recordings[0].rows.table.path, "no row has a known pose: a_mm, b_mm, phi_deg are empty or missing"
        )
    stays, done = [], 0
    for recording, rows in zip(recordings, of_all, strict=True):
        for pose, group in itertools.groupby(rows, key=lambda row: row.pose):
            if pose is None:
                continue
            of_pose = list(group)
            frames = [recording.frame(row) for row in of_pose[:_MAX_FRAMES]]
            done += len(of_pose)
            progress(done, total)
            stays.append(_stay(recording.rows.place(of_pose[0]), pose, frames))
    return stays


def _stay(place: str, pose: Pose, frames: Sequence[Frame]) -> _Stay:
    image = led_image(np.asarray(np.mean([frame.pixels for frame in frames], axis=0, dtype=np.float32)))
    discs = find_leds(image)
    variance = math.nan
    if len(frames) > 1 and discs:
        centres = np.array([disc_centres_px(led_image(frame.pixels), discs) for frame in frames])
        variances = centres[:, np.isfinite(centres).all(axis=(0, 2))].var(axis=0, ddof=1)
        variance = float(variances.mean()) if variances.size else math.nan
    rims = tuple(rim_points_px(image, disc) for disc in discs)
    return _Stay(place, pose, discs, rims, variance, len(frames))


def _first_homography(path: Path, stays: Sequence[_Stay], leds_mm: FloatArray) -> FloatArray:
    """Return the homography from px to mm of the fixed frame, by the tried pose that fits most others."""
    why, best, most = "", None, -1
    in_order = sorted(stays, key=lambda stay: abs(len(stay.discs) - len(leds_mm)))
    for stay in in_order[:_MAX_TRIED]:
        try:
            pairs = projective_match(leds_mm, stay.centres_px)
        except ValueError as error:
            why = why or f"{stay.place}: {error}"
            continue
        led, light = (list(column) for column in zip(*pairs, strict=True))
        homography = fit_homography(stay.centres_px[light], placed_mm(leds_mm[led], stay.pose))
        fitting = sum(len(_matched(other, leds_mm, homography)) for other in stays)
        if fitting > most:
            best, most = homography, fitting
    if best is None:
        raise BadInputError(path, f"shows the plate at no known pose; {why}")
    return best


def _matched(stay: _Stay, leds_mm: FloatArray, homography: FloatArray) -> Pairs:
    """Assign to the LEDs the lights near their places by the known pose."""
    if not stay.discs:
        return ()
    lights_mm = apply_homography(homography, stay.centres_px)
    near = np.full(len(lights_mm), _NEAR_SHARE * min_distance_mm(leds_mm))
    return nearest(placed_mm(leds_mm, stay.pose), lights_mm, near)


def _plate_view(stay: _Stay, pairs: Pairs) -> PlateView:
    led, light = (list(column) for column in zip(*pairs, strict=True))
    rims = tuple(stay.rims_px[each] for each in light)
    return PlateView(stay.pose, np.array(led), stay.centres_px[light], rims)


def _disc_mm(place: object, plate: LedPlateHeader, area_mm2: float) -> float:
    """Diameter of the LEDs, mm: from the header, else from the pictures; BadInputError if they contradict."""
    seen_mm = math.sqrt(4 * area_mm2 / math.pi)
    if plate.disc_mm is None:
        return seen_mm
    low, high = _DIAMETER_RATIO_LIMITS
    if not low < seen_mm / plate.disc_mm < high:
        raise BadInputError(
            str(place), f"plate.disc_mm is {plate.disc_mm:g}, but the LEDs look {seen_mm:.1f} mm wide"
        )
    return plate.disc_mm


def _without_outliers(
    views: Sequence[PlateView], leds_mm: FloatArray, disc_mm: float, size: tuple[int, int]
) -> tuple[list[tuple[int, PlateView]], list[tuple[int, str]]]:
    """Remove LEDs that contradict the others; return the remaining views and a reason for each removal.

    Each has the index of its pose. The limit is based on the median: otherwise a pose whose lights are no
    LEDs could mask itself by the noise that it adds to the fit.
    """
    kept = list(enumerate(views))
    outliers: list[tuple[int, str]] = []
    while True:
        seen = [of for _, of in kept]
        model: Model = "lens" if len(seen) >= MIN_POSES_FOR_SPREAD else "homography"
        fit = fit_plane(model, leds_mm, seen, disc_mm, size)
        off_px = [_off_px(fit, of, disc_mm) for of in seen]
        typical_px = float(np.median(np.concatenate(off_px))) / _MEDIAN_OF_RAYLEIGH
        limit_px = max(_OUTLIER_SIGMAS * typical_px, _MIN_OUTLIER_PX)
        better, found = [], []
        for (at, of), off in zip(kept, off_px, strict=True):
            good = (off < limit_px) | (len(of.leds) < 4)
            found += [
                (at, f"the light taken for LED {led} is {px:.1f} px from its place")
                for led, px in zip(of.leds[~good].tolist(), off[~good].tolist(), strict=True)
            ]
            rims = tuple(rim for rim, is_good in zip(of.rims_px, good.tolist(), strict=True) if is_good)
            if good.sum() >= MIN_LEDS:
                better.append((at, PlateView(of.pose, of.leds[good], of.centres_px[good], rims)))
        if not found:
            return kept, outliers
        kept, outliers = better, outliers + found


def _off_px(fit: PlaneFit, seen: PlateView, disc_mm: float) -> FloatArray:
    """Distance (n,) px of each LED of a pose from its place by the best-fitting pose."""
    noise = np.full(len(seen.leds), fit.noise_px)
    pose = solve_pose(fit, disc_mm, seen.leds, seen.centres_px, noise).pose
    placed = fit.camera.to_px(placed_mm(fit.leds_mm[seen.leds], pose))
    return np.asarray(np.linalg.norm(placed - seen.centres_px, axis=1))


def _chosen(
    size: tuple[int, int],
    stays: Sequence[_Stay],
    views: Sequence[PlateView],
    leds_mm: FloatArray,
    disc_mm: float,
) -> tuple[Model, Mapping[Model, tuple[float, float]], float]:
    """Return the model with the least leave-one-out errors, the errors of each, and its ratio to sigma."""
    if len(views) < MIN_POSES_FOR_SPREAD:
        return "homography", {}, _UNSEEN_FACTOR
    rms: dict[Model, tuple[float, float]] = {}
    cost: dict[Model, float] = {}
    ratio: dict[Model, float] = {}
    for model in MODELS:
        off, sigma = leave_one_out(model, leds_mm, views, disc_mm, size)
        length = np.linalg.norm(off, axis=1)
        cost[model] = float(np.median(length))
        rms[model] = (
            float(np.sqrt(np.mean(off[:, :2] ** 2))),
            float(np.degrees(np.sqrt(np.mean(off[:, 2] ** 2)) / radius_mm(leds_mm))),
        )
        excess = math.sqrt(float(np.mean((off / sigma) ** 2)))
        ratio[model] = excess if excess > 1.0 + 2.0 / math.sqrt(2.0 * off.size) else 1.0
        if model == MODELS[-1]:
            significance = np.abs(off / sigma).max(axis=1)
            worst = int(significance.argmax())
            if length[worst] > _MIN_WRONG_MM and significance[worst] > _WRONG_SIGMAS:
                raise BadInputError(
                    stays[worst].place,
                    f"a_mm, b_mm, phi_deg are {length[worst]:.2f} mm from the fit of the other poses",
                )
    best = min(MODELS, key=lambda model: cost[model])
    return best, rms, ratio[best]
