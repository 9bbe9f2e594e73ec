"""Kinematics, singular poses and workspace of the planar 3-PRP machine, against plain geometry."""

import itertools
import math

import numpy as np
import numpy.typing as npt
import pytest

from altd.instruments.planar.machine.geometry_fit import NotIdentifiableError, fit_geometry
from altd.instruments.planar.machine.kinematics import PlanarMachine, poses_of
from altd.instruments.planar.machine.singularities import concurrent_line, parallel_orientations_deg
from altd.instruments.planar.machine.workspace import area_mm2, slice_mm
from studies.planar_machine import (
    absolute_lines,
    contains,
    double_triangle,
    face_mm,
    image_determinant,
    image_points,
    joints_of,
    machine_of_triangles,
    quadrics,
    volume_mm2_deg,
)

Array = npt.NDArray[np.float64]

BASE_MM, LEG_MM = 500.0, 600.0
HEIGHT_MM = math.sqrt(LEG_MM**2 - BASE_MM**2 / 4)
FIXED = np.array([(0.0, 0.0), (BASE_MM, 0.0), (BASE_MM / 2, HEIGHT_MM)])
MOVING = np.array([(0.0, 0.0), (BASE_MM / 2, -HEIGHT_MM), (BASE_MM, 0.0)])
"""The vertices of the source's triangles (§2.3.2), written out: sides 6 : 5."""
BASE_ANGLE_DEG, APEX_ANGLE_DEG = 65.3757, 49.2486
"""As the source prints them."""


def machine() -> PlanarMachine:
    return double_triangle(BASE_MM)


def placed(pose: Array) -> Array:
    """The vertices of the moving triangle in the fixed frame (Eq. 2.8)."""
    a, b, phi = pose[0], pose[1], math.radians(pose[2])
    turn = np.array([(math.cos(phi), -math.sin(phi)), (math.sin(phi), math.cos(phi))])
    return np.asarray(MOVING @ turn.T + (a, b))


def crossing(p: Array, q: Array, r: Array, s: Array) -> tuple[float, float]:
    """Shares of p q and of r s at which the lines meet."""
    shares = np.linalg.solve(np.stack([q - p, r - s], axis=1), r - p)
    return float(shares[0]), float(shares[1])


def inside(count: int, seed: int) -> Array:
    """Poses in the workspace, found by the crossings of the triangles' sides alone."""
    rng, found = np.random.default_rng(seed), list[Array]()
    while len(found) < count:
        pose = rng.uniform((-300.0, -200.0, -57.0), (400.0, 700.0, 180.0))
        moved = placed(pose)
        shares = [crossing(FIXED[k], FIXED[(k + 1) % 3], moved[k], moved[(k + 1) % 3])[0] for k in range(3)]
        if min(shares) >= 0.0 and max(shares) <= 1.0:
            found.append(pose)
    return np.array(found)


