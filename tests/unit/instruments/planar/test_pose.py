"""The pose from LEDs through a camera whose formula is written here, and what is refused."""

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import cv2
import numpy as np
import pytest

from altd.config import Measuring
from altd.instruments.planar.chain import PlanarChain, PlateFrame, PlateLocator
from altd.instruments.planar.fitting import PlateView, fit_plane
from altd.instruments.planar.instrument import Leds, PlanarCalibration, PlanarInstrument
from altd.mapping.grid import convex_hull_mm
from altd.measuring.frame_chain import Provenance, RestPlace
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, Frame, Measurement, Origin, Value
from altd.vision.led_discs import Disc

LEDS = np.array([(-41, -40), (-7, -39), (31, -32), (44, 16), (11, 3), (-38, 23), (2, 39)], dtype=float)
SIZE = 1024, 768
DISC_MM = 5.0
NOISE_PX = 0.01
TURN, SHIFT = np.array([math.pi + 0.15, 0.02, 0.1]), np.array([-20.0, 640.0, 500.0])
MATRIX = np.array([[1300.0, 0, 520.0], [0, 1300.0, 380.0], [0, 0, 1]])
BENT = np.array([-0.08, 0.01, 2e-4, -1e-4])
REST, MOVED = (3.0, 702.0, 8.0), (3.4, 702.0, 8.0)
PERIOD_NS = 50_000_000
Pose = tuple[float, float, float]


def placed(pose: Pose, leds: np.ndarray = LEDS) -> np.ndarray:
    a, b, phi = pose[0], pose[1], math.radians(pose[2])
    turn = np.array([[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]])
    return np.asarray(leds @ turn.T + (a, b))


def seen(points: np.ndarray) -> np.ndarray:
    """OpenCV's camera."""
    in_space = np.column_stack([points, np.zeros(len(points))])
    return np.asarray(cv2.projectPoints(in_space, TURN, SHIFT, MATRIX, BENT)[0].reshape(-1, 2))


