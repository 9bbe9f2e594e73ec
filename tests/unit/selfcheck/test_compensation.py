import math

import numpy as np
import pytest
from support.led_frames import LEVEL, Motion, Scene, unit

from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.records import MeanSpots
from altd.selfcheck.records import DriftLimits, SelfCheck
from altd.selfcheck.verdict import Compensation, NotCorrected, compensated, compensation_of, flat_now, judge
from altd.vision.flat import Flat

TRUE_PX = np.array([[300.0, 150.0], [500.0, 320.0]])


def check(front: Scene, rear: Scene | None = None, seed: int = 1) -> SelfCheck:
    rng = np.random.default_rng(seed)
    return judge({"front": front.view(rng), "rear": (rear or Scene()).view(rng)}, unit(), None, DriftLimits())


def mean_spots(px: np.ndarray) -> MeanSpots:
    covariance = np.diag([1e-4, 1e-4, 4e-4, 4e-4])
    covariance[0, 2] = covariance[2, 0] = 5e-5  # vibration moves both
    return MeanSpots(("front", "rear"), px, covariance, 0, 20, 0, shapes=(None, None))


def test_moved_spots_are_brought_back_to_where_they_would_have_been() -> None:
    front, rear = Motion(0.6, -0.2, 0.1, 200), Motion(-0.3, 0.4, -0.05)
    found = compensation_of(check(Scene(front), Scene(rear)), unit(), DriftLimits())
    now = np.concatenate([front.of(TRUE_PX[:1]), rear.of(TRUE_PX[1:])])
    assert np.abs(now - TRUE_PX).max() > 0.4
    corrected = compensated(mean_spots(now), found)
    assert corrected.px == pytest.approx(TRUE_PX, abs=0.02)


def test_the_sigma_of_what_is_measured_grows_by_that_of_the_transform_and_no_more() -> None:
    found = compensation_of(check(Scene(Motion(0.6))), unit(), DriftLimits())
    before = mean_spots(TRUE_PX)
    after = compensated(before, found)
    grown = after.covariance_px2 - before.covariance_px2
    assert np.linalg.eigvalsh(grown).min() >= 0
    assert grown[0, 2] == grown[1, 3] == 0
    assert 0 < math.sqrt(grown[0, 0]) < 0.02
    assert after.covariance_px2[0, 2] == before.covariance_px2[0, 2]


def test_the_transforms_own_error_is_as_large_as_it_says() -> None:
    """The corrected place of a spot, by many checks; the reference is exact and said to be one pair's."""
    off, sigma = [], []
    for seed in range(12):
        motion = Motion(0.6, 0.1, 0.1)
        found = compensation_of(check(Scene(motion, noise=6.0), seed=seed), unit(), DriftLimits())
        corrected = compensated(mean_spots(np.concatenate([motion.of(TRUE_PX[:1]), TRUE_PX[1:]])), found)
        off.append(corrected.px - TRUE_PX)
        grown = corrected.covariance_px2 - mean_spots(TRUE_PX).covariance_px2
        sigma.append(np.sqrt(np.diag(grown)).reshape(2, 2))
    ratio = np.sqrt(np.mean((np.array(off) / np.array(sigma)) ** 2))
    assert 0.3 < ratio < 1.25


def test_yaw_and_pitch_are_right_again() -> None:
    motion = Motion(0.6, 0.3, 0.1)
    instrument = BeamInstrument(unit(), Measuring())
    found = compensation_of(check(Scene(motion)), unit(), DriftLimits())
    now = np.concatenate([motion.of(TRUE_PX[:1]), TRUE_PX[1:]])
    truth, wrong, right = (
        instrument.solve(mean)
        for mean in (mean_spots(TRUE_PX), mean_spots(now), compensated(mean_spots(now), found))
    )
    for key, least in (("yaw_deg", 0.02), ("pitch_deg", 0.005)):
        assert abs(wrong.values[key].value - truth.values[key].value) > least
        assert right.values[key].value == pytest.approx(truth.values[key].value, abs=0.001)


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        (Scene(Motion(3.0)), "0.5 mm are corrected at most"),
        (Scene(levels=(LEVEL, 0, 0, LEVEL, 0, 0)), "the drift is not known"),
        (Scene(levels=(0,) * 6), "the drift is not known"),
    ],
)
def test_what_is_too_far_or_not_known_is_not_corrected(scene: Scene, why: str) -> None:
    refused = compensation_of(check(scene), unit(), DriftLimits())
    assert isinstance(refused, NotCorrected)
    assert why in refused.detail
    assert refused.detail.startswith("front")


def test_the_limit_is_stated_and_holds_where_the_motion_is_largest() -> None:
    """2 px are 0.5 mm of the straight map: the turn adds at the border what the limit does not allow."""
    allowed = DriftLimits(compensate_mm=0.55)
    assert isinstance(compensation_of(check(Scene(Motion(1.9))), unit(), allowed), Compensation)
    assert isinstance(compensation_of(check(Scene(Motion(1.9, turn_deg=0.2))), unit(), allowed), NotCorrected)


def test_a_flat_moves_with_the_picture() -> None:
    """A print of waves, as close as dots lie, drawn where the motion takes each of its points."""
    v, u = np.mgrid[:480, :752].astype(float)
    motion = Motion(0.6, -0.4, 0.1)

    def waves(at_u: np.ndarray, at_v: np.ndarray) -> np.ndarray:
        return 150 + 60 * np.sin(0.73 * at_u) * np.cos(0.88 * at_v)

    found = compensation_of(check(Scene(motion)), unit(), DriftLimits())
    flat = Flat(np.rint(waves(u, v)).astype(np.uint8), "recorded")
    then = Motion(-0.6, 0.4, -0.1).of(np.column_stack([u.ravel(), v.ravel()]))  # to first order its inverse
    expected = waves(then[:, 0].reshape(u.shape), then[:, 1].reshape(u.shape))
    inner = slice(10, -10), slice(10, -10)
    error = flat_now(flat, found.transforms["front"]).levels.astype(float) - expected
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.8
    assert np.sqrt(np.mean((flat.levels - expected)[inner] ** 2)) > 12.0
