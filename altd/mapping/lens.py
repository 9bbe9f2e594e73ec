"""Lens model as a map: fitted to the nodes with weak priors and stored as a tensor polynomial.

A pinhole camera with Brown's distortion has 13 parameters for both coordinates, a plain tensor polynomial 32
or 40. The nodes' noise therefore leaves less error in it, as long as the model describes the lens.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from altd.mapping.camera_model import OPTICS, Bend, CameraModel, Optics
from altd.mapping.grid import Axis
from altd.mapping.nodes import Fiducials, Nodes
from altd.mapping.tensor_map import Fit, Model, TensorMap, tensor_basis
from altd.records import FloatArray

_INITIAL_NOISE_PX = 0.05
_MIN_NOISE_PX = 1e-6
_NOISE_ITERATIONS = 3
_MAX_ITERATIONS = 60
_CONVERGED = 1e-9

_BEND_DEGREES = (2, 3)
_MAX_FITTED_SHARE = 0.75
"""Maximum share of the nodes' coordinates that are fitted with a bend; otherwise none is tried."""

_DENSE_NODES = 12
_DENSE_DEGREES = range(4, 10)
_MAX_DENSE_ERROR_PX = 5e-4
"""Maximum deviation of a lens's tensor polynomial from it: a hundredth of the nodes' noise."""


def _residuals(nodes: Nodes, camera: CameraModel) -> FloatArray:
    """Return seen less projected (2 n,), px, u and v node by node, divided by the relative sigma."""
    residuals: FloatArray = (nodes.px - camera.to_px(nodes.mm)).ravel() / _relative_sigmas(nodes)
    return residuals


def _jacobian(nodes: Nodes, camera: CameraModel) -> FloatArray:
    """Return the camera's Jacobian (2 n, m), each row divided by its node's relative sigma."""
    return camera.jacobian(nodes.mm) / _relative_sigmas(nodes)[:, None]


def _relative_sigmas(nodes: Nodes) -> FloatArray:
    """Return the relative sigmas of all coordinates (2 n,)."""
    return np.repeat(nodes.relative_sigma, 2)


class _State(NamedTuple):
    """Best camera, and the nodes' information on it; residuals are divided by the nodes' relative sigma.

    ``leverage`` (n, 2, 2) holds each node's own block of the hat matrix: all of it would grow with the square
    of the nodes.
    """

    camera: CameraModel
    noise_px: float
    residuals_px: FloatArray
    covariance: FloatArray
    leverage: FloatArray

    @property
    def effective_parameters(self) -> float:
        """Number of the nodes' coordinates that the parameters use up."""
        return float(np.trace(self.leverage, axis1=1, axis2=2).sum())


def fit_lens_map(
    nodes: Nodes,
    hull_mm: FloatArray,
    image_size: tuple[int, int],
    optics: Optics = "brown",
    bend_degree: int = 0,
    fiducials: Fiducials | None = None,
) -> Fit:
    """Fit a lens to nodes by Levenberg and Marquardt's least squares, with weak priors.

    ``bend_degree`` > 1 adds a tensor polynomial of that degree for the residuals of the lens model;
    ``fiducials`` of a print also show how the plane is bent between the nodes. The map is stored as a tensor
    polynomial through the camera on a dense grid, with the error that the nodes' noise leaves in it. Raises
    ValueError if the nodes are too few or on a line.
    """
    state = _fit_with_noise(_initial_camera(nodes.mm, nodes.px, image_size, optics), nodes, fiducials)
    if bend_degree > 1:
        state = _fit_with_noise(_bent(state.camera, nodes.mm, bend_degree), nodes, fiducials)
    return _as_fit(state, nodes, hull_mm)


def fit_camera(nodes: Nodes, image_size: tuple[int, int]) -> CameraModel:
    """Fit a camera with Brown's distortion to nodes; raises ValueError as ``fit_lens_map``."""
    return _fit_with_noise(_initial_camera(nodes.mm, nodes.px, image_size, "brown"), nodes, None).camera


