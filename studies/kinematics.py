"""Fig. 2.11 and Eqs. 2.34–2.36: workspace and singular poses of the planar 3-PRP machine."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from altd.instruments.planar.machine.geometry_fit import PARAMETERS, fit_geometry
from altd.instruments.planar.machine.kinematics import PlanarMachine, poses_of
from altd.instruments.planar.machine.singularities import concurrent_line, parallel_orientations_deg
from altd.instruments.planar.machine.workspace import area_mm2, slice_mm, type_2_range_mm
from studies.planar_machine import contains, double_triangle, face_mm, joints_of, volume_mm2_deg
from studies.plot import GREY, OURS, THESIS, THIRD
from studies.result import Column, Progress, Result, Row

TITLE = "Fig. 2.11: workspace and singular poses of the planar machine"
QUESTION = "Which poses of the double triangular manipulator are singular, and does its workspace avoid them?"

BASE_MM = 500.0
"""The source does not print the size; every length here is in proportion to it."""
CLAIMED_DEG = (-49.2486, 49.2486, 65.3757)
SLICES_DEG = (-40.0, -20.0, 0.0, 20.0, 40.0, 55.0)
FACES_DEG, PIECES = np.arange(-57.0, 62.1, 4.25), 4
"""Orientations at which the surfaces of the solid are cut into strips, and pieces of a strip."""
VIEWS_DEG = {"The solid and its six surfaces": -60.0, "From the other side": 190.0}
"""Titles of the pictures of the solid, and the directions that they are seen from."""
POSES, UNITS, SEED = 60, 50, 211
SIGMA_POSE = np.array([0.03, 0.03, 0.02])
SIGMA_JOINT_MM = 0.025 / np.sqrt(12.0)
"""Of a pose in mm and °, as the camera measures it at best; of a joint, one step of 25 µm (§2.4.5)."""


def run(progress: Progress) -> Result:
    """Judge the source's singular orientations, cut the workspace, and fit machines from measured poses."""
    machine = double_triangle(BASE_MM)
    progress("kinematics: slices")
    phi = np.arange(-57.5, 62.01, 0.25)
    nearest, farthest = np.array([type_2_range_mm(machine, float(angle)) for angle in phi]).T
    meets = (nearest < 0) & (farthest > 0)
    rows = tuple(
        Row(
            f"φ = {angle:+.4f}°",
            (
                float(np.min(np.abs(_turn_deg(machine, angle)))),
                area_mm2(slice_mm(machine, angle)),
                _distance_mm(machine, angle),
            ),
        )
        for angle in CLAIMED_DEG
    )
    progress("kinematics: fits")
    ratios, sigmas, condition = _fits(machine)

    figure = Figure(figsize=(8.4, 7.6), layout="constrained")
    _draw_solid(figure, machine)
    left, right = (figure.add_subplot(2, 2, place) for place in (3, 4))
    for angle in SLICES_DEG:
        corners = slice_mm(machine, angle)
        shade = (angle - SLICES_DEG[0]) / (SLICES_DEG[-1] - SLICES_DEG[0])
        outline = np.vstack([corners, corners[:1]])
        left.plot(*outline.T, color=OURS, alpha=1.0 - 0.7 * shade, lw=1.2)
        left.annotate(f"{angle:.0f}°", corners[np.argmax(corners[:, 1])], color=GREY, fontsize=7)
        line = concurrent_line(machine, angle)
        chord = _chord_mm(corners, line.normal, float(line.offset_mm))
        if len(chord):
            left.plot(*chord.T, color=THESIS, lw=1.6)
    left.set(xlabel="a, mm", ylabel="b, mm", title="Slices of the workspace", aspect="equal")
    left.plot([], [], color=THESIS, lw=1.6, label="singular (type 2)")
    left.legend(loc="lower right", fontsize=7)
    right.fill_between(phi, nearest, farthest, color=OURS, alpha=0.3, lw=0, label="poses of the workspace")
    right.axhline(0.0, color=THESIS, lw=1.6, label="singular (type 2)")
    for angle in CLAIMED_DEG[1:]:
        right.axvline(angle, color=THESIS, lw=0.9, ls="--")
    right.axvline(CLAIMED_DEG[0], color=GREY, lw=0.9, ls=":")
    right.text(CLAIMED_DEG[0] + 1, -150, "−49.25°: not singular", color=GREY, fontsize=7)
    right.text(CLAIMED_DEG[1] - 1, 900, "type 1", color=THESIS, fontsize=7, ha="right")
    right.set(
        xlabel="φ, °",
        ylabel="signed distance to type 2, mm",
        ylim=(-250, 2300),
        title="Distance to singular poses",
    )
    right.legend(loc="upper right", bbox_to_anchor=(0.84, 1.0), fontsize=7)

    start = np.array([0.0, 0.0, 0.0])
    moved = poses_of(machine, joints_of(machine, start) + np.array([0.0, -45.0, 45.0]))
    moved = moved[np.argmin(np.abs(moved[:, 2]))]
    volume, by_joints = volume_mm2_deg(machine, -180.0, 180.0), _volume_by_joints_mm2_deg(machine)
    first, last = phi[meets][0], phi[meets & (phi < CLAIMED_DEG[1])][-1]
    orientations = ", ".join(f"{angle:.4f}°" for angle in sorted(parallel_orientations_deg(machine)))
    return Result(
        of="orientation, singular in the thesis",
        thesis_source=(
            "Sec. 2.3.2–2.3.5, 2.4.4, Fig. 2.10, 2.11, Eqs. 2.25–2.36, 2.60–2.64; no dimensions are printed"
        ),
        differs=(
            "the joints use their whole rails, in the thesis a range that limits φ to −48.5° … +62°; the "
            "solid is drawn over (a, b, φ), in the thesis in the image space"
        ),
        columns=(
            Column("turn to the next parallel rail and edge, °", 4, judged=False),
            Column("workspace there, mm²", 1, judged=False),
            Column("nearest type-2 pose to the workspace, mm", 1, judged=False),
        ),
        rows=rows,
        headline=(
            "+49.2486° and +65.3757° are singular, −49.2486° is not; against the thesis, the workspace "
            f"contains singular poses of type 2 from φ = {first:.1f}° on."
        ),
        text=f"""
*The machine.* Two equal isosceles triangles, long to short side 6 : 5. The assignment of the moving
triangle's edges to the fixed triangle's sides follows from Eq. 2.64 alone: of all six assignments only one
moves by (18.75, −40.91) mm at constant φ when two joints move by 45 mm; ours moves by ({moved[0]:.4f},
{moved[1]:.4f}) mm. A rail is parallel to its edge (type 1) at {orientations}.

*−49.2486°.* The three sines between rails and edges are far from zero there, and det B has one sign in the
whole slice. The thesis' cases (a) and (b) both belong to another assignment, base on base and the legs
swapped: its singular orientations are −49.2486°, 0° and +49.2486°. It cannot give Eq. 2.64, and (c) is not
singular in it.

*Workspace.* With joints that use the whole sides the volume is {volume:,.0f} mm²·° by slices, whose polygons
are exact, and {by_joints:,.0f} mm²·° by integrating |∂(a, b, φ)/∂(joints)| over all joints and both modes:
{100 * abs(by_joints / volume - 1):.3f} % apart. The six surfaces (Fig. 2.10, above) are where a joint is at
an end of its rail. Each belongs to a hyperbolic paraboloid of the image space, which has two real lines in
the plane X₀ = 0 (Eqs. 2.25–2.27); at each φ it is a straight line.

*The claim* of §2.3.4 that every path inside the solid is free of singular poses does not hold. Eqs. 2.28
to 2.30 bound the joints; they do not contain the poses of type 2, where the normals of the edges meet in
one point. At one φ these are a straight line in (a, b), which crosses the workspace for φ between
{first:.1f}° and {last:.1f}° (left, orange), and again beyond +49.2486°. An example is a translation at
φ = 40° through the middle of the slice: all joints stay between 2 and 98 % of their rails, and det B
changes its sign. At smaller φ the claim holds. It also holds for type 1, where the solid has no width.

*Geometry from measured poses* (Eq. 2.63): {UNITS} machines with errors of 1 mm and 0.2°, {POSES} poses each,
measured to 0.03 mm and 0.02°. The eighteen parameters are found with error/sigma {ratios:.2f}; their median
sigma is {sigmas[0]:.2f} mm for a rail's place, {sigmas[2]:.3f}° for its direction, {1e6 * sigmas[3]:.0f} ppm
for the screw, {sigmas[4]:.3f}° and {sigmas[5]:.2f} mm for an edge. Condition of the scaled design:
{condition:.0f}. Poses of one orientation do not determine a rail's place apart from its edge's; the fit then
reports which parameters are not determined.
""",
        figure=figure,
        caption=(
            "Above: the workspace over a, b and φ; each face is where one joint is at one end of its rail "
            "(Fig. 2.10). Below, left: the workspace at six orientations, with its singular poses (Fig. "
            "2.11). Below, right: range of the signed distance of the workspace from the singular line, by "
            "orientation"
        ),
    )


