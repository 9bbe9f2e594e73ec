"""Spots far along a row, drawn from the optics alone: a beam that widens is measured, other light is not."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from support import optics
from support.made_once import loaded_once

from altd.calibration.calibrating import calibrate
from altd.instruments.row.places import BeamPlace, place_of, systematic_mm2
from altd.instruments.row.rounds import Observation, Visit
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.reasons import Reason
from altd.recording.reader import open_recording
from altd.records import Fault, Frame
from altd.records.limits import NO_LIMITS
from altd.vision.localise import locate

NAME = "rear"
WAIST_MM = 4.0
"""1/e² diameter of the beam at the laser, where its waist is; targets are calibrated there."""
FAR_M = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0)
UNIT = optics.Unit()


def diameter_mm(z_m: float) -> float:
    """Of a red Gaussian beam: w² = w₀² (1 + (λz/πw₀²)²)."""
    return WAIST_MM * math.hypot(1.0, 650e-6 * z_m * 1e3 / (math.pi * (WAIST_MM / 2) ** 2))


def _calibrated() -> Calibration:
    rng = np.random.default_rng(1)
    nodes = [(x, y) for y in np.arange(-2, 3) * 25.0 for x in (np.arange(6) - 2.5) * 25.0]
    rows = (
        (number / optics.FPS, NAME, UNIT.frame(NAME, at(place), optics.Scene(), 0.0, rng), place)
        for number, place in enumerate(place for place in nodes for _ in range(2))
    )
    with TemporaryDirectory() as folder:
        path = optics.write(Path(folder), "scan", rows)
        header = json.loads((path / "recording.json").read_text())
        header["cameras"] = {NAME: header["cameras"][NAME]}
        header["unit"] = {"serial": "ROW-1"}
        header["targets"] = [{"name": NAME, "z_mm": 0.0, "camera": NAME}]
        (path / "recording.json").write_text(json.dumps(header))
        return calibrate([open_recording(path)]).calibration


def at(mm: Sequence[float], z_m: float = 0.0, **kind: Any) -> optics.Beam:
    """The beam where it meets a target at that distance."""
    radius_mm = diameter_mm(z_m) / 2
    return optics.Beam(x=mm[0], y=mm[1], radius_mm=(radius_mm, radius_mm), order=1.0, **kind)


@pytest.fixture(scope="module")
def target() -> TargetCalibration:
    (of_row,) = loaded_once("glass-target", _calibrated).targets
    return of_row


def visited(
    target: TargetCalibration,
    beam: optics.Beam,
    rng: np.random.Generator,
    film: optics.Light = optics.even,
    exposures: int = 2,
) -> BeamPlace | tuple[Fault, ...]:
    """Some exposures of the beam on the target."""
    observations = []
    for number in range(exposures):
        pixels = UNIT.frame(NAME, beam, optics.Scene(rear_film=film), 0.0, rng)
        frame = Frame(NAME, number, number * 50_000_000, pixels)
        spot = locate(frame, target.localiser, target.flat, target.spot)
        observations.append(Observation(NAME, NAME, number, frame.t_ns, spot))
    visit = Visit(NAME, {NAME: observations}, dict.fromkeys(range(exposures)))
    return place_of(visit, target, NO_LIMITS, exposures)


def test_a_spot_that_has_widened_over_100_m_is_measured(target: TargetCalibration) -> None:
    """At all places of the target, and as a displacement after the beam has drifted by some mm."""
    rng = np.random.default_rng(60)
    off_mm, sigmas_mm, moved_mm, moved_sigmas_mm = [], [], [], []
    for z_m in FAR_M:
        for _ in range(8):
            mm = rng.uniform(-1.0, 1.0, 2) * (55.0, 40.0)
            to_mm = mm + rng.normal(0.0, 1.5, 2)
            before, now = (visited(target, at(place, z_m), rng) for place in (mm, to_mm))
            assert isinstance(before, BeamPlace)
            assert isinstance(now, BeamPlace)
            off_mm.append(now.mm - to_mm)
            sigmas_mm.append(np.sqrt(now.covariance_mm2.diagonal()))
            moved_mm.append(now.mm - before.mm - (to_mm - mm))
            covariance_mm2 = (
                now.random_mm2 + before.random_mm2 + systematic_mm2(target, NO_LIMITS, now, before)
            )
            moved_sigmas_mm.append(np.sqrt(covariance_mm2.diagonal()))
    for errors_mm, sigma_mm, most_mm in ((off_mm, sigmas_mm, 0.15), (moved_mm, moved_sigmas_mm, 0.05)):
        ratios = np.array(errors_mm) / np.array(sigma_mm)
        assert np.abs(errors_mm).max() < most_mm
        assert np.abs(ratios).max() < 5.0
        assert 0.7 < np.sqrt(np.mean(ratios**2)) < 1.25


def top_hat(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    return 1.0 * (np.hypot(along, across) < 1.0)


def ring(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    return np.exp(-(((np.hypot(along, across) - 0.8) / 0.2) ** 2))


@pytest.mark.parametrize("light", [top_hat, ring])
def test_other_light_of_that_size_is_no_spot(
    target: TargetCalibration, light: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> None:
    found = visited(target, at((8.0, -5.0), 80.0, field_of=light), np.random.default_rng(61))
    assert isinstance(found, tuple)
    assert found[0].reason in (Reason.DISTORTED, Reason.WRONG_SHAPE)


def test_a_spot_wider_than_any_beam_is_named(target: TargetCalibration) -> None:
    found = visited(target, at((0.0, 0.0), 120.0), np.random.default_rng(62))
    assert isinstance(found, tuple)
    assert "up to 23 mm are measured" in found[0].detail


def test_a_wide_spot_that_is_partly_shaded_is_in_sigma_or_refused(target: TargetCalibration) -> None:
    """By films of any loss and size."""
    rng = np.random.default_rng(63)
    for z_m in np.linspace(70.0, 100.0, 30).tolist():
        mm, d_mm = rng.uniform(-1.0, 1.0, 2) * (20.0, 15.0), diameter_mm(z_m)
        place = mm + rng.normal(0.0, d_mm / 3, 2)
        film = optics.patch(*place, rng.uniform(1.0, d_mm), rng.uniform(0.05, 0.9))
        found = visited(target, at(mm, z_m), rng, film)
        if isinstance(found, BeamPlace):
            assert (np.abs(found.mm - mm) < 5.0 * np.sqrt(found.covariance_mm2.diagonal())).all()


@pytest.mark.parametrize("z_m", [0.0, 50.0, 100.0])
def test_a_reflection_that_appears_beside_the_spot_is_in_the_displacements_sigma(
    target: TargetCalibration, z_m: float
) -> None:
    """0.6 radii and more aside; one that is much nearer does not stretch the spot, and is not detected."""
    rng = np.random.default_rng(64)
    before = visited(target, at((5.0, 3.0), z_m), rng)
    assert isinstance(before, BeamPlace)
    for share, aside in ((0.05, 0.6), (0.1, 0.6), (0.3, 0.6), (0.1, 0.8), (0.4, 0.8)):

        def twice(
            along: np.ndarray, across: np.ndarray, share: float = share, aside: float = aside
        ) -> np.ndarray:
            main, second = (np.exp(-2 * ((along - off) ** 2 + across**2)) for off in (0.0, aside))
            return main + share * second

        now = visited(target, at((5.0, 3.0), z_m, field_of=twice), rng)
        if isinstance(now, BeamPlace):
            covariance_mm2 = (
                now.random_mm2 + before.random_mm2 + systematic_mm2(target, NO_LIMITS, now, before)
            )
            off_mm = np.abs(now.mm - before.mm)
            assert (off_mm < 3.0 * np.sqrt(covariance_mm2.diagonal())).all()
