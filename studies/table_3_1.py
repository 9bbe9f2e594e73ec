"""Table 3.1: which dots to print on the window."""

import math
from dataclasses import dataclass, replace

import numpy as np

from altd.records import FloatArray
from hw_sim.beam import BeamPose, footprint
from hw_sim.measure import HALF_AREA_MM
from hw_sim.sensor import FULL_WELL_E
from hw_sim.targets import DotPattern
from hw_sim.unit import FRONT, Unit, UnitConfig
from studies.bench import SIMULATORS, bench, pooled_std, rms
from studies.plot import GREY, OURS, THESIS, THIRD, panels, plain_decades
from studies.result import Column, Progress, Result, Row

TITLE = "Table 3.1: dot patterns"
QUESTION = (
    "How well is a displacement of the spot measured through the dots of the window, and on the opaque plate?"
)

SEED = 71
DISPLACEMENTS, STEP_MM, EXPOSURES = 50, 1.0, 3

PATTERNS = (
    ("orthogonal 1.0/2.0", DotPattern(1.0, 2.0, hexagonal=False), (0.5081, 0.2129, 0.2024, None)),
    ("hexagonal 0.8/1.6", DotPattern(0.8, 1.6), (0.1045, 0.0268, 0.0395, None)),
    ("hexagonal 0.5/1.0", DotPattern(0.5, 1.0), (0.0493, 0.0041, 0.0039, None)),
    ("hexagonal 0.35/0.7", DotPattern(0.35, 0.7), None),
    ("hexagonal 0.25/0.5", DotPattern(0.25, 0.5), None),
)
"""Dot diameter/distance in mm, and the thesis' row: σ of displacements, of repeated readings in x and y.

The last two are the finer dots that the thesis proposes (chapter 5).
"""
CHOSEN = 2
"""Index of the pattern that the thesis chose."""

THESIS_OPAQUE = (0.01899, None, None, None)


@dataclass(frozen=True, slots=True, eq=False)
class _TargetErrors:
    """Of one target: errors of the displacements (50,), repeats' σ in x and y, places (100, 2), mm."""

    displacements_mm: FloatArray
    repeat_mm: FloatArray
    places_mm: FloatArray

    @property
    def row(self) -> tuple[float, ...]:
        """In the order of the table."""
        return (
            float(self.displacements_mm.std(ddof=1)),
            float(self.repeat_mm[0]),
            float(self.repeat_mm[1]),
            rms(self.places_mm),
        )


def displaced_poses(rng: np.random.Generator) -> list[BeamPose]:
    """Pairs of beams along the axis, the second 1 mm away in any direction, all over the target."""
    poses = []
    for _ in range(DISPLACEMENTS):
        x_mm, y_mm = rng.uniform(-1.0, 1.0, size=2) * (np.array(HALF_AREA_MM) - STEP_MM)
        direction = rng.uniform(0.0, 2.0 * math.pi)
        poses.append(BeamPose(float(x_mm), float(y_mm)))
        poses.append(
            BeamPose(float(x_mm) + STEP_MM * math.cos(direction), float(y_mm) + STEP_MM * math.sin(direction))
        )
    return poses


def set_exposure(unit: Unit) -> None:
    """Expose the front camera as one would: the brightest dots at three quarters of full scale.

    That is without the harder simulator's speckle, whose peaks are higher: both have the same exposure.
    """
    imager = Unit(replace(unit.config, hard=None)).imagers[FRONT]
    places = [BeamPose(x, y) for x in (-50.0, 0.0, 50.0) for y in (-40.0, 0.0, 40.0)]
    spots = [footprint(unit.config.laser, pose, 0.0) for pose in places]
    brightest_e = max(float(imager.view.beam_e([spot], 1.0)[1].max()) for spot in spots)
    unit.set_camera(FRONT, exposure_ms=0.75 * FULL_WELL_E / brightest_e)