def fit_lens_maps(
    nodes: Nodes, hull_mm: FloatArray, image_size: tuple[int, int], fiducials: Fiducials | None = None
) -> list[Fit]:
    """Return the fits of both optics, each plain and, with enough nodes, with a bend of degree 2 and 3.

    A model that fails is skipped; raises ValueError if all of them fail.
    """
    fits, complaint = [], ValueError()
    for optics in OPTICS:
        try:
            initial = _initial_camera(nodes.mm, nodes.px, image_size, optics)
            state = _fit_with_noise(initial, nodes, fiducials)
            fits.append(_as_fit(state, nodes, hull_mm))
            for degree in _BEND_DEGREES:
                bent = _bent(state.camera, nodes.mm, degree)
                if len(bent.parameters) <= _MAX_FITTED_SHARE * 2 * len(nodes):
                    fits.append(_as_fit(_fit_with_noise(bent, nodes, fiducials), nodes, hull_mm))
        except ValueError as error:
            complaint = error
    if not fits:
        raise complaint
    return fits


def _bent(camera: CameraModel, nodes_mm: FloatArray, degree: int) -> CameraModel:
    return camera.with_bend(Bend(Axis.through(nodes_mm[:, 0]), Axis.through(nodes_mm[:, 1]), degree))


def _as_fit(state: _State, nodes: Nodes, hull_mm: FloatArray) -> Fit:
    camera, bend = state.camera, state.camera.bend
    model: Model = "lens" if camera.optics == "brown" else "fisheye"
    if bend is not None:
        model = "lens+tensor" if camera.optics == "brown" else "fisheye+tensor"
    factor = np.asarray(np.linalg.cholesky(state.covariance), dtype=np.float64)
    leave_one_out, standardised = _leave_one_out_and_standardised(state.residuals_px, state.leverage)
    return Fit(
        map=_as_tensor(camera, model, nodes.mm, factor, state.noise_px, hull_mm),
        residuals_px=state.residuals_px * nodes.relative_sigma[:, None],
        leave_one_out_residuals_px=leave_one_out * nodes.relative_sigma[:, None],
        standardised_px=standardised,
        relative_sigma=nodes.relative_sigma,
        degree=None if bend is None else (bend.degree, bend.degree),
        parameters=len(camera.parameters),
        effective_parameters=state.effective_parameters,
    )


def _fit_with_noise(camera: CameraModel, nodes: Nodes, fiducials: Fiducials | None) -> _State:
    """Fit, estimate the noise, which determines the weight of the priors, and fit again."""
    noise_px, precision = _INITIAL_NOISE_PX, np.diag(1 / camera.prior**2)
    for _ in range(_NOISE_ITERATIONS):
        camera = _least_squares(camera, precision, nodes, noise_px, fiducials)
        known = precision
        if fiducials is not None:
            of_fiducials = fiducials.slopes(camera)
            known = precision + of_fiducials.T @ of_fiducials
        residuals = _residuals(nodes, camera)
        jacobian = _jacobian(nodes, camera)
        normal = jacobian.T @ jacobian
        gain = jacobian @ np.linalg.inv(normal + known * noise_px**2)
        degrees_of_freedom = len(residuals) - float(np.einsum("ij,ij->", gain, jacobian))
        noise_px = max(math.sqrt(float(np.square(residuals).sum()) / degrees_of_freedom), _MIN_NOISE_PX)
    covariance = np.linalg.inv(normal / noise_px**2 + known)
    by_node = len(residuals) // 2, 2, -1
    leverage = np.einsum("nim,njm->nij", gain.reshape(by_node), jacobian.reshape(by_node))
    return _State(
        camera, noise_px, residuals.reshape(-1, 2), np.asarray(covariance, dtype=np.float64), leverage
    )


def _initial_camera(
    nodes_mm: FloatArray, nodes_px: FloatArray, image_size: tuple[int, int], optics: Optics
) -> CameraModel:
    """Return a camera square to the plane: scale, turn and side from an affine fit."""
    width, height = image_size
    design = np.column_stack([nodes_mm, np.ones(len(nodes_mm))])
    (a, b, origin) = np.linalg.lstsq(design, nodes_px, rcond=None)[0]
    determinant = float(a[0] * b[1] - a[1] * b[0])
    if abs(determinant) < 1e-6:
        raise ValueError("the nodes lie on a line")
    mirrored = determinant > 0  # v runs down and y up
    scale = math.sqrt(abs(determinant))
    side = -1.0 if mirrored else 1.0
    parameters = np.zeros(CameraModel.optical_parameters(optics))
    if len(nodes_mm) < len(parameters):
        raise ValueError(f"{len(nodes_mm)} nodes are too few for a lens model")
    parameters[2] = math.atan2(side * a[1], side * a[0])
    parameters[3] = (origin[0] - (width - 1) / 2) / scale
    parameters[4] = (origin[1] - (height - 1) / 2) / scale
    parameters[5] = math.log(scale)
    return CameraModel(optics, parameters, mirrored, width, height)


