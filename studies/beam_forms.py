"""Spots of 13 × 5 mm and of 15 mm, and of a laser 100 m away: hundreds of beams of each."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from altd.calibration.file import load_calibration
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.reasons import Reason
from altd.records import FloatArray, Measurement
from hw_sim.beam import BeamPose
from hw_sim.measure import HALF_AREA_MM, random_poses
from hw_sim.unit import CAMERAS, Unit, UnitConfig
from studies.beam import USUAL_MM, exposed, grown
from studies.bench import QUANTITIES, SIMULATORS, Bench, bench, rms, truth_of
from studies.plot import OURS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Round and elliptic spots to 15 mm: 500 beams each"
QUESTION = "Which share of spots of 13 × 5 mm and of 15 mm is measured, and does sigma cover their errors?"

SEEDS = (71, 72)
"""Units; the beams of a form are dealt out to them."""
EXPOSURES = 2
OUTER_MM = 10.0


@dataclass(frozen=True, slots=True)
class Form:
    """A beam's 1/e² diameters, the number of such beams, and whether the units are calibrated with it too."""

    diameters_mm: tuple[float, float]
    beams: int
    is_calibrated: bool = False


FORMS = {
    "13 × 5 mm": Form((13.0, 5.0), 500, True),
    "15 mm round": Form((15.0, 15.0), 500, True),
    **{
        f"12 × 11 mm at 100 m, M² {quality:g}": Form(
            (grown(USUAL_MM[0], 100.0, quality), grown(USUAL_MM[1], 100.0, quality)), 100
        )
        for quality in (1.0, 2.0)
    },
}
SPECIFIED = (0.0, 1.0, 1.0, 0.0573, 0.0573, None, None, None, None, None)
COLUMNS = (
    Column("invalid, %", 1),
    Column("x rms, mm"),
    Column("y rms, mm"),
    Column("yaw rms, °", 5),
    Column("pitch rms, °", 5),
    *(Column(f"error/sigma: {key}", 2, judged=False) for key in ("x rms", "y rms", "yaw rms", "pitch rms")),
    Column("largest", 1, judged=False),
)

_Measured = list[tuple[BeamPose, Measurement]]


def run(progress: Progress) -> Result:
    """Two units on each simulator; the same frames are measured with both calibrations."""
    found: dict[str, _Measured] = {}
    for ending, hard in SIMULATORS.items():
        for seed in SEEDS:
            with bench(progress, f"beam-forms, unit {seed}{ending}") as on:
                for case, measured in _of_unit(on, UnitConfig(seed=seed, hard=hard), progress).items():
                    found.setdefault(case + ending, []).extend(measured)
    ordered = sorted(found, key=[case + ending for case in _cases() for ending in SIMULATORS].index)
    values = {case: _values(found[case]) for case in ordered}
    ellipse, wide = list(FORMS)[:2]
    return Result(
        of="beam",
        thesis_source=(
            "App. A.1, a specification without a test: round or elliptic spot to 15 mm, ±1 mm, ±1 mm/m "
            "(0.0573°), up to 100 m; laser of App. A.2 (d), 13 × 5 mm"
        ),
        columns=COLUMNS,
        rows=tuple(Row(case, of, SPECIFIED) for case, of in values.items()),
        headline=(
            f"Valid of 500 beams, ordinary and harder simulator: of {ellipse} {_valid(values, ellipse)} if "
            f"calibrated with 12 × 11 mm, {_valid(values, f'{ellipse}, calibrated so')} if with that beam; "
            f"of 15 mm {_valid(values, wide)}, and {_valid(values, f'{wide}, calibrated so')}."
        ),
        text=f"""
Each form has its beams on {len(SEEDS)} units of each simulator, anywhere on the 140 × 110 mm of both targets
and at any angle of the range, with {EXPOSURES} exposures each. The units are calibrated with 12 × 11 mm, or
(*calibrated so*) with the beam that they measure; both measure the same frames. All beams have 3 mW and an
exposure that is inverse to their peak. [Fewer beams of further forms](beam.md) have a study of their own.

*Refused*, with the share of beams whose spots both keep {OUTER_MM:g} mm from the border of the area, among
the refused and among all: {_refusals(found, ordered)}.

*Elongation* is the difference between the two spots, of which a unit allows 3 %, or 6 times the scatter of
the scan's spots; *uncertain* is a smaller one, which makes sigma larger, to more than 0.1 mm. Both are
`front_distorted` or `rear_distorted`. Wide spots are refused at the border alone, where the picture cuts the
rim of their light.

A spot of 18.3 × 18.6 mm (100 m, M² 2) is beyond the 15 mm of App. A.1; a unit measures up to 17 mm.
""",
        figure=_figure(values),
        caption="Share of invalid beams, and rms of error/sigma over x, y, yaw and pitch",
        beside="specified",
    )


def _cases() -> list[str]:
    return [
        case
        for name, form in FORMS.items()
        for case in (name, *([f"{name}, calibrated so"] if form.is_calibrated else []))
    ]


