"""Measurements of a beam, for the tests of boards and publishers; the chain that makes them of frames."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from altd.config import Installation, Measuring
from altd.instruments.beam.instrument import QUANTITIES, BeamInstrument, values_of
from altd.instruments.beam.solver import Beam
from altd.instruments.row.measurement import quantities_of
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import Provenance
from altd.reasons import Reason
from altd.records import Fault, MeanSpots, Measurement, Value

BEAM = Beam(10.012, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)
POINTS_MM = {"front": (10.012, 4.987), "rear": (15.613, -3.413)}

Points = Mapping[str, tuple[float, float] | None]


def measurement(sequence: int = 160, t_ns: int = 8_000_000_000, *reasons: Reason) -> Measurement:
    """A valid measurement, or an invalid one when a reason makes it so."""
    invalid = any(not reason.is_warning for reason in reasons)
    return measured(
        None if invalid else BEAM,
        dict.fromkeys(POINTS_MM) if invalid else POINTS_MM,
        sequence=sequence,
        t_ns=t_ns,
        frames=0 if invalid else 20,
        status=tuple(Fault(reason) for reason in reasons),
    )


def measurement_of_row(
    names: Sequence[str],
    displacements_mm: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    **fields: Any,
) -> Measurement:
    """A round of a row: these displacements, and a spot on each target that ``lost`` does not name."""
    lost = fields.pop("lost", ())
    seen = {
        name: {
            "x_mm": Value(1.25, 0.01, 0.005),
            "y_mm": Value(-2.5, 0.01, 0.005),
            **({"significance": Value(7.5)} if name in displacements_mm else {}),
        }
        for name in names
        if name not in lost
    }
    values = {"measured": Value(float(len(seen)))} | {
        f"{name}_d{axis}_mm": Value(mm, 0.004, 0.003)
        for name, of in displacements_mm.items()
        for axis, mm in zip("xy", of, strict=True)
    }
    targets = {name: seen.get(name) for name in names}
    round_ = Measurement(139, 7_000_000_000, None, 20, quantities_of(names), values, targets)
    return replace(round_, **fields)


def measured(
    beam: Beam | None = BEAM, points_mm: Points = POINTS_MM, roll_deg: float | None = None, **fields: Any
) -> Measurement:
    """A measurement of that beam; None: an invalid one."""
    blank = Measurement(160, 8_000_000_000, None, 20, QUANTITIES, {}, {})
    return changed(replace(blank, **fields), beam, points_mm, roll_deg)


def changed(
    measurement: Measurement,
    beam: Beam | None,
    points_mm: Points | None = None,
    roll_deg: float | None = None,
    **fields: Any,
) -> Measurement:
    """The measurement with another beam, roll and, where they are given, points."""
    values = {} if beam is None else values_of(beam)
    if beam is not None and roll_deg is not None:
        values["roll_deg"] = Value(roll_deg)
    targets = measurement.targets
    if points_mm is not None:
        targets = {
            target: None if point is None else {"x_mm": Value(point[0]), "y_mm": Value(point[1])}
            for target, point in points_mm.items()
        }
    return replace(measurement, values=values, targets=targets, **fields)


def beam_of(measurement: Measurement) -> Beam | None:
    """A measurement's values of its beam; None: it is invalid."""
    if not measurement.valid:
        return None
    keys = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
    numbers = [measurement.values[key].value for key in keys]
    sigmas = [measurement.values[key].sigma for key in keys]
    return Beam(*numbers, *(sigma for sigma in sigmas if sigma is not None))


def points_of(measurement: Measurement) -> dict[str, tuple[float, float] | None]:
    """A measurement's values on the targets, x and y mm."""
    return {
        target: None if values is None else (values["x_mm"].value, values["y_mm"].value)
        for target, values in measurement.targets.items()
    }


def beam_chain(
    calibration: Calibration,
    measuring: Measuring,
    installation: Installation | None = None,
    provenance: Provenance | None = None,
    correct: Callable[[MeanSpots], MeanSpots] | None = None,
) -> MeasuringChain:
    """The chain of a beam, each of whose targets has a camera of its name."""
    views = [View(target.name, target.name) for target in calibration.targets]
    instrument = BeamInstrument(calibration, measuring, installation)
    of = provenance or Provenance()
    return MeasuringChain(views, calibration, measuring, instrument, of, correct=correct)
