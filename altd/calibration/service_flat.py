"""A flat learnt from the spots of service: at places that the unit itself measured, through its present map.

The flat is the mean of many pictures over their spots' common model, a super-Gaussian, weighted by photon and
read noise. A spot takes part of the texture below it with it, so the places carry a part of the pattern; each
pass locates all spots through the present flat and leaves a smaller part (docs/studies/learnt-pattern.md,
docs/decisions/0051-flat-in-service.md). Waves much longer than a spot are not observable: they are left to
the map, and the lens' fall-off to a quadratic.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.fitting import best_fit
from altd.calibration.from_scans import PROFILE, calibrate_scans
from altd.calibration.printed.sample import PolynomialInverse
from altd.calibration.result import Progress, TargetsResult
from altd.calibration.scan_grid import MIN_LEARNT_SHARE, weighted_nodes
from altd.calibration.scan_nodes import Job, locate_nodes
from altd.calibration.target_frames import TargetFrames
from altd.errors import BadInputError
from altd.mapping.nodes import Fiducials
from altd.measuring.calibration import TargetCalibration
from altd.recording.frames_table import FrameLine
from altd.recording.reader import Recording
from altd.records import FloatArray, Frame, Spot
from altd.vision.flat import BLOCK_PX, Flat, Learnt, block_sum
from altd.vision.image import SATURATED_FROM, Image
from altd.vision.localise import locate

PASSES = 3
"""Passes after which a constant power leaves less than the noise of some 700 spots."""
_MIN_SPOTS, _MIN_CAMERAS, _MIN_NODES = 200, 2, 6
_CELL_MM = 1.0
"""One spot for each cell of this size: more at one place would only repeat its errors."""
_FORM_STEP = 4
"""One of so many spots shows their usual form."""
FAR = 1e-4
"""Share of the peak below which a pixel shows the light around the spot alone."""
_RIM = 1.3
"""Half of a spot's window, as a multiple of the distance at which this share is left."""
_MIN_FAR_PIXELS = 50
_LEAST = 0.02
"""Least share of the peak at which a pixel counts."""
_READ_SHARE = 0.1
"""Share of the spot's peak at which read noise is about as large as shot noise."""
_ASSUMED = 0.01
"""Weight of the assumed response, in exposures at the peak: photon noise against the contrast of grain."""
_KNOWN = 0.02
"""Light, in exposures at the peak, from which a pixel is known."""
_MAX_CHANGE = 0.02
"""Change of the response between two halves of the spots from which only the later half counts: a film."""
_SMOOTH_PX, _AROUND_PX = 15, 9
_MIN_BOTH = 0.3
_FALL_OFF = 0.4, 1.5
"""Limits of the quadratic outside of the learnt area, as shares of the mean."""
_MAX_RATIO = 0.8
"""Largest ratio of the nodes' scatter with a flat to that without: the right surface has 0.2 to 0.5, another
one 1.1 to 1.4."""
MAX_POWER_RMS = 0.005
"""Largest scatter of the laser's power: 0.01 leaves more of the pattern than without a flat."""


@dataclass(frozen=True, slots=True)
class _Placed:
    """A spot of service: its place (2,) mm, its form in mm, a, b, c and order (4,), and its diameter."""

    at_mm: FloatArray
    form: FloatArray
    diameter_px: float


@dataclass(slots=True, eq=False)
class _Sums:
    """Sums of light and weight of each half of the spots, (2, rows, columns)."""

    light: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True)
