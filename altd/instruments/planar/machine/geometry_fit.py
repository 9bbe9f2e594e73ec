"""Fit of the planar 3-PRP machine's geometry to measured poses and joints (Eq. 2.60–2.63)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from altd.instruments.planar.machine.kinematics import PlanarMachine, constraint_jacobian, gaps_mm
from altd.records import FloatArray

PARAMETERS = ("rail_start_x_mm", "rail_start_y_mm", "rail_deg", "joint_scale", "edge_deg", "edge_offset_mm")
"""Parameters of each leg, in the order of the rows of ``FittedGeometry.covariance``: those of leg 0 first."""
_MAX_ITERATIONS = 30
_NOT_CONVERGED = "the fit does not converge: joints, poses and design do not belong together"
_MAX_CONDITION = 1e7
"""Maximum condition of the scaled design; beyond it, parameters are uncertain by kilometres."""


class NotIdentifiableError(ValueError):
    """The poses do not determine the geometry; the message names the parameters that may change together."""


@dataclass(frozen=True, slots=True)
class FittedGeometry:
    """A machine with the covariance (18, 18) of its parameters, in the units of ``PARAMETERS``.

    ``condition`` is that of the design, each parameter scaled by its effect. ``misfits`` (N,) are the squared
    distances of the poses from the fit of the others, in sigmas: chi-square of three degrees of freedom.
    ``leverages`` (N,) are the largest shares of a pose in its own prediction; from 1 on, no other checks it.
    """

    machine: PlanarMachine
    covariance: FloatArray
    condition: float
    chi2: float
    degrees_of_freedom: int
    misfits: FloatArray
    leverages: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainties (3, 6) of ``PlanarMachine.parameters``."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(3, -1))


def fit_geometry(
    machine: PlanarMachine,
    poses: ArrayLike,
    joints_mm: ArrayLike,
    pose_covariance: ArrayLike,
    sigma_joint_mm: float,
    common_sigmas: ArrayLike = (0.0, 0.0, 0.0),
) -> FittedGeometry:
    """Fit all eighteen parameters to N poses (N, 3) and the joints (N, 3) at which they were measured.

    ``machine`` is the design geometry, used as initial estimate; ``pose_covariance`` (3, 3) or (N, 3, 3) is
    in mm² and °²; ``common_sigmas`` (3,), in mm and °, are those of errors that all poses share. The implicit
    model n·P(q) − n·(a, b) − offset = 0 (Eq. 2.62) is weighted by the propagated uncertainty of pose and
    joints, which equals Eq. 2.61 to first order and stays finite at singular poses.
    Raises NotIdentifiableError if the poses do not determine the geometry or the iteration does not converge.
    """
    pose, joints = np.asarray(poses, float), np.asarray(joints_mm, float)
    per_pose = np.array([1.0, 1.0, np.pi / 180.0])
    covariance = np.asarray(pose_covariance, float) * np.outer(per_pose, per_pose)
    for iteration in range(_MAX_ITERATIONS):
        residual, design = _linearised(machine, pose, joints)
        moved = constraint_jacobian(machine, pose, joints)
        slack = moved @ covariance @ np.swapaxes(moved, 1, 2)
        travel = machine.crossing_sines(pose[:, 2]) * machine.joint_scale * sigma_joint_mm
        slack[:, range(3), range(3)] += travel**2
        whitener = np.linalg.inv(np.linalg.cholesky(slack))
        white = np.einsum("nij,njk->nik", whitener, design).reshape(-1, design.shape[-1])
        errors = np.einsum("nij,nj->ni", whitener, residual).ravel()
        scale = np.linalg.norm(white, axis=0)
        left, singular, right = np.linalg.svd(white / scale, full_matrices=False)
        condition = float(singular[0] / max(singular[-1], np.finfo(float).tiny))
        if len(errors) < len(scale) or condition > _MAX_CONDITION:
            if iteration > 0:
                raise NotIdentifiableError(_NOT_CONVERGED)
            raise NotIdentifiableError(f"the poses do not determine {_names(right[-1])}")
        step = -(right.T @ ((left.T @ errors) / singular)) / scale
        machine = _changed(machine, step)
        if np.max(np.abs(step * scale)) < 1e-6:
            break
    else:
        raise NotIdentifiableError(_NOT_CONVERGED)
    inverse = (right.T / singular**2) @ right / np.outer(scale, scale)
    common = inverse @ white.T @ (whitener @ moved * per_pose).reshape(-1, 3) * common_sigmas
    of_pose = left.reshape(len(pose), 3, -1)
    shares = of_pose @ np.swapaxes(of_pose, 1, 2)
    checks = np.linalg.pinv(np.eye(3) - shares, hermitian=True)
    off = errors.reshape(-1, 3)
    return FittedGeometry(
        machine,
        inverse + common @ common.T,
        condition,
        float(errors @ errors),
        len(errors) - len(scale),
        np.einsum("ni,nij,nj->n", off, checks, off),
        np.linalg.eigvalsh(shares)[:, -1],
    )


def _linearised(
    machine: PlanarMachine, poses: FloatArray, joints_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (N, 3) in mm, and their derivatives (N, 3, 18) by the parameters."""
    edge, rail = np.radians(machine.edge_deg + poses[:, 2, None]), np.radians(machine.rail_deg)
    normal = np.stack([-np.sin(edge), np.cos(edge)], axis=-1)
    along = np.stack([np.cos(edge), np.sin(edge)], axis=-1)
    direction = np.stack([np.cos(rail), np.sin(rail)], axis=-1)
    turned = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    lever = machine.rail_points_mm(joints_mm) - poses[:, None, :2]
    residual = gaps_mm(machine, poses, joints_mm)
    of_leg = np.stack(
        [
            normal[..., 0],
            normal[..., 1],
            np.radians(1.0) * joints_mm * machine.joint_scale * np.einsum("nij,ij->ni", normal, turned),
            joints_mm * np.einsum("nij,ij->ni", normal, direction),
            -np.radians(1.0) * np.einsum("nij,nij->ni", along, lever),
            -np.ones_like(residual),
        ],
        axis=-1,
    )
    design = np.zeros((len(poses), 3, 3, len(PARAMETERS)))
    design[:, range(3), range(3)] = of_leg
    return residual, design.reshape(len(poses), 3, -1)


def _changed(machine: PlanarMachine, step: FloatArray) -> PlanarMachine:
    x, y, rail, scale, edge, offset = step.reshape(3, len(PARAMETERS)).T
    return replace(
        machine,
        rail_start_mm=machine.rail_start_mm + np.stack([x, y], axis=1),
        rail_deg=machine.rail_deg + rail,
        joint_scale=machine.joint_scale + scale,
        edge_deg=machine.edge_deg + edge,
        edge_offset_mm=machine.edge_offset_mm + offset,
    )


def _names(direction: FloatArray) -> str:
    """Names of the parameters with a large part in a direction (18,) of the scaled design."""
    large = np.flatnonzero(np.abs(direction) > 0.3 * np.max(np.abs(direction)))
    return ", ".join(f"{PARAMETERS[k % len(PARAMETERS)]} of leg {k // len(PARAMETERS) + 1}" for k in large)