class TestKinematics:
    def test_joints_are_where_the_sides_of_the_triangles_cross(self) -> None:
        for pose in inside(200, 1):
            moved = placed(pose)
            expected = [
                crossing(FIXED[k], FIXED[(k + 1) % 3], moved[k], moved[(k + 1) % 3])[0] * length
                for k, length in enumerate((BASE_MM, LEG_MM, LEG_MM))
            ]
            assert joints_of(machine(), pose) == pytest.approx(expected, abs=1e-9)

    def test_forward_after_inverse_is_the_pose_in_one_of_the_two_modes(self) -> None:
        rng = np.random.default_rng(2)
        drawn = rng.uniform((-300.0, -200.0, -180.0), (400.0, 700.0, 180.0), (400_000, 3))
        poses = drawn[contains(machine(), drawn)][:10_000]
        assert len(poses) == 10_000
        error = np.abs(poses_of(machine(), joints_of(machine(), poses)) - poses[:, None])
        error[..., 2] = np.minimum(error[..., 2], 360.0 - error[..., 2])
        error = error.max(axis=-1)
        assert error.min(axis=1).max() < 1e-9
        assert 0.3 < np.mean(error[:, 0] < error[:, 1]) < 0.7  # both modes occur

    def test_both_modes_close_the_machine(self) -> None:
        joints = joints_of(machine(), inside(300, 3))
        again = joints_of(machine(), poses_of(machine(), joints))
        assert np.abs(again - joints[:, None]).max() < 1e-6

    def test_joints_that_no_pose_can_have_give_none(self) -> None:
        assert np.isnan(poses_of(machine(), [0.2 * BASE_MM, 0.0, LEG_MM])).all()

    def test_a_joint_with_parallel_rail_and_edge_is_undetermined(self) -> None:
        phi = parallel_orientations_deg(machine())[1]
        joints = joints_of(machine(), [10.0, 20.0, phi])
        assert np.isnan(joints[1])
        assert np.isfinite(joints[[0, 2]]).all()

    def test_two_joints_by_45_mm_move_it_as_the_source_says(self) -> None:
        """Eq. 2.64: from (0, 700, 0) to (18.75, 659.09, 0)."""
        start = np.array([100.0, 50.0, 0.0])
        poses = poses_of(machine(), joints_of(machine(), start) + np.array([0.0, -45.0, 45.0]))
        mode = int(np.argmin(np.abs(poses[:, 2])))
        moved = poses[mode] - start
        assert moved == pytest.approx([45 * 5 / 12, -45 * math.sqrt(119) / 12, 0.0], abs=1e-10)
        assert (700.0 + moved[1], moved[0]) == pytest.approx((659.09, 18.75), abs=0.005)

    def test_no_other_assignment_of_edges_to_rails_moves_so(self) -> None:
        edges = [(0.0, 0.0), (BASE_MM, 0.0), (BASE_MM / 2, HEIGHT_MM)]
        wanted = 45 * np.array([5 / 12, -math.sqrt(119) / 12, 0.0])
        fitting = []
        for order in itertools.permutations(range(3)):
            base = machine_of_triangles(FIXED, edges)
            these = PlanarMachine(
                base.rail_start_mm,
                base.rail_deg,
                base.edge_deg[list(order)],
                base.edge_offset_mm[list(order)],
                base.limits_mm,
            )
            if np.abs(these.crossing_sines(0.0)).min() < 1e-9:
                fitting += [order] * _moves_so_when_parallel(these, wanted)
                continue
            joints = joints_of(these, [30.0, 40.0, 0.0])
            for signs in itertools.product((-45.0, 45.0), repeat=2):
                reached = poses_of(these, joints + np.array([0.0, *signs])) - np.array([30.0, 40.0, 0.0])
                fitting += [order] * bool(np.nanmin(np.abs(reached - wanted).max(axis=1), initial=1e9) < 1e-6)
        assert fitting == [(1, 2, 0)]  # right leg, left leg, base, on base, right leg and left leg

    def test_poses_in_image_space_close_the_quadrics(self) -> None:
        poses = inside(100, 4)
        points = image_points(poses)
        forms = quadrics(machine(), joints_of(machine(), poses))
        assert np.abs(np.einsum("ni,npij,nj->np", points, forms, points)).max() < 1e-8

    def test_the_quadrics_meet_the_plane_x0_in_one_shared_line_and_one_of_each(self) -> None:
        """Eq. 2.25 to 2.27: X3 = 0, and 2 P1 X1 + 2 P2 X2 + (P0 − P1 t1 − P2 t2) X3 = 0."""
        joints = np.array([120.0, 300.0, 450.0])
        forms, lines = quadrics(machine(), joints), absolute_lines(machine(), joints)
        rng = np.random.default_rng(9)
        for leg, length in enumerate((BASE_MM, LEG_MM, LEG_MM)):
            start, end = FIXED[leg], FIXED[(leg + 1) % 3]
            driven = start + (end - start) * joints[leg] / length
            p0, p1, p2 = np.cross([1.0, *MOVING[leg]], [1.0, *MOVING[(leg + 1) % 3]])
            own = np.array([2 * p1, 2 * p2, p0 - p1 * driven[0] - p2 * driven[1]])
            assert np.cross(lines[leg], own) == pytest.approx(np.zeros(3), abs=1e-6)
            across = np.cross(lines[leg], rng.normal(size=3))
            for point in ([0.0, *across], [0.0, *rng.normal(size=2), 0.0]):
                at = np.array(point) / np.linalg.norm(point)
                assert at @ forms[leg] @ at == pytest.approx(0.0, abs=1e-9)

    def test_the_printed_sign_of_s1_does_not_close_leg_1(self) -> None:
        """Eq. 2.22, X0X1 + s1X0X3 + X2X3 = 0 as printed, with its edge as the x axis of the EE."""
        pose = np.array([20.0, 30.0, 25.0])
        x0, x1, x2, x3 = image_points(pose)
        s1 = 20.0 - 30.0 / math.tan(math.radians(25.0))  # the EE's x axis meets y = 0 there
        assert x0 * x1 - s1 * x0 * x3 + x2 * x3 == pytest.approx(0.0, abs=1e-10)
        assert abs(x0 * x1 + s1 * x0 * x3 + x2 * x3) > 1.0


