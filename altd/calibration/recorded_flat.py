"""Flats of targets, from a recording of the evenly lit targets or of the laser's spot moved over them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import compress

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.laser_flat import laser_flat
from altd.calibration.result import Progress
from altd.calibration.scan_nodes import Job, first_frames
from altd.calibration.target_frames import TargetFrames, lit_rows
from altd.errors import BadInputError
from altd.recording.reader import Recording
from altd.records import FloatArray, Frame, NoSpot
from altd.vision.flat import Flat
from altd.vision.frame_analysis import patch_around
from altd.vision.image import SATURATED_FROM, Image
from altd.vision.search import search
from altd.vision.settings import SpotSettings

_MIN_LEVEL = 0.05
"""Minimum mean light, as a share of full scale; a black level and stray light are below it."""
_MAX_CLIPPED_SHARE = 0.01
_MIN_HOT_SHARE = 0.1
_MAX_DARK_RATIO = 0.5
_MIN_CONTRAST = 0.02
_MIN_GROUND_SHARE = 0.5
"""Minimum share of a laser-made flat in the spots; speckle that moves with the beam does not affect it."""
_TILES = 16, 10
_MIN_UNIFORMITY = 0.2
"""Minimum ratio of the median light to that of the picture's brightest part: the fall-off of a lens leaves
far more, a laser spot far less."""


@dataclass(slots=True)
class _Mean:
    """Mean of frames, and the pixels clipped in any of them."""

    total: FloatArray
    clipped: npt.NDArray[np.bool_]
    frames: int = field(default=0)

    @property
    def counts(self) -> FloatArray:
        """Mean grey values, (rows, columns)."""
        return self.total / self.frames


def flats_of(
    recording: Recording, targets: Sequence[TargetFrames], progress: Progress = lambda done, total: None
) -> dict[str, Flat]:
    """Compute the flats of the targets of scans from a recording of kind ``flat``, by the targets' names.

    A target that is not in the recording, or has no frames there, gets no flat. Rows with ``leds`` ``on``
    show the targets in even light; the dark, rows with ``off``, is subtracted. If all rows are alike, their
    light decides: if it was switched off during the recording, the dim rows are dark; else all rows are lit.
    Rows with the stage's position show the laser's spot moved over the targets: ``laser_flat``. Hot and
    clipped pixels are 0: they do not count. Raises BadInputError when the recording is no flat, when its
    unit, camera or size differs from the scan's, and when it is too dark, too bright or too uneven. A flat
    made with the laser must also cover the scan and match the ground that the scan's spots show.
    """
    path = recording.path
    if recording.header.kind != "flat":
        raise BadInputError(path, f"is of kind {recording.header.kind!r}, not 'flat'")
    shown = {target.name: target.camera for target in recording.header.shown_targets}
    flats = {}
    for target in targets:
        name, camera = target.name, shown.get(target.name)
        serials = recording.header.unit.serial, target.unit_serial
        if serials[0] != serials[1]:
            raise BadInputError(path, f"is a flat of unit {serials[0]!r}, the scan is of unit {serials[1]!r}")
        if camera is None or not recording.rows.count.get(camera):
            continue
        header = recording.header.cameras[camera]
        if (header.width, header.height) != target.image_size:
            width, height = target.image_size
            raise BadInputError(
                path,
                f"{name}: frames of {header.width} × {header.height}, "
                f"those of the scan are {width} × {height}",
            )
        if other := header.identity.difference_from(target.camera):
            raise BadInputError(path, f"{name}: the flat is of another camera than the scan: {other}")
        try:
            if any(row.position_mm is not None for row in recording.rows.of(camera)):
                flats[name] = laser_flat(recording, camera, target, progress)
                _check_ground(target, flats[name])
            else:
                flats[name] = _flat(recording, camera, progress)
        except ValueError as error:
            raise BadInputError(path, f"{name}: {error}") from error
    if not flats:
        names = " and ".join(repr(target.name) for target in targets)
        raise BadInputError(path, f"has no frame of the targets {names}")
    return flats


def _check_ground(scan: TargetFrames, flat: Flat) -> None:
    """Raise ValueError if the spots of a scan do not show the ground of a flat made with the laser."""
    share = _ground(first_frames(Job(scan, SpotSettings(), None)), flat).share
    if share < _MIN_GROUND_SHARE:
        raise ValueError(
            f"the flat does not match the spots of the scan ({share:.2f} of it, 1 at best): "
            "was it recorded before camera, lens or window were moved?"
        )


def _flat(recording: Recording, camera: str, progress: Progress) -> Flat:
    """Compute a flat from evenly lit pictures; raises ValueError when they are unsuitable."""
    header = recording.header.cameras[camera]
    full_scale = (1 << header.bits) - 1
    rows = lit_rows(recording, camera, _MAX_DARK_RATIO, progress)
    lit = _mean(recording, camera, rows.lit, progress)
    usable = ~lit.clipped
    light = lit.counts
    if any(rows.dark):
        dark = _mean(recording, camera, rows.dark, progress).counts
        usable &= dark < np.median(dark) + _MIN_HOT_SHARE * full_scale
        light = light - dark
    clipped = float(np.mean(lit.clipped))
    if clipped > _MAX_CLIPPED_SHARE:
        raise ValueError(f"too bright to be a flat: {clipped:.0%} of the pixels are saturated")
    level = float(light[usable].mean())
    if level < _MIN_LEVEL * full_scale:
        raise ValueError(f"too dark to be a flat: {level:.1f} counts of {full_scale} on average")
    uniformity = _uniformity(np.where(usable, light, 0.0))
    if uniformity < _MIN_UNIFORMITY:
        raise ValueError(
            f"too uneven to be a flat: half the picture gets {uniformity:.0%} of the light or less"
        )
    return Flat.from_response(np.where(usable, light, 0.0), "recording", header.origin)


def _mean(recording: Recording, camera: str, taken: Sequence[bool], progress: Progress) -> _Mean:
    """Mean of the camera's rows that are ``taken``."""
    header = recording.header.cameras[camera]
    shape = header.height, header.width
    full_scale = (1 << header.bits) - 1
    mean = _Mean(np.zeros(shape), np.zeros(shape, bool))
    total = sum(taken)
    for row in compress(recording.rows.of(camera), taken):
        pixels = recording.frame(row).pixels
        mean.total += pixels
        mean.clipped |= pixels >= SATURATED_FROM * full_scale
        mean.frames += 1
        progress(mean.frames, total)
    return mean