class Service:
    """One target in a recording of service; ``before`` is its calibration without it.

    ``rows`` are its frames without light of the LEDs, by the exposure's sequence.
    """

    recording: Recording
    camera: str
    rows: Mapping[int, FrameLine]
    job: Job
    before: TargetCalibration

    def placed(self, pixels: Frame, target: TargetCalibration) -> _Placed | None:
        """Locate a spot through the target's present flat and map; None if there is none."""
        spot = locate(pixels, target.localiser, target.flat, target.spot)
        point = target.point(spot.u_px, spot.v_px) if isinstance(spot, Spot) else None
        if not isinstance(spot, Spot) or spot.shape is None or point is None:
            return None
        to_px = np.linalg.inv(point.jacobian_mm_per_px)
        metric = to_px.T @ np.array([[spot.shape.a, spot.shape.b], [spot.shape.b, spot.shape.c]]) @ to_px
        form = np.array([metric[0, 0], metric[0, 1], metric[1, 1], spot.shape.order])
        return _Placed(np.array([point.x_mm, point.y_mm]), form, spot.diameter_px)

    def usual(self, target: TargetCalibration, sequences: Sequence[int]) -> _Placed:
        """Return a spot of the usual form; what the present flat lacks has a part in it."""
        spots = [self.placed(self.recording.frame(self.rows[sequence]), target) for sequence in sequences]
        known = [spot for spot in spots if spot is not None]
        if not known:
            raise BadInputError(self.recording.path, f"{target.name}: its own flat shows none of its spots")
        return _Placed(
            known[0].at_mm,
            np.median([spot.form for spot in known], axis=0),
            float(np.median([spot.diameter_px for spot in known])),
        )

    def learn(
        self, target: TargetCalibration, sequences: Sequence[int], progress: Progress
    ) -> tuple[Flat, dict[int, FloatArray]]:
        """Learn a flat through the target's present flat and map from spots of the usual form.

        Return it, and power, x and y (3,) by the exposure's sequence.
        """
        header = self.recording.header.cameras[self.camera]
        shape = header.height, header.width
        assumed = np.ones(shape, np.float32) if self.before.flat is None else self.before.flat.response
        present = assumed if target.flat is None else target.flat.response
        usual = self.usual(target, sequences[::_FORM_STEP])
        grid = PolynomialInverse(target.map).grid_mm(*shape).astype(np.float32)
        x_mm, y_mm = (np.ascontiguousarray(grid[..., axis]) for axis in (0, 1))
        a, b, c, order = usual.form
        flattest = float(np.linalg.eigvalsh([[a, b], [b, c]])[0])
        reach_mm = _RIM * math.sqrt(2.0 * (-math.log(FAR)) ** (1.0 / order) / flattest)
        sums = _Sums(np.zeros((2, *shape)), np.zeros((2, *shape)))
        powers: dict[int, FloatArray] = {}
        for number, sequence in enumerate(sequences):
            progress(number + 1, len(sequences))
            frame = self.recording.frame(self.rows[sequence])
            placed = self.placed(frame, target)
            if placed is None:
                continue
            window = _window(target, placed.at_mm, reach_mm, shape)
            pixels = frame.pixels[window].astype(np.float32)
            at_x, at_y = (np.float32(mm) for mm in placed.at_mm)
            model = _model(usual.form, x_mm[window] - at_x, y_mm[window] - at_y)
            if pixels.max() >= SATURATED_FROM * ((1 << header.bits) - 1):
                continue
            light = without_surroundings(pixels, model < FAR)
            if light is None:
                continue
            weights = np.where(model > _LEAST, 1.0 / (model + np.float32(_READ_SHARE)), np.float32(0))
            expected = model * present[window]
            half = int(2 * number >= len(sequences))
            sums.light[half][window] += weights * model * light
            sums.weight[half][window] += weights * model * model
            information = float((weights * expected * expected).sum())
            power = float((weights * expected * light).sum()) / max(information, 1e-9)
            powers[sequence] = np.array([power, *placed.at_mm])
        light_sum, weight = _latest_where_changed(sums, assumed)
        response = _response(light_sum, weight, assumed)
        share = block_sum((weight / (weight + _KNOWN)).astype(np.float32), BLOCK_PX) / np.float32(BLOCK_PX**2)
        learnt = Learnt.of(share, self.before.map.noise_px, usual.diameter_px)
        return Flat.from_response(response, "service", header.origin, learnt), powers

    def mapped(self, flat: Flat, fiducials: Fiducials | None, progress: Progress) -> TargetCalibration:
        """Return the target with the map through its nodes, located by the flat; for the next pass only."""
        job, limits = replace(self.job, flat=flat), self.before.map
        nodes = locate_nodes(job, progress).usable
        place = f"{self.recording.path}: {job.name}"
        if len(nodes) < _MIN_NODES:
            raise BadInputError(place, f"through its flat {len(nodes)} nodes of the scan have a spot")
        try:
            weighted = weighted_nodes(nodes, job.frames.image_size, flat.learnt)
            fitted = best_fit(weighted, job.frames.image_size, fiducials).map
        except ValueError as error:
            raise BadInputError(place, f"through its flat the scan has no map: {error}") from error
        fitted = replace(fitted, margin_mm=limits.margin_mm, beyond_px_per_mm=limits.beyond_px_per_mm)
        return replace(self.before, flat=flat, localiser=job.localiser, map=fitted)