def _moves_so_when_parallel(these: PlanarMachine, wanted: Array) -> bool:
    """Whether a translation by ``wanted`` with joint 1 locked agrees with the rails' directions, at φ = 0."""
    edge, rail = np.radians(these.edge_deg), np.radians(these.rail_deg)
    for signs in itertools.product((-45.0, 45.0), repeat=2):
        moved = np.array([0.0, *signs])[:, None] * np.stack([np.cos(rail), np.sin(rail)], axis=1)
        across = np.stack([-np.sin(edge), np.cos(edge)], axis=1)
        if np.abs(np.einsum("ij,ij->i", across, moved - wanted[:2])).max() < 1e-6:
            return True
    return False


def _coincident(leg: int, phi_deg: float, along_mm: float = 77.0) -> Array:
    """A pose at φ whose edge ``leg`` goes through the first point of its rail."""
    first, second = placed(np.array([0.0, 0.0, phi_deg]))[[leg, (leg + 1) % 3]]
    along = (second - first) / np.linalg.norm(second - first)
    return np.array([*(FIXED[leg] - first + along * along_mm), phi_deg])


def _zero_deg(leg: int, low_deg: float, high_deg: float) -> float:
    """φ at which det B changes its sign, by bisection."""
    sign = np.sign(image_determinant(machine(), _coincident(leg, low_deg)))
    assert np.sign(image_determinant(machine(), _coincident(leg, high_deg))) == -sign
    while high_deg - low_deg > 1e-9:
        middle = (low_deg + high_deg) / 2
        if np.sign(image_determinant(machine(), _coincident(leg, middle))) == sign:
            low_deg = middle
        else:
            high_deg = middle
    return low_deg