def _draw_solid(figure: Figure, machine: PlanarMachine) -> None:
    """The solid from two sides, a colour a joint, dark at the start of its rail and light at its end."""
    pieces, shades, legend = [], [], []
    for leg, (colour, rail) in enumerate(
        zip((OURS, THESIS, THIRD), ("base", "right leg", "left leg"), strict=True)
    ):
        for end, of_rail in enumerate(("start", "end")):
            red, green, blue = ((1.0 - 0.45 * end) * part + 0.45 * end for part in to_rgb(colour))
            shade = red, green, blue
            sides = [np.insert(face_mm(machine, phi, leg, end), 2, phi, axis=1) for phi in FACES_DEG]
            face = [
                piece
                for low, high in pairwise(sides)
                if len(low) and len(high)
                for piece in _pieces(low, high)
            ]
            pieces += face
            shades += [shade] * len(face)
            legend.append(Patch(color=shade, label=f"joint at the {of_rail} of the {rail}"))
    for place, (title, azimuth_deg) in enumerate(VIEWS_DEG.items(), 1):
        axis = figure.add_subplot(2, 2, place, projection="3d")
        lines = [tuple(0.6 * part for part in shade) for shade in shades]
        # one collection of short pieces: matplotlib decides by their middles which hides which
        axis.add_collection3d(Poly3DCollection(pieces, facecolors=shades, edgecolors=lines, linewidths=0.2))
        axis.set(xlim=(-260, 400), ylim=(0, 640), zlim=(-60, 65), title=title)
        axis.set(xlabel="a, mm", ylabel="b, mm", zlabel="φ, °")
        axis.view_init(25.0, azimuth_deg)
        axis.set_box_aspect((1.0, 1.0, 0.9), zoom=0.9)
        axis.locator_params(nbins=5)
    figure.legend(handles=legend, loc="upper center", bbox_to_anchor=(0.5, 1.0), fontsize=7)