def with_service(
    scanned: Sequence[TargetFrames], before: TargetsResult, recording: Recording, progress: Progress
) -> TargetsResult:
    """Calibrate the scans' targets through flats learnt from a recording of service.

    ``check_service`` has checked the recording. A learnt flat is used only if the nodes that it shows scatter
    clearly less with it. Raises BadInputError for too few places, and if the laser's power scatters.
    """
    services = list(_services(scanned, before, recording))
    sequences = _new_places(services, progress)
    targets = [service.before for service in services]
    learnt: dict[str, Flat] = {}
    for left in reversed(range(PASSES)):
        powers = []
        for service, target in zip(services, targets, strict=True):
            learnt[target.name], power = service.learn(target, sequences, progress)
            powers.append(power)
        rms = power_rms(powers)
        if not rms <= MAX_POWER_RMS:
            known = "is not known" if math.isnan(rms) else f"scatters by {100 * rms:.1f} %"
            raise BadInputError(
                recording.path, f"the laser's power {known}; {100 * MAX_POWER_RMS:g} % at most for a flat"
            )
        if left:
            targets = [
                service.mapped(learnt[service.job.name], before.fiducials.get(service.job.name), progress)
                for service in services
            ]
    try:
        now = calibrate_scans(scanned, learnt, progress, before.fiducials)
    except BadInputError as error:
        raise BadInputError(recording.path, f"its flats do not fit the scan: {error.message}") from error
    scatters = {
        name: (_scatter_px(before, name, flat), _scatter_px(now, name, flat)) for name, flat in learnt.items()
    }
    used = {name: learnt[name] for name, (was_px, is_px) in scatters.items() if is_px < _MAX_RATIO * was_px}
    if used.keys() != learnt.keys():
        now = calibrate_scans(scanned, used, progress, before.fiducials)
    lines = [
        f"{name}: the nodes on the learnt flat scatter by {with_px:.3f} px with it, "
        f"{without_px:.3f} px without{'' if name in used else ': it is not used'}"
        for name, (without_px, with_px) in scatters.items()
    ]
    return replace(now, remarks=(*now.remarks, *lines))


def _new_places(services: Sequence[Service], progress: Progress) -> list[int]:
    """Return the exposures that show every target at a new place.

    The same exposures of all targets, because they show the laser's power together. Raises BadInputError for
    fewer than 200.
    """
    shared = sorted(set.intersection(*(set(service.rows) for service in services)))
    taken: list[set[tuple[int, ...]]] = [set() for _ in services]
    sequences: list[int] = []
    for number, sequence in enumerate(shared):
        progress(number + 1, len(shared))
        cells: list[tuple[int, ...]] = []
        for service, known in zip(services, taken, strict=True):
            spot = service.placed(service.recording.frame(service.rows[sequence]), service.before)
            cell = () if spot is None else tuple(np.rint(spot.at_mm / _CELL_MM).astype(int).tolist())
            if spot is None or cell in known:
                break
            cells.append(cell)
        else:
            sequences.append(sequence)
            for known, cell in zip(taken, cells, strict=True):
                known.add(cell)
    if len(sequences) < _MIN_SPOTS:
        raise BadInputError(
            services[0].recording.path,
            f"{len(sequences)} exposures show both targets at a new place, {_MIN_SPOTS} are needed: let the "
            "beam move over the area while recording",
        )
    return sequences


