"""``sigma_now`` against the truth of a moving, vibrating machine.

The essential cells of ``docs/studies/sigma-now.md``, without pictures.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest
from support.moving_machine import KEYS, PERIOD_NS, Machine, machine

from altd.config import Measuring
from altd.records import Measurement
from altd.status.measurement_json import as_object_now
from hw_sim.beam import BeamPose

LATE_S = (0.0, 0.5, 1.0)


@dataclass(frozen=True)
class Start:
    """A machine that starts to move along x."""

    at_s: float
    mm_per_s: float

    def moved(self, pose: BeamPose, t_ns: int) -> BeamPose:
        return replace(pose, x_mm=pose.x_mm + self.mm_per_s * max(t_ns * 1e-9 - self.at_s, 0.0))


TRIALS, EXPOSURES, KNOWN_FROM = 24, 60, 36


@pytest.mark.parametrize("vibrates", [False, True])
@pytest.mark.parametrize("speed_mm_per_s", [0.0, 0.5, 5.0])
def test_the_error_is_as_large_as_sigma_says_whenever_it_is_read(
    speed_mm_per_s: float, vibrates: bool
) -> None:
    ratios = []
    for seed in range(TRIALS):
        moving = machine(seed, speed_mm_per_s, vibrates=vibrates)
        for measurement in moving.measured(range(EXPOSURES), Measuring())[KNOWN_FROM::3]:
            assert measurement.valid
            ratios.append([_ratio(measurement, moving, late_s) for late_s in LATE_S])
    of_cells = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert of_cells.min() > 0.8
    assert of_cells.max() < 1.25


@pytest.mark.parametrize("vibrates", [False, True])
@pytest.mark.parametrize("speed_mm_per_s", [0.0, 1.0, 5.0])
def test_the_output_now_has_no_lag_and_its_sigma_is_that_of_its_instant(
    speed_mm_per_s: float, vibrates: bool
) -> None:
    """The stamps of both cameras are wrong alike by up to half an exposure interval, as sigma allows for."""
    ratios, own, errors_mm, of_mean_mm = [], [], [], []
    for seed in range(TRIALS):
        wrong_ns = round(((seed + 0.5) / TRIALS - 0.5) * PERIOD_NS)
        moving = machine(seed, speed_mm_per_s, vibrates=vibrates)
        now = moving.measured(range(EXPOSURES), Measuring(output="now"))[KNOWN_FROM::3]
        plain = machine(seed, speed_mm_per_s, vibrates=vibrates)
        means = plain.measured(range(EXPOSURES), Measuring())[KNOWN_FROM::3]
        for measurement, mean in zip(now, means, strict=True):
            assert measurement.valid
            assert measurement.t_ns == measurement.light_ns == mean.light_ns
            ratios.append([_ratio(measurement, moving, late_s, wrong_ns) for late_s in LATE_S])
            truth = moving.truth(measurement.t_ns)
            values = np.array([measurement.values[key].value for key in KEYS])
            lagged = moving.truth(measurement.t_ns + wrong_ns)
            own.append((values - lagged) / np.array([measurement.values[key].sigma for key in KEYS]))
            errors_mm.append(values[0] - truth[0])
            of_mean_mm.append(mean.values["x_mm"].value - truth[0])
    of_cells = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert of_cells.min() > 0.7
    assert of_cells.max() < 1.25
    assert np.allclose(np.array(ratios)[:, 0], own)  # read at once, sigma_now is sigma
    if speed_mm_per_s:
        assert np.sqrt(np.mean(np.square(errors_mm))) < 0.3 * np.sqrt(np.mean(np.square(of_mean_mm)))


def _ratio(measurement: Measurement, moving: Machine, late_s: float, wrong_ns: int = 0) -> np.ndarray:
    read_ns = measurement.light_ns + round(late_s * 1e9)
    values = np.array([measurement.values[key].value for key in KEYS])
    sigmas = [measurement.sigma_at(key, (read_ns - measurement.t_ns) * 1e-9) for key in KEYS]
    ratio: np.ndarray = (values - moving.truth(read_ns + wrong_ns)) / np.array(sigmas, dtype=np.float64)
    return ratio


LEVERS_M = (-2.0, -0.5, 0.0, 0.28, 1.0, 5.0, 10.0)


@pytest.mark.parametrize(
    ("speed_mm_per_s", "vibrates", "output"), [(0.0, False, "mean"), (1.0, True, "mean"), (1.0, True, "now")]
)
def test_a_point_on_a_lever_errs_as_the_covariance_says(
    speed_mm_per_s: float, vibrates: bool, output: Literal["mean", "now"]
) -> None:
    """x(L) = x + L · yaw and y(L) = y + L · pitch, from the published numbers alone."""
    levers = np.array([[1, 0, lever, 0] for lever in LEVERS_M] + [[0, 1, 0, lever] for lever in LEVERS_M])
    of_now, of_mean = [], []
    for seed in range(TRIALS):
        moving = machine(seed, speed_mm_per_s, vibrates=vibrates)
        for measurement in moving.measured(range(EXPOSURES), Measuring(output=output))[KNOWN_FROM::3]:
            document = as_object_now(
                measurement, age_s=(measurement.light_ns - measurement.t_ns) * 1e-9 + 0.5
            )
            values = [document[key] for key in measurement.quantities.joint]
            for name, ratios, at_ns in (
                ("covariance_now", of_now, measurement.light_ns + 500_000_000),
                ("covariance", of_mean, measurement.t_ns),
            ):
                x_mm, y_mm, yaw_deg, pitch_deg = moving.truth(at_ns)
                slopes = 1000 * np.tan(np.radians([yaw_deg, pitch_deg]))
                errors = levers @ (np.array(values) - [x_mm, y_mm, *slopes])
                ratios.append(errors / np.sqrt(np.diag(levers @ np.array(document[name]) @ levers.T)))
    of_cells = np.sqrt(np.mean(np.square(of_now), axis=0))
    assert of_cells.min() > 0.8, of_cells
    assert of_cells.max() < 1.25, of_cells
    if output == "mean" and not (speed_mm_per_s or vibrates):
        of_cells = np.sqrt(np.mean(np.square(of_mean), axis=0))
        assert 0.8 < of_cells.min() < of_cells.max() < 1.25, of_cells


def test_every_third_exposure_lost_it_still_holds() -> None:
    ratios = []
    for seed in range(TRIALS):
        moving = machine(seed, 2.0, vibrates=True)
        numbers = [number for number in range(EXPOSURES) if number % 3]
        for measurement in [m for m in moving.measured(numbers, Measuring()) if m.sequence > KNOWN_FROM + 9]:
            assert measurement.valid
            ratios.append(_ratio(measurement, moving, 0.5))
    assert 0.8 < math.sqrt(np.mean(np.square(ratios))) < 1.25


def test_until_it_is_known_how_the_beam_moves_there_is_no_value_of_now() -> None:
    measured = machine(1, 1.0, vibrates=False).measured(range(60), Measuring(output="now"))
    first = next(place for place, measurement in enumerate(measured) if measurement.valid)
    assert 25 <= first <= 40
    for measurement in measured[10:first]:
        assert [str(fault) for fault in measurement.status] == ["warming_up"]
    assert all(measurement.valid for measurement in measured[first:])


def test_a_start_that_was_never_seen_before_is_in_sigma_from_its_second_exposure_on() -> None:
    """The newest exposure leaves the others; a straight line through these is not where the beam is."""
    rest, start, t0_s = 60, 5.0, 60 * 0.05 - 0.025
    moving = Machine(3, Start(t0_s, start))
    measured = moving.measured(range(80), Measuring(output="now"))
    for measurement in measured[rest + 1 :]:
        error_mm = (
            measurement.values["x_mm"].value - moving.truth(measurement.t_ns)[0] if measurement.valid else 0.0
        )
        assert not measurement.valid or abs(error_mm) < 3 * (measurement.sigma("x_mm") or 0.0), (
            measurement.sequence
        )
