"""Prints of known pitch and lattice before the simulator's camera; targets that end."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from support.prints import NODES_MM, Dots, Scene, lattice_of, steps

from altd.calibration.printed.lattice import Lattice
from altd.calibration.scan_grid import cut_sides


@pytest.mark.parametrize("speckle", [0.0, 0.16, 0.6])
def test_a_plain_target_has_none_however_coarse_its_grain(speckle: float) -> None:
    assert lattice_of(Scene(None, speckle, power_mw=2.0)) is None


@pytest.mark.parametrize("angle_deg", [60.0, 120.0, 90.0])
def test_the_harmonics_are_all_waves_within_a_circle(angle_deg: float) -> None:
    """A hexagonal lattice has 45 pairs of points around the middle out to its fifth ring."""
    lattice = Lattice(steps(7.0, angle_deg, 10.0))
    lengths = np.hypot(*lattice.vectors.T)
    if angle_deg != 90.0:
        assert len(lattice.harmonics) == 45
        assert lengths.max() == pytest.approx(5 * 7.0)
    assert np.sum(np.isclose(lengths, lengths.min())) == (2 if angle_deg == 90.0 else 3)
    rng = np.random.default_rng(1)
    mm = rng.uniform(-60, 60, (20, 2))
    assert lattice.waves(mm) == pytest.approx(np.exp(1j * mm @ lattice.vectors.T), abs=1e-9)


PRINT = Dots(steps(1.0, 60, 1.3), 0.25)
ALL = ("x -70", "x 70", "y -56", "y 56")
Inside = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Ending(Dots):
    """A print that covers only a part of the target."""

    inside: Inside = lambda x, y: np.ones_like(x)

    def cover(self, x_mm: np.ndarray, y_mm: np.ndarray, softness_mm: float) -> np.ndarray:
        return super().cover(x_mm, y_mm, softness_mm) * self.inside(x_mm, y_mm)


class EndingPlate(Ending):
    """A plain surface with an end: light from everywhere on it."""

    def cover(self, x_mm: np.ndarray, y_mm: np.ndarray, softness_mm: float) -> np.ndarray:
        return self.inside(x_mm, y_mm).astype(np.float32)


def rectangle(beyond_mm: float, turn_deg: float = 0.0) -> Inside:
    """Ends ``beyond_mm`` outside the outermost nodes."""
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return lambda x, y: (
        (np.abs(cos * x + sin * y) < 70 + beyond_mm) & (np.abs(cos * y - sin * x) < 56 + beyond_mm)
    )


def cut(inside: Inside, of: type[Ending] = Ending) -> tuple[str, ...]:
    scene = Scene(of(PRINT.steps_mm, PRINT.radius_mm, inside=inside), power_mw=2.5)
    return cut_sides(scene.frames().__getitem__, NODES_MM, scene.first_map())


@pytest.mark.long
@pytest.mark.parametrize("of", [Ending, EndingPlate])
@pytest.mark.parametrize("beyond_mm", [3.0, 5.0])
def test_an_end_within_the_outermost_spots_is_told_on_every_side(of: type[Ending], beyond_mm: float) -> None:
    assert cut(rectangle(beyond_mm), of) == ALL


@pytest.mark.long
@pytest.mark.parametrize("of", [Ending, EndingPlate])
@pytest.mark.parametrize("beyond_mm", [10.0, 30.0])
def test_an_end_beyond_the_spots_is_no_fault(of: type[Ending], beyond_mm: float) -> None:
    assert cut(rectangle(beyond_mm), of) == ()


@pytest.mark.long
def test_an_end_on_one_side_is_reported_on_that_side() -> None:
    assert cut(lambda x, y: x < 73) == ("x 70",)
    assert cut(lambda x, y: y > -60) == ("y -56",)


@pytest.mark.long
def test_an_end_that_is_turned_or_not_straight_is_reported() -> None:
    assert cut(rectangle(4.0, turn_deg=2.0)) == ALL
    assert cut(lambda x, y: x + 1.5 * np.sin(y / 6) < 73) == ("x 70",)


@pytest.mark.long
def test_dirt_on_a_border_spot_is_no_end() -> None:
    """Opaque, 8 mm wide, outside the middle of one spot of each side."""
    spots = np.array([(74, 0), (-74, 28), (14, 60), (-14, -60)])

    def clean(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.min([np.hypot(x - u, y - v) for u, v in spots], axis=0) > 4

    assert cut(clean) == ()