def check_service(scanned: Sequence[TargetFrames], flats: Mapping[str, Flat], recording: Recording) -> None:
    """Raise BadInputError unless a recording of service is of the scans' unit, cameras and targets.

    The targets must have no flat in ``flats``: one that was recorded is better.
    """
    header, path = recording.header, recording.path
    if header.kind != "measurement":
        raise BadInputError(path, f"is of kind {header.kind!r}, not 'measurement'")
    shown = {target.name: target.camera for target in header.shown_targets}
    targets = [of for of in scanned if of.name in shown]
    if len({shown[of.name] for of in targets}) < _MIN_CAMERAS:
        raise BadInputError(path, "does not show two targets of the scan, each with a camera")
    for of in targets:
        camera = header.cameras[shown[of.name]]
        if header.unit.serial != of.unit_serial:
            raise BadInputError(path, f"is of unit {header.unit.serial!r}, the scan of {of.unit_serial!r}")
        if (camera.width, camera.height) != of.image_size:
            raise BadInputError(path, f"{of.name}: frames of another size than those of the scan")
        if other := camera.identity.difference_from(of.camera):
            raise BadInputError(path, f"{of.name}: is of another camera than the scan: {other}")
        if of.name in flats:
            raise BadInputError(path, f"{of.name}: has a recorded flat; --service is for targets without")


def _services(
    scanned: Sequence[TargetFrames], before: TargetsResult, recording: Recording
) -> Iterator[Service]:
    """Yield the targets of a recording of service."""
    cameras = {target.name: target.camera for target in recording.header.shown_targets}
    for frames, target in zip(scanned, before.targets, strict=True):
        if (camera := cameras.get(target.name)) is not None:
            rows = {row.sequence: row for row in recording.rows.of(camera) if not row.leds_on}
            yield Service(recording, camera, rows, Job(frames, PROFILE, None), target)


def _scatter_px(result: TargetsResult, name: str, flat: Flat) -> float:
    """Return the rms of the leave-one-out residuals of the nodes on the learnt part; inf for too few."""
    (seen,) = (evidence for evidence in result.evidence if evidence.name == name)
    shares = [flat.learnt.of_spot(u, v) if flat.learnt else 0.0 for u, v in seen.nodes_px]
    on_it = np.array(shares) >= MIN_LEARNT_SHARE
    if np.count_nonzero(on_it) < _MIN_NODES:
        return math.inf
    return float(np.sqrt(np.square(seen.leave_one_out_residuals_px[on_it]).mean()))


def power_rms(powers: Sequence[Mapping[int, FloatArray]]) -> float:
    """Return the scatter of the laser's power, relative, that two targets show in the same exposures.

    ``powers`` has power, x and y (3,) of each. The texture of a target changes the apparent power
    independently of the other's, so the covariance of the two is that of the power; what is smooth in the
    place, as the fall-off of a lens, is removed before.
    """
    first, second = powers[0], powers[-1]
    shared = sorted(first.keys() & second.keys())
    if len(shared) < _MIN_SPOTS // 2:
        return math.nan
    rests = []
    for of in (first, second):
        power, x_mm, y_mm = np.array([of[sequence] for sequence in shared]).T
        terms = np.column_stack([np.ones_like(x_mm), x_mm, y_mm, x_mm**2, x_mm * y_mm, y_mm**2])
        rests.append((power - terms @ np.linalg.lstsq(terms, power, rcond=None)[0]) / np.median(power))
    return math.sqrt(max(float(np.cov(rests)[0, 1]), 0.0))