def _pieces(low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
    """Pieces (4, 3), one beside the other, of the strip between two sides (2, 3)."""
    share = np.linspace(0.0, 1.0, PIECES + 1)[:, None]
    lower, upper = ((1.0 - share) * side[0] + share * side[1] for side in (low, high))
    return [np.array([*lower[k : k + 2], *upper[k : k + 2][::-1]]) for k in range(PIECES)]


def _turn_deg(machine: PlanarMachine, phi_deg: float) -> npt.NDArray[np.float64]:
    return np.mod(machine.rail_deg - machine.edge_deg - phi_deg + 90.0, 180.0) - 90.0


def _distance_mm(machine: PlanarMachine, phi_deg: float) -> float | None:
    """Of the slice at φ from the line of type 2; 0 where it crosses, None where the slice is empty."""
    low, high = type_2_range_mm(machine, phi_deg)
    return None if np.isnan(low) else max(low, -high, 0.0)


def _chord_mm(
    corners: npt.NDArray[np.float64], normal: npt.NDArray[np.float64], offset: float
) -> npt.NDArray[np.float64]:
    """The part (2, 2) of a line inside a convex polygon; (0, 2) where it misses."""
    side = corners @ normal - offset
    ends = [
        corners[k]
        + (corners[k + 1 - len(corners)] - corners[k]) * side[k] / (side[k] - side[k + 1 - len(corners)])
        for k in range(len(corners))
        if side[k] * side[k + 1 - len(corners)] < 0
    ]
    return np.array(ends).reshape(-1, 2)


def _volume_by_joints_mm2_deg(machine: PlanarMachine) -> float:
    count, ratio = 2**20, 1.2207440846057596
    span = np.ptp(machine.limits_mm, axis=1)
    lattice = np.mod(0.5 + np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, 4.0), 1.0)
    joints, step = lattice * span, 1e-4
    columns = np.stack(
        [
            (poses_of(machine, joints + step * axis) - poses_of(machine, joints - step * axis)) / (2 * step)
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    closes = np.asarray(np.isfinite(columns).all(axis=(-2, -1)))
    gain = np.abs(np.linalg.det(np.where(closes[..., None, None], columns, 0.0)))
    return float(gain.sum(axis=1).mean() * np.prod(span))


def _fits(design: PlanarMachine) -> tuple[float, npt.NDArray[np.float64], float]:
    """Rms of error/sigma over all parameters and machines, median sigmas by parameter, median condition."""
    rng = np.random.default_rng(SEED)
    drawn = rng.uniform((-300.0, -200.0, -55.0), (400.0, 700.0, 30.0), (40_000, 3))
    poses = np.compress(contains(design, drawn), drawn, axis=0)
    ratios, sigmas, conditions = [], [], list[float]()
    for _ in range(UNITS):
        true = PlanarMachine(
            design.rail_start_mm + rng.normal(0, 1, (3, 2)),
            design.rail_deg + rng.normal(0, 0.2, 3),
            design.edge_deg + rng.normal(0, 0.2, 3),
            design.edge_offset_mm + rng.normal(0, 1, 3),
            design.limits_mm,
            1 + rng.normal(0, 1e-3, 3),
        )
        there = rng.choice(poses, POSES, replace=False)
        joints = joints_of(true, there) + rng.normal(0, SIGMA_JOINT_MM, there.shape)
        fitted = fit_geometry(
            design,
            there + rng.normal(0, SIGMA_POSE, there.shape),
            joints,
            np.diag(SIGMA_POSE**2),
            SIGMA_JOINT_MM,
        )
        ratios.append((fitted.machine.parameters - true.parameters) / fitted.sigmas)
        sigmas.append(fitted.sigmas)
        conditions.append(fitted.condition)
    return (
        float(np.sqrt(np.mean(np.square(ratios)))),
        np.median(np.reshape(sigmas, (-1, len(PARAMETERS))), axis=0),
        float(np.median(conditions)),
    )