def run(progress: Progress) -> Result:
    """One unit a pattern and simulator, all else the same."""
    poses = displaced_poses(np.random.default_rng([SEED, 31]))
    at_mm = np.array([(pose.x_mm, pose.y_mm) for pose in poses])
    seen: dict[str, list[_TargetErrors]] = {}
    for ending, hard in SIMULATORS.items():
        seen[ending] = []
        for name, dots, _ in PATTERNS:
            unit = Unit(UnitConfig(seed=SEED, dots=dots, hard=hard))
            set_exposure(unit)
            with bench(progress, name + ending) as on:
                on.calibrate(unit)
                readings = on.replay(on.record(unit, poses, EXPOSURES), 1, 1)
            seen[ending].append(_target_errors(readings.front_mm, at_mm))
            if dots == PATTERNS[CHOSEN][1]:  # as in the thesis, behind these
                opaque = _target_errors(readings.rear_mm, at_mm)
        seen[ending].append(opaque)

    names = [name for name, _, _ in PATTERNS] + ["opaque (rear)"]
    figure, axes = panels(1, 2, width=10.5)
    bars, histogram = axes
    thesis = [row for _, _, row in PATTERNS] + [THESIS_OPAQUE]
    sigmas = {f"ours{ending}": [of.row[0] for of in targets] for ending, targets in seen.items()}
    place = np.arange(len(names))
    series = {"thesis": [row[0] if row else math.nan for row in thesis], **sigmas}
    for shift, (name, values), colour in zip(
        (-0.28, 0.0, 0.28), series.items(), (THESIS, OURS, THIRD), strict=True
    ):
        bars.bar(place + shift, values, 0.26, color=colour, label=name)
        for at, value in zip(place + shift, values, strict=True):
            if not math.isnan(value):
                bars.text(float(at), value * 1.06, f"{value:.3f}", ha="center", fontsize=6, color=GREY)
    bars.set_yscale("log")
    bars.set_xticks(place, [name.replace(" ", "\n") for name in names])
    bars.set(
        ylabel="σ of displacements, mm", title="Displacements of 1 mm", ylim=(0.5 * min(sigmas["ours"]), 1.2)
    )
    plain_decades(bars.yaxis)
    bars.grid(visible=False, axis="x")
    bars.legend()
    shown = {names[at] + ending: targets[at] for at in (CHOSEN, -1) for ending, targets in seen.items()}
    limit = 1.2 * max(float(np.abs(of.displacements_mm).max()) for of in shown.values())
    edges = np.linspace(-limit, limit, 21).tolist()
    for (name, of), colour, style in zip(
        shown.items(), (OURS, OURS, THESIS, THESIS), ("-", "--") * 2, strict=True
    ):
        histogram.hist(
            of.displacements_mm, bins=edges, histtype="step", lw=1.3, ls=style, color=colour, label=name
        )
    histogram.set(
        xlabel="error of a displacement, mm", ylabel="displacements", title="Their errors, as Fig. 3.11"
    )
    histogram.set_ylim(top=1.6 * histogram.get_ylim()[1])
    histogram.legend(loc="upper left")

    chosen, plate, finest = (
        " and ".join(f"{of[at]:.4f}" for of in sigmas.values()) for at in (CHOSEN, -1, -2)
    )
    return Result(
        of="dots, mm",
        thesis_source=(
            "Sec. 3.3.1 and 3.3.3, Table 3.1, Fig. 3.8–3.11 (50 displacements over the whole target)"
        ),
        differs=(
            "the orthogonal print is an even one; milky glass (Fig. 3.7) has [a study](milky.md) of its own; "
            "two finer prints are added"
        ),
        columns=(
            Column("displacement σ, mm"),
            Column("repeated x σ, mm"),
            Column("repeated y σ, mm"),
            Column("error of place, rms mm"),
        ),
        rows=tuple(
            Row(names[at] + ending, targets[at].row, thesis[at])
            for at in place
            for ending, targets in seen.items()
        ),
        headline=(
            f"Hexagonal dots of 0.5/1.0 mm: displacements to {chosen} mm on the ordinary and the harder "
            f"simulator (thesis 0.0493), on the opaque plate {plate} mm (thesis 0.0190)."
        ),
        text=f"""
The thesis moves the beam by 1 mm at 50 places and compares the distance of the two mapped spots with the
table's. *Displacement σ* is the standard deviation of these errors, *repeated σ* that of further pictures
at the same place. This study uses {DISPLACEMENTS} pairs of beams along the axis, 1 mm apart in any
direction. They are single exposures on a 6 × 5 scan; the repeats have {EXPOSURES} exposures of each place.
*Error of place* is against the beam's true position (rms of x and y). It exceeds the error of a
displacement, because two spots 1 mm apart share most of their error.

The opaque row is the rear target behind the 0.5/1.0 mm dots. The units differ in their print only. The
orthogonal print is perfect on the ordinary simulator. On the harder one dots bleed and jitter by 0.006 mm,
the laser's own speckle adds to the error, and the patterns differ little. The thesis' orthogonal print
was a digital one with chipped dots (Fig. 3.8), which may explain much of its 0.5 mm. The settings are the
standard ones, made for dots 1 mm apart, without a flat field. The finer dots that the thesis proposes, of
0.25 mm, reach {finest} mm. Cameras and lenses are those of App. A.3.
""",
        figure=figure,
        caption=(
            "Displacement error by dot pattern, thesis and ours; histogram for the chosen dots "
            "and the opaque plate"
        ),
    )


def _target_errors(points_mm: FloatArray, at_mm: FloatArray) -> _TargetErrors:
    """From single exposures (100 × exposures, 2), in the order of the places (100, 2)."""
    exposures = points_mm.reshape(len(at_mm), EXPOSURES, 2)
    single = exposures[:, 0]
    moved = np.linalg.norm(single[1::2] - single[::2], axis=1)
    return _TargetErrors(moved - STEP_MM, pooled_std(exposures), single - at_mm)
