"""Calibrate a planar 3-PRP machine: its design as a TOML file, and the fit to measured poses that agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from altd.errors import BadInputError
from altd.files.table import Millimetres, Table
from altd.instruments.planar.machine.geometry_fit import PARAMETERS, FittedGeometry, fit_geometry
from altd.instruments.planar.machine.kinematics import PlanarMachine, gaps_mm
from altd.records import FloatArray

_MAX_GAP_RATIO = 20.0
"""Maximum gap between driven points and edges by the design, as a multiple of the poses' median."""
_MAX_MISFIT = 30.0
"""Maximum squared distance of a pose from the fit of the others; one of 700,000 good poses exceeds it."""
_MAX_CHI2_SIGMAS = 4.0
_MAX_LEVERAGE = 0.9
"""Maximum share of a pose in its own prediction; beyond it, less than a third of an error shows."""
_MAX_CHANGES = np.array([50.0, 50.0, 5.0, 0.005, 5.0, 50.0])
"""Maximum change of each of ``PARAMETERS`` from the design, and three times its maximum sigma."""

_Degrees = Annotated[float, Field(ge=-360, le=360)]


class LegTable(Table):
    """A rail, and the edge that its driven point guides; the keys are attributes of ``PlanarMachine``."""

    rail_start_mm: tuple[Millimetres, Millimetres]
    rail_deg: _Degrees
    joint_scale: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    edge_deg: _Degrees
    edge_offset_mm: Millimetres
    limits_mm: tuple[Millimetres, Millimetres]


class MachineFile(Table):
    """The file of a design or of a calibrated machine."""

    sigma_joint_mm: Annotated[float, Field(gt=0, le=10)]
    """Standard uncertainty of a joint's stated place, such as a step / √12."""
    legs: Annotated[tuple[LegTable, ...], Field(min_length=3, max_length=3)]

    @property
    def machine(self) -> PlanarMachine:
        """The geometry."""
        keys = LegTable.model_fields
        return PlanarMachine(**{key: np.array([getattr(leg, key) for leg in self.legs]) for key in keys})


def calibrate_machine(file: MachineFile, places: Sequence[str], measured: FloatArray) -> FittedGeometry:
    """Fit the machine to measured poses (N, 12): joints, pose, its sigmas and their random parts.

    ``places`` (N,) are the poses' rows. Raises BadInputError that names a row that contradicts the others or
    that no others check, or a parameter that is not determined or is far from the design.
    """
    design, (joints, poses, sigmas, randoms) = file.machine, np.split(measured, 4, axis=1)
    common = np.sqrt(np.median(sigmas**2 - randoms**2, axis=0))
    gaps = np.linalg.norm(gaps_mm(design, poses, joints), axis=1)
    if gaps.max() > _MAX_GAP_RATIO * np.median(gaps):  # the fit may not converge with it
        said = f"joints and pose contradict the design by {gaps.max():.3g} mm, most others by less than"
        raise BadInputError(places[int(gaps.argmax())], f"{said} {2.0 * np.median(gaps):.2g} mm")
    try:
        covariance = sigmas[:, :, None] ** 2 * np.eye(3)
        fit = fit_geometry(design, poses, joints, covariance, file.sigma_joint_mm, common)
    except ValueError as error:
        raise BadInputError(places[0], str(error)) from error
    if fit.leverages.max() > _MAX_LEVERAGE:
        said = "too few other poses check this one: record more, some of them like this"
        raise BadInputError(places[int(fit.leverages.argmax())], said)
    causes = "lost steps, exchanged joints, another machine, or too small a sigma_joint_mm"
    if (misfit := float(fit.misfits.max())) > _MAX_MISFIT:
        said = f"joints and pose are {np.sqrt(misfit):.1f} sigma from the fit of the other poses: {causes}"
        raise BadInputError(places[int(fit.misfits.argmax())], said)
    max_chi2 = fit.degrees_of_freedom + _MAX_CHI2_SIGMAS * np.sqrt(2.0 * fit.degrees_of_freedom)
    if fit.chi2 > max_chi2:
        said = f"this and later poses disagree, chi-square {fit.chi2:.0f} above {max_chi2:.0f}: {causes}"
        raise BadInputError(places[0], said)
    changes = np.abs(fit.machine.parameters - design.parameters)
    for values, said in (
        (3.0 * fit.sigmas, "is not determined: record more poses, in other orientations too"),
        (changes, "is far from the design: exchanged joints, another frame, or another machine"),
    ):
        for leg, column in np.argwhere(values > _MAX_CHANGES):
            raise BadInputError(places[0], f"{PARAMETERS[column]} of leg {leg + 1} {said}")
    return fit
