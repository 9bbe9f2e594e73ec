"""Shapes of spots in the unit frame, against formulas."""

import math

import numpy as np
import pytest

from altd.measuring.averaging import mean_spots
from altd.measuring.spot_shape import shape_doubts_mm, shape_in_mm
from altd.reasons import Reason
from altd.records import Fault, FrameSet, MeanSpots, Spot, SpotShape, TargetPoint
from altd.vision.settings import ShapeReference

PX_PER_MM = 5.0
MM_PER_PX = np.array([[-1 / PX_PER_MM, 0.0], [0.0, -1 / PX_PER_MM]])  # a mirrored picture, v down
KNOWN = ShapeReference((math.log(6.0), 0.0, 0.0, 1.0), (0.005, 0.0013, 0.0013, 0.012))


def gaussian(first_mm: float, second_mm: float, angle_rad: float = 0.0) -> SpotShape:
    """A Gaussian of such 1/e² diameters, its first axis turned from x towards y, as the picture shows it."""
    angle = math.pi - angle_rad if MM_PER_PX[0, 0] * MM_PER_PX[1, 1] < 0 else angle_rad
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    form = turn @ np.diag([(4 / (d * PX_PER_MM)) ** 2 for d in (first_mm, second_mm)]) @ turn.T
    return SpotShape(form[0, 0], form[0, 1], form[1, 1], 1.0)


def with_second_spot(share: float, aside_mm: float, diameter_mm: float = 12.0) -> SpotShape:
    """The Gaussian with the moments of a round one and a second one beside it along x, as a fit sees it."""
    sigma = diameter_mm / 4
    variance = sigma**2 + share * aside_mm**2 / (1 + share) ** 2
    return gaussian(4 * math.sqrt(variance), diameter_mm)


def doubts(
    front: SpotShape | None,
    rear: SpotShape | None,
    known: ShapeReference | None = KNOWN,
    changed_light: float = 0.0,
):
    mean = MeanSpots(
        ("front", "rear"),
        np.zeros((2, 2)),
        np.eye(4),
        0,
        20,
        0,
        (front, rear),
        excess_px=(0.0, 0.0),
        changed_light=(0.0, changed_light),
    )
    points = [TargetPoint(0.0, 0.0, MM_PER_PX, 0.03**2 * np.eye(2)) for _ in range(2)]
    return shape_doubts_mm(mean, points, [known, known])


def test_radius_and_stretch_are_those_of_the_ellipse() -> None:
    log_radius = math.log(math.sqrt(35))
    assert shape_in_mm(gaussian(14, 10), MM_PER_PX) == pytest.approx([log_radius, math.log(1.4) / 2, 0, 1])
    assert shape_in_mm(gaussian(14, 10, math.pi / 4), MM_PER_PX) == pytest.approx(
        [math.log(math.sqrt(35)), 0, math.log(1.4) / 2, 1], abs=1e-9
    )


@pytest.mark.parametrize(
    ("front", "rear"),
    [(gaussian(18, 8, 0.7), gaussian(18.02, 8, 0.7)), (gaussian(12, 12), gaussian(12.02, 11.98))],
    ids=["elongated alike", "alike within their scatter"],
)
def test_spots_that_are_alike_leave_no_doubt(front: SpotShape, rear: SpotShape) -> None:
    assert (doubts(front, rear) < 1e-4).all()


def test_without_a_shape_nothing_is_known() -> None:
    assert (doubts(None, gaussian(16, 9)) < 1e-9).all()


def test_a_calibration_without_laser_spots_still_has_alike_spots_on_its_targets() -> None:
    """As from a plate or a screen: of good spots in drawn frames the stretch differed by up to 0.03."""
    assert (doubts(gaussian(6, 5), gaussian(6.3, 5.1), None) == 0).all()
    assert (doubts(gaussian(6, 5), gaussian(6.1, 5.0, 0.1), None) == 0).all()
    assert isinstance(doubts(gaussian(6, 5), gaussian(5, 6), None), Fault)
    assert isinstance(doubts(gaussian(6, 5), gaussian(9, 7.5), None), Fault)
    for share, aside_mm in ((0.3, 2.0), (0.1, 3.0), (0.15, 2.0)):
        sigma_mm = doubts(gaussian(6, 6), with_second_spot(share, aside_mm, 6.0), None)
        displaced_mm = share * aside_mm / (1 + share)
        assert isinstance(sigma_mm, Fault) or displaced_mm < 5 * sigma_mm[1]