class TestSingularPoses:
    @pytest.mark.parametrize(
        ("leg", "phi_deg", "exact_deg"),
        [
            (1, APEX_ANGLE_DEG, math.degrees(math.acos(1 - 2 * (5 / 12) ** 2))),
            (2, BASE_ANGLE_DEG, math.degrees(math.acos(5 / 12))),
            (0, BASE_ANGLE_DEG, math.degrees(math.acos(5 / 12))),
        ],
    )
    def test_det_b_changes_its_sign_where_rail_and_edge_become_one_line(
        self, leg: int, phi_deg: float, exact_deg: float
    ) -> None:
        """Eq. 2.35 and 2.36, by det B, by the triangles' angles, and by moving the joint."""
        found = _zero_deg(leg, phi_deg - 0.01, phi_deg + 0.01)
        assert found == pytest.approx(exact_deg, abs=1e-6)
        assert found == pytest.approx(phi_deg, abs=1e-4)
        # The second method: at this φ the sides are parallel, by their end points.
        moved, fixed = placed(np.array([0.0, 0.0, found])), FIXED
        edge, rail = moved[(leg + 1) % 3] - moved[leg], fixed[(leg + 1) % 3] - fixed[leg]
        assert abs(edge[0] * rail[1] - edge[1] * rail[0]) < 1e-3  # mm², of 300,000

    def test_minus_49_degrees_is_not_singular(self) -> None:
        """Eq. 2.34 is refuted: no pose of the workspace at that φ is near a singular one."""
        phi = -APEX_ANGLE_DEG
        corners = slice_mm(machine(), phi)
        assert area_mm2(corners) > 10_000.0
        assert np.abs(machine().crossing_sines(phi)).min() > 0.9
        line = concurrent_line(machine(), phi)
        distance = corners @ line.normal - line.offset_mm
        assert np.abs(distance).min() > 3 * LEG_MM
        poses = np.column_stack([corners, np.full(len(corners), phi)])
        largest = np.abs(image_determinant(machine(), np.array([*corners.mean(axis=0), 0.0])))
        assert np.abs(image_determinant(machine(), poses)).min() > 0.1 * largest

    def test_minus_49_degrees_belongs_to_another_assignment(self) -> None:
        """With the base on the base and the legs swapped, ±49.2486° and 0° are singular, 65.3757° is not."""
        mirrored = [(0.0, 0.0), (BASE_MM, 0.0), (BASE_MM / 2, -HEIGHT_MM)]
        orientations = sorted(parallel_orientations_deg(machine_of_triangles(FIXED, mirrored)))
        assert orientations == pytest.approx([-APEX_ANGLE_DEG, 0.0, APEX_ANGLE_DEG], abs=1e-4)

    @pytest.mark.parametrize("phi_deg", [-40.0, 10.0, 40.0, 55.0, 90.0])
    def test_type_2_poses_are_those_where_three_normals_meet(self, phi_deg: float) -> None:
        """Eq. 2.37, by the crossings of the triangles' sides and the normals there."""
        line = concurrent_line(machine(), phi_deg)
        pose = np.array([*(line.offset_mm * line.normal + 25.0 * line.normal[::-1] * (-1, 1)), phi_deg])
        moved = placed(pose)
        points, along = [], []
        for k in range(3):
            first, second = moved[k], moved[(k + 1) % 3]
            share = crossing(FIXED[k], FIXED[(k + 1) % 3], first, second)[1]
            points.append(first + share * (second - first))
            along.append((second - first) / np.linalg.norm(second - first))
        meeting = np.linalg.solve(along[:2], [along[k] @ points[k] for k in (0, 1)])
        assert along[2] @ (meeting - points[2]) == pytest.approx(0.0, abs=1e-7)
        here, beside = image_determinant(machine(), [pose, pose + np.array([1.0, 1.0, 0.0])])
        assert abs(here) < 1e-6 * abs(beside)

    def test_assembly_modes_meet_in_a_type_2_pose(self) -> None:
        line = concurrent_line(machine(), 40.0)
        pose = np.array([*(line.offset_mm * line.normal), 40.0])
        first, second = poses_of(machine(), joints_of(machine(), pose))
        assert np.abs(first - second).max() < 1e-4
        assert np.abs(first - pose).max() < 1e-4

    def test_a_path_inside_the_workspace_meets_a_singular_pose(self) -> None:
        """The counterexample to §2.3.4: a translation at φ = 40°, all joints within the rails all the way."""
        middle = slice_mm(machine(), 40.0).mean(axis=0)
        line = concurrent_line(machine(), 40.0)
        side = line.normal @ middle - line.offset_mm
        first, last = (np.array([*(middle - k * side * line.normal), 40.0]) for k in (0.6, 1.4))
        path = first + np.linspace(0.0, 1.0, 101)[:, None] * (last - first)
        assert contains(machine(), path).all()
        joints = joints_of(machine(), path)
        rails = np.array([BASE_MM, LEG_MM, LEG_MM])
        assert ((joints > 0.02 * rails) & (joints < 0.98 * rails)).all()
        ends = image_determinant(machine(), path[[0, -1]])
        assert ends[0] * ends[1] < 0