def _least_squares(
    camera: CameraModel, precision: FloatArray, nodes: Nodes, noise_px: float, fiducials: Fiducials | None
) -> CameraModel:
    """Take Levenberg and Marquardt's steps from a camera to the one of minimum cost."""

    def residuals_and_cost(candidate: CameraModel) -> tuple[tuple[FloatArray, FloatArray], float]:
        residuals = _residuals(nodes, candidate) / noise_px
        misfit = np.zeros(0) if fiducials is None else fiducials.deviations(candidate)
        prior = candidate.parameters @ precision @ candidate.parameters
        total = float(np.square(residuals).sum() + prior) + float(np.square(misfit).sum())
        return (residuals, misfit), total if math.isfinite(total) else math.inf

    def normal_equations(residuals: FloatArray, misfit: FloatArray) -> tuple[FloatArray, FloatArray]:
        jacobian = _jacobian(nodes, camera) / noise_px
        normal = jacobian.T @ jacobian + precision
        gradient = jacobian.T @ residuals - precision @ camera.parameters
        if fiducials is not None:
            of_fiducials = fiducials.slopes(camera)
            normal += of_fiducials.T @ of_fiducials
            gradient -= of_fiducials.T @ misfit
        return normal, gradient

    residuals, now = residuals_and_cost(camera)
    normal, gradient = normal_equations(*residuals)
    damping = 1e-3
    for _ in range(_MAX_ITERATIONS):
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
        candidate = replace(camera, parameters=camera.parameters + step)
        residuals, then = residuals_and_cost(candidate)
        if then < now:
            converged = now - then < _CONVERGED * now
            camera, now, damping = candidate, then, damping / 10
            if converged:
                break
            normal, gradient = normal_equations(*residuals)
        else:
            damping *= 10
            if damping > 1e12:
                break
    return camera


def _as_tensor(
    camera: CameraModel,
    model: Model,
    nodes_mm: FloatArray,
    parameter_factor: FloatArray,
    noise_px: float,
    hull_mm: FloatArray,
) -> TensorMap:
    """Return the camera and its uncertainty on Gram polynomials over the nodes' rectangle.

    The degree is the lowest that deviates from the camera by at most a hundredth of usual noise.
    """
    axes = []
    for column in (0, 1):
        low, high = float(nodes_mm[:, column].min()), float(nodes_mm[:, column].max())
        axes.append(Axis(low, (high - low) / (_DENSE_NODES - 1), _DENSE_NODES))
    x_mm, y_mm = (np.linspace(axis.first_mm, axis.last_mm, axis.nodes) for axis in axes)
    dense_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    dense_px = camera.to_px(dense_mm)
    for degree in _DENSE_DEGREES:
        basis = tensor_basis((axes[0], axes[1]), (degree, degree), dense_mm)
        spectra = basis.T @ dense_px  # unitary on the dense grid: its own pseudo-inverse
        if np.abs(basis @ spectra - dense_px).max() < _MAX_DENSE_ERROR_PX:
            break
    changes = (camera.jacobian(dense_mm) @ parameter_factor).reshape(len(dense_mm), 2, -1)
    return TensorMap(
        model=model,
        x_axis=axes[0],
        y_axis=axes[1],
        spectra=spectra.T.reshape(2, degree + 1, degree + 1),
        covariance_factor_px=np.stack([basis.T @ changes[:, 0], basis.T @ changes[:, 1]]),
        noise_px=noise_px,
        hull_mm=hull_mm,
    )


def _leave_one_out_and_standardised(
    residuals: FloatArray, leverage: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the leave-one-out residuals, and the residuals at equal variance.

    With the node's own block H of the leverage (n, 2, 2) these are (1 − H)⁻¹ r and (1 − H)^(−1/2) r.
    """
    left, axes = np.linalg.eigh(np.eye(2) - leverage)
    left = np.maximum(left, 1e-9)
    along = np.einsum("nij,ni->nj", axes, residuals)
    leave_one_out: FloatArray = np.einsum("nij,nj->ni", axes, along / left)
    standardised: FloatArray = np.einsum("nij,nj->ni", axes, along / np.sqrt(left))
    return leave_one_out, standardised