def _of_unit(on: Bench, base: UnitConfig, progress: Progress) -> dict[str, _Measured]:
    """All cases of one unit."""
    usual, found = _calibrated(on, Unit(base)), dict[str, _Measured]()
    for name, form in FORMS.items():
        unit, calibrations = exposed(base, form.diameters_mm), {name: usual}
        if form.is_calibrated:
            calibrations[f"{name}, calibrated so"] = _calibrated(on, unit)
        rng = np.random.default_rng([base.seed, 45])
        poses = random_poses(form.beams // len(SEEDS), base.target_distance_mm, rng)
        progress(f"beam-forms, unit {base.seed}: {form.beams // len(SEEDS)} beams of {name}")
        measured = _watched(unit, poses, list(calibrations.values()))
        found |= dict(zip(calibrations, measured, strict=True))
    return found


def _calibrated(on: Bench, unit: Unit) -> Calibration:
    on.calibrate(unit)
    return load_calibration(on.calibration_file)


def _watched(unit: Unit, poses: Sequence[BeamPose], calibrations: Sequence[Calibration]) -> list[_Measured]:
    """One measurement a pose by each calibration, without files: 500 beams would take 1 GB."""
    measuring = Measuring(window=EXPOSURES, every=EXPOSURES)
    chains = [
        MeasuringChain([View(name, name) for name in CAMERAS], of, measuring, BeamInstrument(of, measuring))
        for of in calibrations
    ]
    found: list[_Measured] = [[] for _ in chains]
    for number, pose in enumerate(poses):
        unit.place(pose)
        for sequence in range(number * EXPOSURES, (number + 1) * EXPOSURES):
            for camera in CAMERAS:
                frame = unit.expose(camera, sequence, sequence * unit.config.period_ns)
                for chain, of in zip(chains, found, strict=True):
                    of += [(pose, measurement) for measurement in chain.push(frame)]
    return found


def _values(measured: _Measured) -> tuple[float | None, ...]:
    valid = [(pose, of) for pose, of in measured if of.valid]
    invalid = 100.0 * (1.0 - len(valid) / len(measured))
    if not valid:
        return (invalid, *[None] * 9)
    values, sigmas = (_of([of for _, of in valid], name) for name in ("value", "sigma"))
    errors = values - truth_of([pose for pose, _ in valid])
    ratios = errors / sigmas
    return (
        invalid,
        *(rms(errors[:, at]) for at in range(4)),
        *(rms(ratios[:, at]) for at in range(4)),
        float(np.abs(ratios).max()),
    )


def _of(measured: Sequence[Measurement], name: str) -> FloatArray:
    return np.array([[getattr(of.values[key], name) for key in QUANTITIES] for of in measured])


def _valid(values: Mapping[str, tuple[float | None, ...]], case: str) -> str:
    shares = [values[case + ending][0] or 0.0 for ending in SIMULATORS]
    return " and ".join(f"{100.0 - share:.1f} %" for share in shares)


def _refusals(found: Mapping[str, _Measured], ordered: Sequence[str]) -> str:
    """For each case with refused beams: their reasons, and where they are."""
    lines = []
    for case in ordered:
        refused = [(pose, of) for pose, of in found[case] if not of.valid]
        if not refused:
            continue
        counted = Counter(_reason(of) for _, of in refused)
        said = ", ".join(f"{count} {reason}" for reason, count in counted.most_common())
        inner = [100.0 * np.mean([_is_inner(pose) for pose, _ in of]) for of in (refused, found[case])]
        lines.append(f"{case}: {said} ({inner[0]:.0f} of {inner[1]:.0f} % inside)")
    return "; ".join(lines) or "none"


def _reason(measurement: Measurement) -> str:
    fault = next(fault for fault in measurement.status if not fault.reason.is_warning)
    if fault.reason is not Reason.DISTORTED:
        return f"`{fault}`"
    return "elongation" if "elongation" in fault.detail else "uncertain"


def _is_inner(pose: BeamPose) -> bool:
    spots = np.abs([pose.at(0.0), pose.at(UnitConfig().target_distance_mm)])
    return bool(np.all(spots <= np.array(HALF_AREA_MM) - OUTER_MM))


def _figure(values: Mapping[str, tuple[float | None, ...]]) -> Figure:
    figure, (share, ratio) = panels(1, 2, width=11.0, height=3.6)
    names = _cases()
    places = np.arange(len(names))
    for (ending, hard), colour in zip(SIMULATORS.items(), (OURS, THIRD), strict=True):
        of = np.array([values[name + ending] for name in names], dtype=np.float64)
        label = "harder simulator" if hard else "ordinary simulator"
        share.plot(of[:, 0], places, "o", color=colour, label=label)
        ratio.plot(np.sqrt(np.mean(np.square(of[:, 5:9]), axis=1)), places, "o", color=colour, label=label)
    share.set(xlabel="invalid, %")
    ratio.set(xlabel="rms of error/sigma", xlim=(0.0, None))
    for axis, shown in ((share, names), (ratio, [""] * len(names))):
        axis.set_yticks(places, shown)
        axis.set_ylim(len(names) - 0.5, -0.5)
    share.legend()
    return figure
