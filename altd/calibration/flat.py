"""A recording of the evenly lit targets becomes their flats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from altd.calibration.result import Progress
from altd.errors import BadInputError
from altd.recording import CameraHeader, Recording, RecordingHeader, Row
from altd.records import FloatArray, Frame, NoSpot
from altd.vision.flat import Flat
from altd.vision.localise import SATURATED_FROM
from altd.vision.patch import patch_around
from altd.vision.search import search
from altd.vision.settings import SpotSettings

_LEAST_LEVEL = 0.05
"""A black level and stray light make less."""
_LARGEST_CLIPPED_SHARE = 0.01
_HOT_ABOVE = 0.1
_DARK_BELOW = 0.5
_STEADY_SHARE = 0.1
_LEAST_CONTRAST = 0.02
_PIECES = 16, 10
_LEAST_EVENNESS = 0.2
"""The dimmer half of the picture gets at least this share of what its brightest part gets: the fall-off of
a lens leaves far more, a laser spot far less."""


@dataclass(slots=True)
class _Mean:
    """The mean of frames, and the pixels that were clipped in any of them."""

    total: FloatArray
    clipped: npt.NDArray[np.bool_]
    frames: int = field(default=0)

    @property
    def counts(self) -> FloatArray:
        """Grey values, (rows, columns)."""
        return self.total / self.frames


def flats_of(
    recording: Recording, scan: RecordingHeader, progress: Progress = lambda done, total: None
) -> dict[str, Flat]:
    """The flats of a scan's cameras from a recording of kind ``flat``; a camera without frames gets none.

    Rows whose ``leds`` are ``on`` show the targets in even light, those ``off`` in the dark, which is taken
    off. Where all rows are alike, their light decides: when it was switched off during the recording the dim
    ones are the dark, else all are lit. Hot and clipped pixels get 0: they do not count. Raises BadInputError
    when the recording is no flat, is of another unit or size than the scan, or is too dark, too bright or
    too uneven.
    """
    path = recording.path
    if recording.header.kind != "flat":
        raise BadInputError(path, f"is of kind {recording.header.kind!r}, not 'flat'")
    serials = recording.header.unit.serial, scan.unit.serial
    if serials[0] != serials[1]:
        raise BadInputError(path, f"is a flat of unit {serials[0]!r}, the scan is of unit {serials[1]!r}")
    flats = {}
    for camera, of_scan in scan.cameras.items():
        rows = [row for row in recording.rows if row.camera == camera]
        if not rows:
            continue
        header = recording.header.cameras[camera]
        if (header.width, header.height) != (of_scan.width, of_scan.height):
            raise BadInputError(
                path,
                f"{camera}: frames of {header.width} × {header.height}, "
                f"those of the scan are {of_scan.width} × {of_scan.height}",
            )
        if other := header.identity.difference_from(of_scan.identity):
            raise BadInputError(path, f"{camera}: the flat is of another camera than the scan: {other}")
        try:
            flats[camera] = _flat(recording, header, rows, progress)
        except ValueError as error:
            raise BadInputError(path, f"{camera}: {error}") from error
    if not flats:
        raise BadInputError(path, f"has no frame of the cameras {' and '.join(map(repr, scan.cameras))}")
    return flats


def _flat(recording: Recording, header: CameraHeader, rows: Sequence[Row], progress: Progress) -> Flat:
    """Raises ValueError when the pictures are no good."""
    full_scale = (1 << header.bits) - 1
    lit_rows, dark_rows = _lit_and_dark(recording, rows, progress)
    lit = _mean(recording, header, lit_rows, progress)
    usable = ~lit.clipped
    light = lit.counts
    if dark_rows:
        dark = _mean(recording, header, dark_rows, progress).counts
        usable &= dark < np.median(dark) + _HOT_ABOVE * full_scale
        light = light - dark
    clipped = float(np.mean(lit.clipped))
    if clipped > _LARGEST_CLIPPED_SHARE:
        raise ValueError(f"too bright to be a flat: {clipped:.0%} of the pixels are saturated")
    level = float(light[usable].mean())
    if level < _LEAST_LEVEL * full_scale:
        raise ValueError(f"too dark to be a flat: {level:.1f} counts of {full_scale} on average")
    evenness = _evenness(np.where(usable, light, 0.0))
    if evenness < _LEAST_EVENNESS:
        raise ValueError(
            f"too uneven to be a flat: half the picture gets {evenness:.0%} of the light or less"
        )
    return Flat.of(np.where(usable, light, 0.0), "recording", header.origin)


def _lit_and_dark(
    recording: Recording, rows: Sequence[Row], progress: Progress
) -> tuple[list[Row], list[Row]]:
    """By what the rows say, or by their light where they all say the same; rows in between are neither."""
    lit, dark = [row for row in rows if row.leds_on], [row for row in rows if not row.leds_on]
    if lit and dark:
        return lit, dark
    levels = []
    for row in rows:
        levels.append(float(recording.frame(row).pixels.mean()))
        progress(len(levels), len(rows))
    dimmest, brightest = min(levels), max(levels)
    if dimmest > _DARK_BELOW * brightest:
        return list(rows), []
    margin = _STEADY_SHARE * (brightest - dimmest)
    of_levels = list(zip(rows, levels, strict=True))
    return (
        [row for row, level in of_levels if level >= brightest - margin],
        [row for row, level in of_levels if level <= dimmest + margin],
    )


def _mean(recording: Recording, header: CameraHeader, rows: Sequence[Row], progress: Progress) -> _Mean:
    shape = header.height, header.width
    full_scale = (1 << header.bits) - 1
    mean = _Mean(np.zeros(shape), np.zeros(shape, bool))
    for row in rows:
        pixels = recording.frame(row).pixels
        mean.total += pixels
        mean.clipped |= pixels >= SATURATED_FROM * full_scale
        mean.frames += 1
        progress(mean.frames, len(rows))
    return mean


def _evenness(light: FloatArray) -> float:
    """The median over the brightest of the picture's pieces, in which dots are averaged away."""
    pieces = np.asarray(cv2.resize(light, _PIECES, interpolation=cv2.INTER_AREA))
    return float(np.median(pieces) / pieces.max())


def flat_likeness(frames: Iterable[Frame], flat: Flat) -> float:
    """Correlation of what the spots of frames show of their ground with what the flat says; 1 at best.

    Near 0 the flat is not of these pixels: camera, lens or target moved since, or it is of other ones. NaN
    where the flat is too even to tell.
    """
    settings = SpotSettings()
    seen, expected = [np.empty(0)], [np.empty(0)]
    for frame in frames:
        found = search(frame.pixels)
        patch = patch_around(frame, found.regions[0], found, settings) if found.regions else None
        if patch is None or isinstance(patch, NoSpot):
            continue
        height, width = patch.excess.shape
        response = flat.response[patch.top : patch.top + height, patch.left : patch.left + width]
        even = cv2.GaussianBlur(response, (0, 0), settings.smoothing_px)
        core = (patch.smooth > 0.5 * patch.peak) & (even > 0)
        for ratio, kept in (
            (patch.excess[core] / patch.smooth[core], seen),
            (response[core] / even[core], expected),
        ):
            kept.append(ratio - ratio.mean())
    a, b = np.concatenate(seen), np.concatenate(expected)
    if not len(b) or float(b.std()) < _LEAST_CONTRAST:
        return float("nan")
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))