class TestWorkspace:
    def test_a_slice_holds_the_poses_whose_sides_cross(self) -> None:
        poses = inside(300, 5)
        for pose in poses:
            corners = slice_mm(machine(), pose[2])
            after = np.roll(corners, -1, axis=0) - corners
            to_pose = pose[:2] - corners
            assert (after[:, 0] * to_pose[:, 1] - after[:, 1] * to_pose[:, 0] > -1e-6).all()

    @pytest.mark.long
    @pytest.mark.parametrize("phi_deg", [-40.0, 0.0, 20.0, 55.0])
    def test_the_six_faces_are_the_sides_of_a_slice_with_a_joint_at_its_limit(self, phi_deg: float) -> None:
        faces = {(leg, end): face_mm(machine(), phi_deg, leg, end) for leg in range(3) for end in (0, 1)}
        corners = slice_mm(machine(), phi_deg)
        around = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum()
        assert sum(float(np.linalg.norm(np.ptp(face, axis=0))) for face in faces.values() if len(face)) == (
            pytest.approx(around)
        )
        for (leg, end), face in faces.items():
            for point in face:
                joint = joints_of(machine(), np.array([*point, phi_deg]))[leg]
                assert joint == pytest.approx(machine().limits_mm[leg, end], abs=1e-6)

    def test_volume_by_slices_is_that_by_the_joints(self) -> None:
        """∫ |∂(a, b, φ)/∂(joints)| over the joints by a lattice, both modes, against the slices."""
        count, ratio = 2**18, 1.2207440846057596
        lattice = np.mod(0.5 + np.arange(1, count + 1)[:, None] * ratio ** -np.arange(1.0, 4.0), 1.0)
        joints, step = lattice * (BASE_MM, LEG_MM, LEG_MM), 1e-4
        moved = []
        for axis in np.eye(3):
            above, below = (poses_of(machine(), joints + sign * step * axis) for sign in (1, -1))
            moved.append((above - below) / (2 * step))
        columns = np.stack(moved, axis=-1)
        closes = np.isfinite(columns).all(axis=(-2, -1))
        gain = np.abs(np.linalg.det(np.where(closes[..., None, None], columns, 0.0)))
        closed = gain.sum(axis=1).mean()
        expected = closed * BASE_MM * LEG_MM * LEG_MM
        assert volume_mm2_deg(machine(), -180.0, 180.0) == pytest.approx(expected, rel=1e-3)

    def test_there_is_none_where_the_triangles_cannot_meet(self) -> None:
        assert slice_mm(machine(), -100.0).shape == (0, 2)
        assert area_mm2(slice_mm(machine(), -100.0)) == 0.0


class TestGeometryFit:
    SIGMA_JOINT_MM = 0.025 / math.sqrt(12)
    """One step of the source's machine (§2.4.5), evenly distributed."""
    SIGMAS = np.array([0.03, 0.03, 0.02])

    def true_machine(self, rng: np.random.Generator) -> PlanarMachine:
        design = machine()
        return PlanarMachine(
            design.rail_start_mm + rng.normal(0, 1, (3, 2)),
            design.rail_deg + rng.normal(0, 0.2, 3),
            design.edge_deg + rng.normal(0, 0.2, 3),
            design.edge_offset_mm + rng.normal(0, 1, 3),
            design.limits_mm,
            1 + rng.normal(0, 1e-3, 3),
        )

    def measured(self, true: PlanarMachine, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        poses = inside(count, 6)
        joints = joints_of(true, poses)
        return poses + rng.normal(0, self.SIGMAS, poses.shape), joints + rng.normal(
            0, self.SIGMA_JOINT_MM, joints.shape
        )

    def test_it_recovers_a_machine_within_its_uncertainty(self) -> None:
        rng, ratios = np.random.default_rng(7), []
        for _ in range(20):
            true = self.true_machine(rng)
            poses, joints = self.measured(true, rng, 60)
            fitted = fit_geometry(machine(), poses, joints, np.diag(self.SIGMAS**2), self.SIGMA_JOINT_MM)
            assert 0.64 < fitted.chi2 / fitted.degrees_of_freedom < 1.44
            assert fitted.sigmas[:, 0].max() < 0.5
            ratios.append((fitted.machine.parameters - true.parameters) / fitted.sigmas)
        assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.12)

    @pytest.mark.parametrize(
        ("count", "is_turned", "said"),
        [(60, False, "edge_offset_mm of leg"), (5, True, "the poses do not determine")],
    )
    def test_poses_of_one_orientation_and_too_few_do_not_determine_it(
        self, count: int, is_turned: bool, said: str
    ) -> None:
        poses, joints = self.measured(machine(), np.random.default_rng(8), count)
        if not is_turned:
            poses[:, 2] = 20.0
        with pytest.raises(NotIdentifiableError, match=said):
            fit_geometry(machine(), poses, joints, np.diag(self.SIGMAS**2), self.SIGMA_JOINT_MM)
