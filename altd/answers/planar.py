"""``altd planar``: a machine's geometry from recorded poses, its workspace and its singular poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from altd.app.planar_replay import planar_replay_of
from altd.calibration.planar_machine import LegTable, MachineFile, calibrate_machine
from altd.config.loading import load_tables
from altd.errors import BadInputError
from altd.instruments.planar.instrument import QUANTITIES
from altd.instruments.planar.machine.kinematics import PlanarMachine, poses_of
from altd.instruments.planar.machine.singularities import parallel_orientations_deg
from altd.instruments.planar.machine.workspace import area_mm2, slice_mm, type_2_range_mm
from altd.reasons import Reason
from altd.recording.frames_table import JOINT_COLUMNS
from altd.recording.header import HEADER_FILE
from altd.recording.reader import Recording, open_recording
from altd.records import FloatArray, Measurement

_MAX_FRAMES = 1000
"""Maximum number of frames of one pose that are averaged."""
_STEP_DEG, _SLICES_DEG = 0.25, 10.0
Progress = Callable[[int, int], None]


def planar(
    paths: Sequence[Path], calibration: Path, design: Path, warn: Callable[[str], object], progress: Progress
) -> Iterator[str]:
    """Yield the calibrated machine as lines of TOML: a ``MachineFile``, and the rest in comments.

    ``warn`` receives poses that are left out. Raises BadInputError for files that cannot be used, and for
    poses that contradict each other or do not determine the machine.
    """
    file, places, is_simulated = load_tables(design, MachineFile), dict[tuple[float, ...], str](), False
    for path in paths:
        for place, joints_mm, measurement in _stays(open_recording(path), calibration, progress):
            reasons = [fault.reason for fault in measurement.status]
            if not measurement.valid:
                warn(f"{place}: left out: {', '.join(reasons)}")
                continue
            is_simulated |= Reason.SIMULATED in reasons
            values = [measurement.values[quantity.key] for quantity in QUANTITIES.of_unit]
            sigmas = [of.sigma or 0.0 for of in values] + [of.sigma_random or 0.0 for of in values]
            row = *joints_mm, *(of.value for of in values), *sigmas
            if row in places:
                raise BadInputError(place, f"is the same as {places[row]}")
            places[row] = place
    if not places:
        raise BadInputError(paths[0], f"no row with {', '.join(JOINT_COLUMNS)} could be measured")
    measured = np.array(list(places))
    fit = calibrate_machine(file, list(places.values()), measured)
    yield f"# altd planar{', SIMULATED' * is_simulated}: {len(measured)} poses"
    yield f"# chi-square {fit.chi2:.1f} of {fit.degrees_of_freedom} degrees of freedom"
    for of, machine in (("the design", file.machine), ("this file", fit.machine)):
        yield f"# computed by {of} minus measured, rms: {_rms(machine, measured)}"
    yield "# sigma and change are of rail_start_mm (x, y), rail_deg, joint_scale, edge_deg, edge_offset_mm"
    yield f"sigma_joint_mm = {file.sigma_joint_mm}"
    changes = fit.machine.parameters - file.machine.parameters
    for leg in range(3):
        yield from ("", "[[legs]]")
        yield from (
            f"{key} = {np.round(getattr(fit.machine, key)[leg], 7).tolist()}" for key in LegTable.model_fields
        )
        yield f"# sigma   {', '.join(f'{sigma:.2g}' for sigma in fit.sigmas[leg])}"
        yield f"# change  {', '.join(f'{change:.2g}' for change in changes[leg])}"
    yield from ("", *_workspace(fit.machine))


def _stays(
    recording: Recording, calibration: Path, progress: Progress
) -> Iterator[tuple[str, tuple[float, ...], Measurement]]:
    """Yield row, joints and the mean of all frames of each pose whose joints are stated."""
    if recording.header.kind != "planar":
        raise BadInputError(recording.path / HEADER_FILE, 'kind is not "planar"')
    replay = planar_replay_of(recording, calibration, _MAX_FRAMES, 1)
    rows = {row.sequence: row for row in recording.rows}
    for joints_mm, group in groupby(replay.measurements(progress), lambda of: rows[of.sequence].joints_mm):
        stay = list(group)
        if joints_mm is not None:
            yield recording.rows.place(rows[stay[0].sequence]), joints_mm, stay[-1]


def _rms(machine: PlanarMachine, measured: FloatArray) -> str:
    """Rms of computed minus measured poses in the nearer assembly mode, of those that it can reach."""
    off = poses_of(machine, measured[:, :3]) - measured[:, None, 3:6]
    off[..., 2] = (off[..., 2] + 180.0) % 360.0 - 180.0
    off = off[range(len(off)), np.nan_to_num(np.abs(off[..., 2]), nan=np.inf).argmin(axis=1)]
    rms = np.sqrt(np.mean(off[np.isfinite(off).all(axis=1)] ** 2, axis=0))
    return "a {:.4f} mm, b {:.4f} mm, phi {:.4f} deg".format(*rms)


def _workspace(machine: PlanarMachine) -> Iterator[str]:
    """Yield the orientations of the workspace, its area at some of them, and its singular poses."""
    phi_deg = np.arange(_STEP_DEG - 180.0, 180.0 + _STEP_DEG / 2, _STEP_DEG)
    low_mm, high_mm = np.array([type_2_range_mm(machine, phi) for phi in phi_deg.tolist()]).T
    is_inside, to_type_2_mm = np.isfinite(low_mm), np.maximum(0.0, np.maximum(low_mm, -high_mm))
    pieces, parallel = is_inside.copy(), list[str]()
    for leg, turn_deg in enumerate(parallel_orientations_deg(machine).tolist(), start=1):
        for phi in (turn_deg, turn_deg + 180.0 if turn_deg <= 0.0 else turn_deg - 180.0):
            pieces &= np.abs(phi_deg - phi) > _STEP_DEG / 2
            if is_inside[np.abs(phi_deg - phi) <= _STEP_DEG].any():
                parallel.append(f"{phi:.4f} (leg {leg})")
    yield f"# workspace: phi {_ranges(phi_deg, pieces)} deg"
    for phi, mm in zip(phi_deg[is_inside].tolist(), to_type_2_mm[is_inside].tolist(), strict=True):
        if phi % _SLICES_DEG == 0.0:
            area = area_mm2(slice_mm(machine, phi))
            yield f"#   phi {phi:.0f} deg: {area:.0f} mm2, {mm:.1f} mm from singular poses of type 2"
    yield f"# singular, type 1, a rail parallel to its edge: phi {', '.join(parallel) or 'none'} deg"
    type_2 = _ranges(phi_deg, (low_mm < 0.0) & (high_mm > 0.0))
    yield f"# singular, type 2, normals that meet in a point: some poses at phi {type_2} deg"


def _ranges(phi_deg: FloatArray, mask: npt.NDArray[np.bool_]) -> str:
    ends = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return ", ".join(f"{phi_deg[first]:g} to {phi_deg[last - 1]:g}" for first, last in ends) or "none"