def test_a_spot_of_another_size_than_the_calibrated_is_less_certain() -> None:
    sigma_mm = doubts(gaussian(6, 6), gaussian(6, 6))
    assert sigma_mm == pytest.approx([7.5e-5 * (144 - 36)] * 2)


@pytest.mark.parametrize(("share", "aside_mm"), [(0.1, 2.0), (0.05, 3.0), (0.15, 1.8)])
def test_a_weak_second_spot_on_one_target_adds_to_sigma_what_it_displaces(share, aside_mm) -> None:
    sigma_mm = doubts(gaussian(12, 12), with_second_spot(share, aside_mm))
    displaced_mm = share * aside_mm / (1 + share)
    assert isinstance(sigma_mm, np.ndarray)
    assert displaced_mm < 6 * sigma_mm[1]


@pytest.mark.parametrize("count", range(4, 18))
def test_a_stretch_that_begins_within_the_window_is_in_sigma(count: int) -> None:
    """Torn pictures of a moving beam: half of each rear spot is one exposure late."""
    displaced_mm = 0.07  # in run 345 of the fault suite, at this stretch and scatter
    known = ShapeReference(KNOWN.mean, (0.0008, 0.0006, 0.0007, 0.003))
    torn, whole = gaussian(12.07, 11.93), gaussian(12, 12)
    mean = mean_spots(
        [
            FrameSet(
                number,
                number * 50_000_000,
                {
                    "front": Spot(300, 200, 0.02, 60, 180, shape=whole),
                    "rear": Spot(310, 220, 0.02, 60, 180, shape=torn if number >= 20 - count else whole),
                },
            )
            for number in range(20)
        ],
        ("front", "rear"),
        20,
    )
    assert isinstance(mean, MeanSpots)
    points = [TargetPoint(0.0, 0.0, MM_PER_PX, np.eye(2)) for _ in range(2)]
    sigma_mm = shape_doubts_mm(mean, points, [known, known])
    assert isinstance(sigma_mm, np.ndarray)
    assert displaced_mm * count / 20 < 5 * math.hypot(sigma_mm[1], 0.004)


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("aside_mm", [0.3, 0.6, 0.9, 1.2])
def test_a_second_spot_that_hardly_stretches_the_first_is_in_sigma_by_its_light(share, aside_mm) -> None:
    spots = gaussian(12, 12), with_second_spot(share, aside_mm)
    sigma_mm = doubts(*spots, changed_light=share)
    assert isinstance(sigma_mm, np.ndarray)
    assert share * aside_mm / (1 + share) < 1.5 * sigma_mm[1]
    assert sigma_mm[0] == pytest.approx(sigma_mm[1])  # which of the two it is remains unknown


@pytest.mark.parametrize(
    ("front", "rear", "reason", "words"),
    [
        (gaussian(12, 12), with_second_spot(0.5, 4.0), Reason.DISTORTED, "elongation"),
        (gaussian(12, 12), with_second_spot(1.0, 4.0), Reason.DISTORTED, "elongation"),
        (gaussian(12, 12), gaussian(8, 8), Reason.DISTORTED, "size"),
        (gaussian(4, 4), gaussian(4, 4.4), Reason.DISTORTED, "elongation"),
        (gaussian(4, 4), gaussian(3, 3), Reason.DISTORTED, "size"),
        (gaussian(20, 20), gaussian(20, 20), Reason.WRONG_SIZE, "wide"),
        (gaussian(12, 12), SpotShape(0.0044, 0, 0.0044, 4.0), Reason.WRONG_SHAPE, "order"),
    ],
)
def test_spots_that_are_not_measured_are_named(front, rear, reason: Reason, words: str) -> None:
    fault = doubts(front, rear)
    assert isinstance(fault, Fault)
    assert (fault.reason, words in fault.detail) == (reason, True), fault


def test_the_elongation_of_smaller_spots_scatters_more() -> None:
    """By a texture that displaces the edges of all spots by as much."""
    assert isinstance(doubts(gaussian(12, 12), gaussian(12, 12.42)), Fault)
    assert isinstance(doubts(gaussian(4, 4), gaussian(4, 4.14)), np.ndarray)