def _uniformity(light: FloatArray) -> float:
    """Median over maximum light of the picture's tiles, which average out printed dots."""
    pieces = np.asarray(cv2.resize(light, _TILES, interpolation=cv2.INTER_AREA))
    return float(np.median(pieces) / pieces.max())


def flat_correlation(frames: Iterable[Frame], flat: Flat) -> float:
    """Correlation between the ground under the spots of frames and the flat; 1 at best.

    Near 0, the flat does not belong to these pixels: camera, lens or target moved since, or are others. NaN
    if the flat is too even to tell.
    """
    return _ground(frames, flat).value


def _ground(frames: Iterable[Frame], flat: Flat) -> _Correlation:
    settings = SpotSettings()
    ground = _Correlation()
    for frame in frames:
        found = search(frame.pixels)
        patch = patch_around(frame, found.regions[0], found, settings) if found.regions else None
        if patch is None or isinstance(patch, NoSpot):
            continue
        height, width = patch.excess.shape
        response = flat.response[patch.top : patch.top + height, patch.left : patch.left + width]
        even = cv2.GaussianBlur(response, (0, 0), settings.smoothing_px)
        core = (patch.smooth > 0.5 * patch.peak) & (even > 0)
        if core.any():
            ground.add(patch.excess[core] / patch.smooth[core], response[core] / even[core])
    return ground


@dataclass(slots=True)
class _Correlation:
    """Correlation of the ground seen under spots with the expected one, each spot's own mean subtracted."""

    pixels: int = 0
    seen: float = 0.0
    expected: float = 0.0
    both: float = 0.0

    def add(self, seen: Image, expected: Image) -> None:
        """Add the pixels (n,) of one spot."""
        a, b = (values.astype(np.float64) - values.mean() for values in (seen, expected))
        self.pixels += a.size
        self.seen += float(a @ a)
        self.expected += float(b @ b)
        self.both += float(a @ b)

    @property
    def value(self) -> float:
        """Correlation coefficient; NaN if no contrast is expected."""
        if self.expected < self.pixels * _MIN_CONTRAST**2 or not self.pixels:
            return float("nan")
        return self.both / math.sqrt(self.seen * self.expected)

    @property
    def share(self) -> float:
        """Share of the expected contrast that is seen: 1 at best, NaN if no contrast is expected."""
        return float("nan") if math.isnan(self.value) else self.both / self.expected
