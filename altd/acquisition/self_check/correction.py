"""A drift taken out of the running chain: mean spots are corrected, flats and fingerprints moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from altd.acquisition.self_check.geometry_state import GeometryState
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.chain import MeasuringChain
from altd.measuring.spot_locator import Appearance
from altd.records import FloatArray
from altd.selfcheck.records import Similarity
from altd.selfcheck.verdict import flat_now
from altd.vision.flat import Flat

_MIN_CHANGE_PX = 0.1
"""A flat that is off by less removes the print as well; to move it takes a window of exposures."""


class Correction:
    """Keeps a chain corrected as the last check asks for. ``targets`` names the target of each camera."""

    def __init__(self, chain: MeasuringChain, calibration: Calibration, targets: Mapping[str, str]) -> None:
        self._chain = chain
        self._known = {target.name: target for target in calibration.targets}
        self._targets = targets
        self._flats: dict[str, tuple[Similarity, Flat]] = {}
        """By camera, a flat that was moved, and with what transform."""

    def prepare(self, transforms: Mapping[str, Similarity]) -> None:
        """Move the flats already that ``apply`` will want; takes half a second for 12 Mpx."""
        for camera, name in self._targets.items():
            if name in transforms:
                self._flat_now(camera, self._known[name], transforms[name])

    def apply(self, geometry: GeometryState) -> None:
        """Correct from now on for a state of the geometry."""
        self._chain.correct = geometry.correct
        for camera, name in self._targets.items():
            seen = self._seen(camera, self._known[name], geometry.transforms.get(name))
            self._chain.locators[camera].appearance = seen

    def _seen(self, camera: str, target: TargetCalibration, transform: Similarity | None) -> Appearance:
        """The look of a target where the transform puts it; without one, as it was calibrated."""
        if transform is None:
            self._flats.pop(camera, None)
            return Appearance(target.flat, target.fingerprint)
        fingerprint = target.fingerprint
        if fingerprint is not None:
            fingerprint = replace(fingerprint, moved=transform.affine)
        return Appearance(self._flat_now(camera, target, transform), fingerprint)

    def _flat_now(self, camera: str, target: TargetCalibration, transform: Similarity) -> Flat | None:
        """The flat that was moved last while it fits: another one begins a new window."""
        if target.flat is None:
            return None
        corners = np.array([(u, v) for u in (0, target.width) for v in (0, target.height)], dtype=np.float64)
        last = self._flats.get(camera)
        if last is None or _distance_px(last[0], transform, corners) > _MIN_CHANGE_PX:
            last = self._flats[camera] = transform, flat_now(target.flat, transform)
        return last[1]


def _distance_px(one: Similarity, other: Similarity, places_px: FloatArray) -> float:
    """The largest distance between two transforms over the places."""
    return float(np.linalg.norm(one.now_px(places_px) - other.now_px(places_px), axis=1).max())