def _model(form: FloatArray, dx_mm: Image, dy_mm: Image) -> Image:
    """Super-Gaussian with a peak of 1: exp(−q^order), q = (a dx² + 2 b dx dy + c dy²)/2."""
    a, b, c, order = (np.float32(value) for value in form)
    q = np.float32(0.5) * (a * dx_mm * dx_mm + 2 * b * dx_mm * dy_mm + c * dy_mm * dy_mm)
    return np.asarray(np.exp(-(np.maximum(q, np.float32(1e-9)) ** order)), np.float32)


def _window(
    target: TargetCalibration, at_mm: FloatArray, reach_mm: float, shape: tuple[int, int]
) -> tuple[slice, slice]:
    u_px, v_px = target.map.to_px(at_mm[None])[0]
    reach_px = reach_mm * target.px_per_mm
    rows, columns = (
        slice(max(round(at - reach_px), 0), max(min(round(at + reach_px) + 1, size), 0))
        for at, size in zip((v_px, u_px), shape, strict=True)
    )
    return rows, columns


def without_surroundings(pixels: Image, is_far: npt.NDArray[np.bool_]) -> Image | None:
    """Subtract the plane of the light around a spot; None if too few pixels show it.

    A plane of means: the median of whole counts would be off by up to half a count, at the same pixels in all
    exposures.
    """
    if np.count_nonzero(is_far) < _MIN_FAR_PIXELS:
        return None
    v, u = np.nonzero(is_far)
    plane = np.linalg.lstsq(np.column_stack([np.ones(len(u)), u, v]), pixels[is_far], rcond=None)[0]
    rows, columns = pixels.shape
    down, along = np.mgrid[:rows, :columns]
    return np.asarray(pixels - (plane[0] + plane[1] * along + plane[2] * down), np.float32)


def _latest_where_changed(sums: _Sums, assumed: Image) -> tuple[FloatArray, FloatArray]:
    """Return light and weight of all spots, of the later half alone where the response has changed."""
    light, weight = sums.light.sum(axis=0), sums.weight.sum(axis=0)
    before, after = (sums.light[half] / np.maximum(sums.weight[half], 1e-9) for half in range(2))
    both = assumed * sums.weight[0] * sums.weight[1] / np.maximum(weight, 1e-9)
    size = _SMOOTH_PX, _SMOOTH_PX
    mean = np.maximum(cv2.blur(both * light / np.maximum(weight, 1e-9), size), 1e-9)
    change = cv2.blur(both * (after - before), size) / mean
    is_known = cv2.blur(sums.weight.min(axis=0), size) > _MIN_BOTH
    has_changed = ((np.abs(change) > _MAX_CHANGE) & is_known).astype(np.uint8)
    has_changed = np.asarray(cv2.dilate(has_changed, np.ones((_AROUND_PX, _AROUND_PX), np.uint8))) > 0
    return np.where(has_changed, sums.light[1], light), np.where(has_changed, sums.weight[1], weight)


def _response(light: FloatArray, weight: FloatArray, assumed: Image) -> FloatArray:
    """Return the response (rows, columns): learnt; outside assumed times a quadratic, the lens' fall-off."""
    rows, columns = assumed.shape
    v, u = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v]).reshape(6, -1)
    weights = (weight * assumed**2).ravel()
    factors = np.linalg.solve((terms * weights) @ terms.T, terms @ (light * assumed).ravel())
    mean = float((light * assumed).sum() / weights.sum())
    even = np.clip((factors @ terms).reshape(assumed.shape), _FALL_OFF[0] * mean, _FALL_OFF[1] * mean)
    response: FloatArray = (light + _ASSUMED * even * assumed) / (weight + _ASSUMED)
    return response
