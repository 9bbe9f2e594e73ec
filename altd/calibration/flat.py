"""A recording of the evenly lit targets becomes their flats."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from altd.calibration.result import Progress
from altd.errors import BadInputError
from altd.recording import Recording
from altd.records import FloatArray
from altd.vision.flat import Flat
from altd.vision.localise import SATURATED_FROM

_LEAST_LEVEL = 0.02
_LARGEST_CLIPPED_SHARE = 0.01
_HOT_ABOVE = 0.1


def flats_of(recording: Recording, progress: Progress = lambda done, total: None) -> dict[str, Flat]:
    """The flat of every camera of a recording of kind ``flat``.

    Rows whose ``leds`` are ``on`` show the targets in even light, those ``off`` in the dark, which is taken
    off. Where all rows are alike they are taken as lit, and nothing is taken off. Hot and clipped pixels get
    0: they do not count. Raises BadInputError when it is no flat, or too dark or too bright to be one.
    """
    if recording.header.kind != "flat":
        raise BadInputError(recording.path, f"is of kind {recording.header.kind!r}, not 'flat'")
    flats = {}
    total = len(recording.rows)
    done = 0
    for camera, header in recording.header.cameras.items():
        full_scale = (1 << header.bits) - 1
        sums = {state: np.zeros((header.height, header.width)) for state in (False, True)}
        counts = {False: 0, True: 0}
        clipped = np.zeros((header.height, header.width), bool)
        for row in (row for row in recording.rows if row.camera == camera):
            frame = recording.frame(row)
            sums[row.leds_on] += frame.pixels
            counts[row.leds_on] += 1
            clipped |= frame.pixels >= SATURATED_FROM * full_scale
            done += 1
            progress(done, total)
        if not any(counts.values()):
            raise BadInputError(recording.path, f"has no frame of camera {camera!r}")
        means = {state: sums[state] / counts[state] for state in sums if counts[state]}
        dark = means[False] if len(means) == 2 else None
        lit = means[True] if True in means else means[False]
        flats[camera] = _flat(recording, camera, lit, dark, clipped, full_scale)
    return flats


def _flat(
    recording: Recording,
    camera: str,
    lit: FloatArray,
    dark: FloatArray | None,
    clipped: npt.NDArray[np.bool_],
    full_scale: int,
) -> Flat:
    usable = ~clipped
    if dark is not None:
        usable &= dark < np.median(dark) + _HOT_ABOVE * full_scale
        lit = lit - dark
    if np.mean(clipped) > _LARGEST_CLIPPED_SHARE:
        raise BadInputError(recording.path, f"{camera}: {np.mean(clipped):.0%} of the pixels are saturated")
    if lit[usable].mean() < _LEAST_LEVEL * full_scale:
        raise BadInputError(
            recording.path,
            f"{camera}: too dark to be a flat: {lit[usable].mean():.1f} counts of {full_scale} on average",
        )
    return Flat.of(np.where(usable, lit, 0.0), "recording")