def centre_px(point: np.ndarray) -> np.ndarray:
    """Of the area of an LED's disc, from a polygon in the picture: the middle is seen elsewhere."""
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    rim = seen(point + DISC_MM / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    x, y = (rim - rim.mean(axis=0)).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    moments = [((value + np.roll(value, -1)) * cross).sum() / (3 * cross.sum()) for value in (x, y)]
    return np.asarray(rim.mean(axis=0) + moments)


def poses(count: int, rng: np.random.Generator) -> list[Pose]:
    drawn = rng.uniform((-40, 670, -35), (40, 730, 35), size=(count, 3))
    return [(float(a), float(b), float(phi)) for a, b, phi in drawn]


def calibrated(model: str = "lens", known: int = 10) -> PlanarCalibration:
    rng = np.random.default_rng(11)
    views = []
    for pose in poses(known, rng):
        centres = np.array([centre_px(point) for point in placed(pose)])
        angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        circle = DISC_MM / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rims = tuple(seen(point + circle) for point in placed(pose))
        noise = rng.normal(0.0, NOISE_PX, size=centres.shape)
        views.append(PlateView(pose, np.arange(7), centres + noise, rims))
    fit = fit_plane(model, LEDS, views, DISC_MM, SIZE)  # type: ignore[arg-type]
    if model == "lens":
        assert fit.noise_px == pytest.approx(NOISE_PX, rel=0.2)
        fit = replace(fit, noise_px=1e-3)  # the noise of a frame is all that there is
    hull = convex_hull_mm(np.concatenate([placed(of.pose) for of in views]))
    turns = tuple(of.pose[2] for of in views)
    now, unknown = datetime(2026, 1, 1, tzinfo=UTC), CameraIdentity()
    return PlanarCalibration("P", now, "", "", unknown, Origin.CAMERA, DISC_MM, fit, NOISE_PX, hull, turns)


@pytest.fixture(scope="module")
def calibration() -> PlanarCalibration:
    return calibrated()


def discs(points: np.ndarray, rng: np.random.Generator, diameter_mm: float = DISC_MM) -> list[Disc]:
    found = []
    for point in points:
        (u, v), right, up = centre_px(point), seen(point[None] + (1, 0))[0], seen(point[None] + (0, 1))[0]
        per_mm2 = abs(np.linalg.det(np.stack([right, up]) - seen(point[None])[0]))
        du, dv = rng.normal(0.0, NOISE_PX, size=2)
        area = math.pi / 4 * diameter_mm**2 * per_mm2
        found.append(Disc(float(u + du), float(v + dv), area, 150.0, 1.3, False, (0, 0, 1, 1)))
    return found


def measured(calibration: PlanarCalibration, found: list[Disc]) -> dict[str, Value] | Fault:
    instrument = PlanarInstrument(calibration)
    leds = instrument.identify(found)
    return instrument.solve(leds) if isinstance(leds, Leds) else leds


def off_by_sigma(values: dict[str, Value], pose: Pose) -> list[float]:
    return [
        (values[key].value - truth) / float(values[key].sigma or 0.0)
        for key, truth in zip(("a_mm", "b_mm", "phi_deg"), pose, strict=True)
    ]


def test_the_lens_is_found_where_no_led_was(calibration: PlanarCalibration) -> None:
    points = np.stack(np.meshgrid(np.linspace(-60, 60, 7), np.linspace(650, 750, 7)), axis=-1).reshape(-1, 2)
    assert np.abs(calibration.fit.camera.to_px(points) - seen(points)).max() < 0.05
    assert np.abs(calibration.fit.camera.to_mm(seen(points)) - points).max() < 0.02
    assert max(calibration.fit.sigma_led_mm, *calibration.fit.sigma_pose_mm) < 0.003


@pytest.mark.parametrize("leds", [7, 4, 3, 2])
def test_errors_are_those_that_sigma_states(calibration: PlanarCalibration, leds: int) -> None:
    rng = np.random.default_rng(leds)
    errors = []
    for pose in poses(60, rng):
        values = measured(calibration, discs(placed(pose)[rng.permutation(7)[:leds]], rng))
        assert isinstance(values, dict)
        errors.append(off_by_sigma(values, pose))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(1.0, abs=0.3)


def test_the_source_s_homography_measures_too_and_its_rims_know_no_bias() -> None:
    rng = np.random.default_rng(5)
    values = measured(calibrated("homography"), discs(placed((10.0, 705.0, -20.0)), rng))
    assert isinstance(values, dict)
    assert [values[key].value for key in ("a_mm", "b_mm")] == pytest.approx([10.0, 705.0], abs=0.2)


@pytest.mark.parametrize("turn", [-170.0, 95.0, 180.0])
def test_three_leds_tell_any_turn(calibration: PlanarCalibration, turn: float) -> None:
    values = measured(calibration, discs(placed((0.0, 700.0, turn))[[0, 3, 5]], np.random.default_rng(1)))
    assert isinstance(values, dict)
    assert values["phi_deg"].value == pytest.approx(turn, abs=0.02) or turn == 180.0
    assert abs(abs(values["phi_deg"].value) - abs(turn)) < 0.02


REFUSED = {
    "one LED": (placed((0, 700, 0))[:1], Reason.LEDS_MISSING),
    "no light": (np.empty((0, 2)), Reason.LEDS_MISSING),
    "two LEDs beyond the known turns": (placed((0, 700, 90))[:2], Reason.LEDS_MISFIT),
    "two LEDs and a reflection": (np.vstack([placed((0, 700, 0))[:2], (30.0, 690.0)]), Reason.LEDS_MISFIT),
    "an LED and a reflection": (np.vstack([placed((0, 700, 0))[:1], (30.0, 690.0)]), Reason.LEDS_MISFIT),
    "as many reflections as LEDs": (
        np.vstack([placed((0, 700, 0))[:3], [(30.0, 690.0), (-50.0, 720.0), (0.0, 760.0)]]),
        Reason.LEDS_MISFIT,
    ),
    "two plates": (np.vstack([placed((-30, 690, 0))[:4], placed((40, 720, 20))[3:]]), Reason.LEDS_MISFIT),
    "a plate far outside": (placed((250, 700, 0)), Reason.OUT_OF_RANGE),
    "a plate of another size": (placed((0, 700, 0), 1.05 * LEDS), Reason.LEDS_MISFIT),
    "a plate seen mirrored": (placed((0, 700, 0), LEDS * (-1, 1)), Reason.LEDS_MISFIT),
}


@pytest.mark.parametrize("case", REFUSED)
def test_no_pose_is_measured_from(calibration: PlanarCalibration, case: str) -> None:
    points, reason = REFUSED[case]
    refused = measured(calibration, discs(points, np.random.default_rng(2)))
    assert isinstance(refused, Fault)
    assert refused.reason is reason


@pytest.mark.parametrize("lamp_mm", [DISC_MM, 12.0, None])
def test_a_lamp_beside_the_leds_and_an_led_that_moved_on_its_plate_change_nothing(
    calibration: PlanarCalibration, lamp_mm: float | None
) -> None:
    rng, pose = np.random.default_rng(4 if lamp_mm else 6), (5.0, 695.0, 11.0)
    places = placed(pose)
    if lamp_mm is None:
        places[4] += (0.4, -0.3)
        lights = discs(places, rng)
    else:
        lights = discs(places[2:], rng) + discs(np.array([(60.0, 655.0)]), rng, lamp_mm)
    values = measured(calibration, lights)
    assert isinstance(values, dict)
    assert np.abs(off_by_sigma(values, pose)).max() < 4.0


def test_two_leds_are_followed_from_the_frame_before_to_any_turn(calibration: PlanarCalibration) -> None:
    rng, instrument = np.random.default_rng(8), PlanarInstrument(calibration)
    before = instrument.identify(discs(placed((0.0, 700.0, 95.0)), rng))
    assert isinstance(before, Leds)
    two = discs(placed((0.1, 700.0, 95.2))[[1, 5]], rng)
    assert isinstance(instrument.identify(two), Fault)
    leds = instrument.identify(two, before)
    assert isinstance(leds, Leds)
    assert leds.numbers == (1, 5)
    values = instrument.solve(leds)
    assert isinstance(values, dict)
    assert values["phi_deg"].value == pytest.approx(95.2, abs=0.05)


class Row:
    """A chain that is given frame after frame: a pose, or why the lights of a frame cannot be measured."""

    def __init__(self, calibration: PlanarCalibration, every: int = 1, **provenance: Any) -> None:
        measuring = Measuring(window=4, every=every)
        self.chain = PlanarChain("top", calibration, measuring, Provenance(**provenance))
        self._rng = np.random.default_rng(3)

    def add(self, sequence: int, seen: Pose | Reason = REST, late_ns: int = 0) -> Measurement | None:
        t_ns = sequence * PERIOD_NS + late_ns
        lights = Fault(seen) if isinstance(seen, Reason) else tuple(discs(placed(seen), self._rng))
        items = {"top": PlateFrame(t_ns, lights)}
        return self.chain.add(Pair(sequence, t_ns, 0, items, {}, {"top": 0}))

    def frames(self, sequence: int, seen: Pose | Reason = REST, late_ns: int = 0) -> int:
        measurement = self.add(sequence, seen, late_ns)
        assert measurement is not None
        return measurement.frames


def test_a_window_is_the_mean_of_frames_at_rest(calibration: PlanarCalibration) -> None:
    """The sigma of four frames is half that of one: their noise is ten times what lasts."""
    row = Row(calibration)
    found = [row.add(n) for n in range(12)]
    measured = [each for each in found if each is not None]
    assert [each.frames for each in measured] == [1, 2, 3, *[4] * 9]
    assert [each.sequence for each in measured] == list(range(12))
    assert [each.t_ns for each in measured[-2:]] == [round(n * PERIOD_NS) for n in (8.5, 9.5)]
    assert measured[-1].last_exposure_ns == 11 * PERIOD_NS
    moving = Row(calibration)
    alone = [moving.add(n, (REST, MOVED)[n % 2]) for n in range(9)]
    one, four = (
        np.median([each.values["a_mm"].sigma for each in sigmas if each is not None])
        for sigmas in (alone, measured[3:])
    )
    assert four / one == pytest.approx(0.5, rel=0.3)  # residuals with 11 degrees of freedom know it to 21 %
    assert np.abs(off_by_sigma(dict(measured[-1].values), REST)).max() < 4.0
    assert row.chain.figures() == {"leds": 7}


def test_a_plate_that_moves_begins_a_window_and_one_at_rest_never_does(
    calibration: PlanarCalibration,
) -> None:
    row = Row(calibration)
    assert [row.frames(n) for n in range(30)][3:] == [4] * 27
    moved = row.add(30, MOVED)
    assert moved is not None
    assert moved.frames == 1
    assert np.abs(off_by_sigma(dict(moved.values), MOVED)).max() < 4.0
    assert [row.frames(n, MOVED) for n in (31, 32)] == [2, 3]


def test_gaps_and_other_places_begin_a_window(calibration: PlanarCalibration) -> None:
    row = Row(calibration)
    assert [row.frames(n) for n in (0, 1, 2, 5)] == [1, 2, 3, 2]  # of the last four numbers two are there
    silent_ns = round(row.chain.silent_after_s * 1e9)
    assert row.frames(6, late_ns=silent_ns - PERIOD_NS) == 2
    assert row.frames(7, late_ns=2 * silent_ns) == 1
    assert row.frames(3) == 1  # numbers that begin again
    placed_ = Row(calibration, place=lambda sequence: RestPlace(sequence // 3))
    assert [placed_.frames(n) for n in range(7)] == [1, 2, 3, 1, 2, 3, 1]


def test_lost_exposures_are_told_and_more_than_half_are_too_many(calibration: PlanarCalibration) -> None:
    row, unknown = Row(calibration), Reason.EXPOSURE_CHANGING
    found = [row.add(n, REST if n in (0, 1, 3, 7, 8) else unknown) for n in range(9)]
    told = [(each.frames, [str(fault) for fault in each.status]) for each in found if each is not None]
    lost, changing = ["exposures_lost"], ["exposure_changing"]
    assert told == [
        *((1, []), (2, []), (0, changing), (3, lost)),
        *((0, changing), (0, changing), (0, changing)),
        *((0, changing), (2, lost)),  # one of four, two of four
    ]
    assert found[3] is not None
    assert found[3].t_ns == round(4 / 3 * PERIOD_NS)


def test_a_silent_camera_is_told_and_what_comes_after_is_not_averaged_with_what_was_before(
    calibration: PlanarCalibration,
) -> None:
    row = Row(calibration)
    assert [row.frames(n) for n in range(3)] == [1, 2, 3]
    silent = row.chain.silence(4 * PERIOD_NS)
    assert (silent.valid, silent.sequence, [str(fault) for fault in silent.status]) == (
        *(False, 2),
        ["camera_silent"],
    )
    assert row.frames(5) == 1
    thirds = Row(calibration, every=3)
    assert [n for n in range(9) if thirds.add(n) is not None] == [2, 5, 8]


def test_frames_that_repeat_change_or_come_from_another_camera_are_not_searched() -> None:
    delivers = [CameraIdentity("A-1")]
    locator = PlateLocator([CameraIdentity("A-1"), CameraIdentity()], lambda: delivers[0])
    rng = np.random.default_rng(4)

    def found(changing: bool = False, pixels: np.ndarray | None = None) -> object:
        fresh = rng.normal(20.0, 2.0, (60, 80)).astype(np.uint8) if pixels is None else pixels
        return locator.locate(Frame("top", 0, 0, fresh, changing=changing)).lights

    again = rng.normal(20.0, 2.0, (60, 80)).astype(np.uint8)
    assert found(pixels=again) == ()
    told = [found(pixels=again), found(changing=True)]
    delivers[0] = CameraIdentity("B-2")
    told.append(found())
    assert [fault.reason for fault in told if isinstance(fault, Fault)] == [
        *(Reason.FRAME_REPEATED, Reason.EXPOSURE_CHANGING, Reason.WRONG_CAMERA),
    ]
