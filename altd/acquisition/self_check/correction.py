"""Correction of a drift in the running chain: moves the flats and fingerprints of its locators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from altd.acquisition.self_check.geometry_state import GeometryState
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.spot_locator import Appearance, SpotLocator
from altd.records import FloatArray
from altd.selfcheck.records import Similarity
from altd.selfcheck.verdict import flat_now
from altd.vision.flat import Flat

_MIN_CHANGE_PX = 0.1
"""Minimum shift for moving a flat: a smaller one does no harm, and moving costs a window of exposures."""


class Correction:
    """Keeps the locators as the last check found the targets. ``targets`` names the target of each camera."""

    def __init__(
        self, locators: Mapping[str, SpotLocator], calibration: Calibration, targets: Mapping[str, str]
    ) -> None:
        self._locators = locators
        self._known = {target.name: target for target in calibration.targets}
        self._targets = targets
        self._flats: dict[str, tuple[Similarity, Flat]] = {}
        """The last transform and the flat moved by it, by camera."""

    def prepare(self, transforms: Mapping[str, Similarity]) -> None:
        """Move the flats that ``apply`` will need; takes half a second for 12 Mpx."""
        for camera, name in self._targets.items():
            if name in transforms:
                self._flat_now(camera, self._known[name], transforms[name])

    def apply(self, geometry: GeometryState) -> None:
        """Move the targets' appearance to a state of the geometry from now on."""
        for camera, name in self._targets.items():
            seen = self._seen(camera, self._known[name], geometry.transforms.get(name))
            self._locators[camera].appearance = seen

    def _seen(self, camera: str, target: TargetCalibration, transform: Similarity | None) -> Appearance:
        """Return the appearance of a target moved by the transform; without one, as it was calibrated."""
        if transform is None:
            self._flats.pop(camera, None)
            return Appearance(target.flat, target.fingerprint)
        fingerprint = target.fingerprint
        if fingerprint is not None:
            fingerprint = replace(fingerprint, moved=transform.affine)
        return Appearance(self._flat_now(camera, target, transform), fingerprint)

    def _flat_now(self, camera: str, target: TargetCalibration, transform: Similarity) -> Flat | None:
        """Return the last moved flat while it fits, or move the flat: a new flat begins a new window."""
        if target.flat is None:
            return None
        corners = np.array([(u, v) for u in (0, target.width) for v in (0, target.height)], dtype=np.float64)
        last = self._flats.get(camera)
        if last is None or _distance_px(last[0], transform, corners) > _MIN_CHANGE_PX:
            last = self._flats[camera] = transform, flat_now(target.flat, transform)
        return last[1]


def _distance_px(one: Similarity, other: Similarity, places_px: FloatArray) -> float:
    """Return the largest distance between the images of the places under two transforms, px."""
    return float(np.linalg.norm(one.now_px(places_px) - other.now_px(places_px), axis=1).max())
