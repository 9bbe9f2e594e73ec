"""Picture of a target in a camera: the nodes of a scan, and the dots of a regular print."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from altd.mapping.camera_model import CameraModel, jacobian_px_per_mm
from altd.records import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Places (n, 2) mm, their positions in the picture (n, 2) px, and each one's relative sigma (n,).

    The relative sigma is the factor by which one node scatters more than an ordinary one.
    """

    mm: FloatArray
    px: FloatArray
    relative_sigma: FloatArray

    @classmethod
    def ordinary(cls, mm: FloatArray, px: FloatArray) -> Nodes:
        """Return nodes that all scatter alike."""
        return cls(mm, px, np.ones(len(mm)))

    def __len__(self) -> int:
        return len(self.mm)

    def select(self, rows: npt.NDArray[np.intp]) -> Nodes:
        """Return only these nodes."""
        return Nodes(self.mm[rows], self.px[rows], self.relative_sigma[rows])

    def without(self, rows: npt.NDArray[np.intp]) -> Nodes:
        """Return all nodes except these."""
        return self.select(np.delete(np.arange(len(self)), rows))


_NEWTON_ITERATIONS = 3
_DIFFERENCE_MM = 0.05


@dataclass(frozen=True, eq=False)
class Fiducials:
    """Places seen at ``px`` (n, 2) whose coordinates on a regular print are ``regular_mm`` (n, 2).

    The regular coordinates are those of the plane except for an unknown affine map: the position of a print
    on its glass is arbitrary. ``sigma_mm`` is the standard deviation of each coordinate.
    """

    px: FloatArray
    regular_mm: FloatArray
    sigma_mm: float

    def deviations(self, camera: CameraModel) -> FloatArray:
        """Return the deviations (2 n,) from the best affine map, in units of sigma; x of all, then y."""
        deviations: FloatArray = self._without_affine(self._on_plane(camera)).T.ravel() / self.sigma_mm
        return deviations

    def slopes(self, camera: CameraModel) -> FloatArray:
        """Return the slopes (2 n, m) of the deviations by the camera's parameters."""
        mm = self._on_plane(camera)
        by_parameters = camera.jacobian(mm).reshape(len(mm), 2, -1)
        moves = -self._unprojected(camera, mm, by_parameters)
        slopes = self._without_affine(moves.reshape(len(mm), -1)).reshape(moves.shape)
        return slopes.transpose(1, 0, 2).reshape(2 * len(mm), -1) / self.sigma_mm

    def _on_plane(self, camera: CameraModel) -> FloatArray:
        """Return the places (n, 2) mm that the camera sees at ``px``."""
        mm = self.regular_mm
        for _ in range(_NEWTON_ITERATIONS):
            mm = mm + self._unprojected(camera, mm, (self.px - camera.to_px(mm))[:, :, None])[:, :, 0]
        return mm

    def _without_affine(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, k) without the part that is affine in the regular coordinates."""
        rest: FloatArray = columns - self._affine @ (self._affine.T @ columns)
        return rest

    @cached_property
    def _affine(self) -> FloatArray:
        """Orthonormal columns (n, 3) that span the affine maps."""
        return np.linalg.qr(np.column_stack([np.ones(len(self.px)), self.regular_mm]))[0]

    @staticmethod
    def _unprojected(camera: CameraModel, mm: FloatArray, px: FloatArray) -> FloatArray:
        """Return small changes (n, 2, k) px at points mm, as changes in mm."""
        return np.asarray(np.linalg.solve(jacobian_px_per_mm(camera.to_px, mm, _DIFFERENCE_MM), px))
